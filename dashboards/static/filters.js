// The tools above the table of trials: states, a condition, columns, download. All of it is kept in the address.
import { STATES, stateText } from "./format.js";
import { element } from "./plain.js";

const CONDITION = /^\s*([\w.]+)\s*(<=|>=|!=|=|<|>)\s*(.+?)\s*$/;

// `value > 0.5`, `params.omega_x <= -2`, `mode = explore`; anything else is looked for in number, stage and mode.
export function condition(text, columns) {
  const found = CONDITION.exec(text);
  if (!text.trim()) return { test: () => true };
  if (!found) {
    const word = text.trim().toLowerCase();
    return { test: (trial) => String(trial.number) === word || trial.stage.toLowerCase().includes(word) || (trial.mode ?? "").toLowerCase().includes(word) };
  }
  const [, key, sign, raw] = found;
  const column = columns.find((one) => one.key === key) ?? columns.find((one) => one.key.split(".").at(-1) === key);
  if (!column) return { test: () => true, problem: `Unknown column ${key}. Known: ${columns.map((one) => one.key).join(", ")}` };
  const wanted = Number.isNaN(Number(raw)) ? raw : Number(raw);
  const compare = {
    "<": (a) => a < wanted, ">": (a) => a > wanted, "<=": (a) => a <= wanted, ">=": (a) => a >= wanted,
    "=": (a) => a === wanted || String(a) === raw, "!=": (a) => a !== wanted && String(a) !== raw,
  }[sign];
  return { test: (trial) => { const value = column.value(trial); return value !== null && compare(value); } };
}

export function filters(at, table, csv) {
  const address = new URLSearchParams(location.search);
  const off = new Set((address.get("without") ?? "").split(",").filter(Boolean));
  const find = element("input", { type: "search", placeholder: "value > 0.5", value: address.get("where") ?? "", "aria-label": "Condition, for example value > 0.5" });
  const note = element("span", { className: "hint", role: "status" });
  const chips = element("div", { className: "choice", role: "group", "aria-label": "States" });
  const columns = element("details", { className: "columns" }, element("summary", { className: "button", textContent: "Columns" }), element("div", { className: "panel" }));
  const sort = address.get("sort");
  if (sort) table.sort = { key: sort.replace(/^-/, ""), down: sort.startsWith("-") };
  for (const key of (address.get("hide") ?? "").split(",").filter(Boolean)) table.hidden.add(key);
  at.append(chips, find, note, element("span", { className: "space" }), columns, element("a", { className: "button", href: csv, textContent: "Download CSV" }));

  function remember() {
    const query = new URLSearchParams();
    if (find.value.trim()) query.set("where", find.value.trim());
    if (off.size) query.set("without", [...off].join());
    if (table.hidden.size) query.set("hide", [...table.hidden].join());
    if (table.sort.key !== "number" || !table.sort.down) query.set("sort", (table.sort.down ? "-" : "") + table.sort.key);
    history.replaceState(null, "", query.size ? `?${query}` : location.pathname);
  }

  function apply() {
    const { test, problem } = condition(find.value, table.columns());
    table.filter = (trial) => !off.has(trial.state) && test(trial);
    const all = table.trials.all();
    const count = all.filter(table.filter).length;
    note.textContent = problem ?? (count === all.length ? `${all.length} trials` : `${count} of ${all.length} trials`);
  }

  function draw() {
    const counts = {};
    for (const trial of table.trials.all()) counts[trial.state] = (counts[trial.state] ?? 0) + 1;
    for (const state of STATES) {
      let chip = chips.querySelector(`[data-state="${state}"]`);
      if (!chip && !counts[state]) continue;
      if (!chip) {
        chip = element("button", { type: "button", dataset: { state } });
        chip.onclick = () => { if (!off.delete(state)) off.add(state); remember(); draw(); table.draw(); };
        chips.append(chip);
      }
      chip.textContent = `${stateText(state)} ${counts[state] ?? 0}`;
      chip.setAttribute("aria-pressed", String(!off.has(state)));
    }
    const list = columns.lastChild;
    const known = table.columns();
    if (list.dataset.keys !== known.map((one) => one.key).join()) {
      list.dataset.keys = known.map((one) => one.key).join();
      list.replaceChildren(...known.slice(1).map((column) => {
        const box = element("input", { type: "checkbox", checked: !table.hidden.has(column.key) });
        box.onchange = () => { if (box.checked) table.hidden.delete(column.key); else table.hidden.add(column.key); remember(); table.draw(); };
        return element("label", {}, box, ` ${column.head}`);
      }));
    }
    apply();
  }

  find.oninput = () => { remember(); apply(); table.draw(); };
  table.onSort = remember;
  return { draw };
}
