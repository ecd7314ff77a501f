// A slider for each parameter that a slice doesn't show, and one for the difficulty. Untouched ones follow the search.
import { number } from "./format.js";
import { element } from "./plain.js";

const STEPS = 200;

export class Sliders {
  constructor(at, { space, units, hasDifficulty, address, onChange }) {
    Object.assign(this, { at, space, units, onChange });
    this.touched = new Map();
    this.z = hasDifficulty ? 1 : null;
    try {
      for (const [name, value] of Object.entries(JSON.parse(address.get("at") ?? "{}"))) if (name in space) this.touched.set(name, value);
    } catch { /* a link that was cut short: the search's own point is shown */ }
    if (hasDifficulty && address.get("z") !== null && !Number.isNaN(Number(address.get("z")))) this.z = Math.min(1, Math.max(0, Number(address.get("z"))));
    this.rows = new Map();
    for (const [name, parameter] of Object.entries(space)) this.rows.set(name, this.#row(name, parameter));
    if (hasDifficulty) {
      const input = element("input", { type: "range", min: 0, max: 1, step: 0.01, value: this.z, "aria-label": "difficulty" });
      const told = element("output", { textContent: number(this.z, 3) });
      input.oninput = () => { this.z = Number(input.value); told.textContent = number(this.z, 3); this.onChange(); };
      this.zInput = input;
      this.zTold = told;
      this.zRow = element("label", { className: "slider" }, element("span", { textContent: "difficulty" }), input, told);
    }
  }

  #bounds(parameter) { return parameter.type === "angle" ? [-Math.PI, Math.PI] : [parameter.low, parameter.high]; }

  #row(name, parameter) {
    const unit = this.units[name] ?? (parameter.type === "angle" ? "rad" : "");
    const told = element("output");
    if (parameter.type === "categorical") {
      const input = element("select", {}, ...parameter.choices.map((choice) => element("option", { textContent: choice })));
      const write = (value) => { input.value = value; };
      input.onchange = () => { this.touched.set(name, input.value); this.onChange(); };
      return { label: element("label", { className: "slider" }, element("span", { textContent: name }), input, told), write };
    }
    const [low, high] = this.#bounds(parameter);
    const scale = parameter.log ? Math.log : (value) => value;
    const back = parameter.log ? Math.exp : (value) => value;
    const input = element("input", { type: "range", min: 0, max: STEPS, step: 1, "aria-label": unit ? `${name} in ${unit}` : name });
    const say = (value) => { told.textContent = `${number(value, 3)}${unit ? ` ${unit}` : ""}`; input.setAttribute("aria-valuetext", told.textContent); };
    const write = (value) => { input.value = (STEPS * (scale(value) - scale(low))) / (scale(high) - scale(low)); say(value); };
    input.oninput = () => {
      let value = back(scale(low) + (Number(input.value) / STEPS) * (scale(high) - scale(low)));
      value = parameter.type === "int" ? Math.round(value) : Number(value.toPrecision(6));
      this.touched.set(name, value);
      say(value);
      this.onChange();
    };
    write(this.touched.get(name) ?? (parameter.log ? Math.sqrt(low * high) : (low + high) / 2));
    return { label: element("label", { className: "slider" }, element("span", { textContent: name }), input, told), write };
  }

  // All but those that are axes.
  show(axes) {
    const shown = [...this.rows].filter(([name]) => !axes.includes(name)).map(([, row]) => row.label);
    this.at.replaceChildren(...(this.zRow ? [this.zRow] : []), ...shown);
    this.at.hidden = !this.at.children.length;
    this.axes = axes;
  }

  // Where the slice lies in what nobody has set.
  follow(others) {
    for (const [name, value] of Object.entries(others ?? {})) if (!this.touched.has(name)) this.rows.get(name)?.write(value);
  }

  set(params, z) {
    for (const [name, value] of Object.entries(params)) {
      if (!this.rows.has(name)) continue;
      this.touched.set(name, value);
      this.rows.get(name).write(value);
    }
    if (this.zInput && typeof z === "number") { this.z = z; this.zInput.value = z; this.zTold.textContent = number(z, 3); }
  }

  query() {
    const at = Object.fromEntries([...this.touched].filter(([name]) => !this.axes.includes(name)));
    return [...(Object.keys(at).length ? [["at", JSON.stringify(at)]] : []), ...(this.z === null ? [] : [["z", String(this.z)]])];
  }
}
