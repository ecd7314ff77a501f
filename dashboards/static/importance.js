// Which parameters matter: how much the outcome changes when one is shuffled, beside what the length scales say.
import { colour } from "./chart.js";
import { number } from "./format.js";
import { api } from "./live.js";
import { element, onTheme, setText } from "./plain.js";
import { svg } from "./svg.js";

const PAUSE = 4000;
// Share of the time that the service may be busy with this by itself.
const SHARE = 0.05;
const MOST_PAUSE = 30_000;

export class Importance {
  #timer = 0;
  #last = 0;
  #took = 0;

  constructor({ base, behaviour }) {
    this.base = base;
    this.at = document.getElementById("importance");
    this.of = document.getElementById("importance-of");
    this.of.parentElement.hidden = !behaviour;
    this.of.onchange = () => this.#ask();
    onTheme(() => this.#draw());
    new ResizeObserver(() => this.#draw()).observe(this.at);
    document.getElementById("copy-space").onclick = async (event) => {
      await navigator.clipboard.writeText(document.getElementById("best-space").textContent);
      event.target.textContent = "Copied";
      setTimeout(() => { event.target.textContent = "Copy"; }, 1500);
    };
    if (!navigator.clipboard) document.getElementById("copy-space").hidden = true;
  }

  // It takes the service a moment: asked for when the history has grown, and not more often than every few seconds.
  draw({ history } = {}) {
    if (!history && this.found) return;
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#ask(), Math.max(0, this.#last + Math.min(MOST_PAUSE, Math.max(PAUSE, this.#took / SHARE)) - Date.now()));
  }

  async #ask() {
    this.#last = Date.now();
    try {
      this.found = await api(`${this.base}/importance${this.of.parentElement.hidden || !this.of.value ? "" : `?of=${this.of.value}`}`);
      this.#took = Date.now() - this.#last;
      if (this.found.of && !this.of.value) this.of.value = this.found.of;
    } catch (error) {
      this.found = { parameters: [], best: null, note: error.message };
    }
    const { best, note } = this.found;
    setText("importance-note", note ?? "");
    document.getElementById("best-box").hidden = !best?.yaml;
    if (best?.yaml) setText("best-space", best.yaml);
    this.#draw();
  }

  #draw() {
    const width = this.at.clientWidth;
    if (!this.found && !this.at.firstChild) this.at.append(element("p", { className: "empty", textContent: "Working out what matters …" }));
    if (!this.found || !width) return;
    const parameters = [...this.found.parameters].sort((a, b) => b.permutation - a.permutation);
    if (!parameters.length) {
      this.at.replaceChildren(element("p", { className: "empty", textContent: "Importances appear when a few trials have completed." }));
      return;
    }
    const [row, top, foot] = [34, 24, 40];
    const left = Math.min(150, 16 + 7.2 * Math.max(...parameters.map((one) => one.name.length)));
    const height = top + row * parameters.length + foot;
    const most = Math.max(0.01, ...parameters.flatMap((one) => [one.permutation, one.from_length_scales ?? 0, one.interval?.[1] ?? 0]));
    const low = Math.min(0, ...parameters.map((one) => one.interval?.[0] ?? 0));
    const x = (value) => left + ((value - low) / (most - low)) * (width - left - 24);
    const soft = { fill: colour("soft"), "font-size": 11 };
    const root = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `Importances: ${parameters.map((one) => `${one.name} ${number(one.permutation, 2)}`).join(", ")}` });
    root.append(
      svg("rect", { x: left, y: 4, width: 10, height: 10, fill: colour("accent") }), svg("text", { x: left + 15, y: 13, ...soft }, "by shuffling, with its 95 % interval"),
      svg("path", { d: `M ${left + 222} 9 l 5 -5 l 5 5 l -5 5 z`, fill: colour("diverged") }), svg("text", { x: left + 236, y: 13, ...soft }, "by length scale"),
    );
    const step = 10 ** Math.floor(Math.log10((most - low) / 2.5));
    for (let tick = Math.ceil(low / step) * step; tick <= most; tick += step * Math.max(1, Math.round((most - low) / step / 5))) {
      root.append(svg("line", { x1: x(tick), x2: x(tick), y1: top, y2: height - foot, stroke: colour("line") }), svg("text", { x: x(tick), y: height - foot + 15, "text-anchor": "middle", ...soft }, number(Number(tick.toPrecision(2)), 2)));
    }
    root.append(svg("text", { x: (left + width) / 2, y: height - 6, "text-anchor": "middle", ...soft }, "importance (share of the variance; lengths: share of all)"));
    for (const [index, one] of parameters.entries()) {
      const y = top + row * index + row / 2;
      root.append(
        svg("text", { x: left - 8, y: y + 4, "text-anchor": "end", "font-size": 12, fill: colour("ink") }, one.name),
        svg("rect", { x: x(Math.min(0, one.permutation)), y: y - 8, width: Math.abs(x(one.permutation) - x(0)), height: 16, rx: 2, fill: colour("accent"), "fill-opacity": 0.85 }, svg("title", {}, `${one.name}: ${number(one.permutation, 3)}`)),
      );
      if (one.interval) root.append(svg("path", { d: `M ${x(one.interval[0])} ${y - 4} v 8 m 0 -4 H ${x(one.interval[1])} m 0 -4 v 8`, stroke: colour("ink"), "stroke-width": 1.2, fill: "none" }));
      if (typeof one.from_length_scales === "number") root.append(svg("path", { d: `M ${x(one.from_length_scales) - 5} ${y} l 5 -5 l 5 5 l -5 5 z`, fill: colour("diverged"), stroke: colour("sheet") }));
    }
    root.style.height = `${height}px`;
    this.at.replaceChildren(root);
  }
}
