// How good, at what cost, and what made the difference.
import { Chart, colour } from "./chart.js";
import { number } from "./format.js";
import { Importance } from "./importance.js";
import { Overlay } from "./overlay.js";
import { Parallel } from "./parallel.js";
import { element } from "./plain.js";
import { saveSmall } from "./svg.js";
import { answers } from "./trials.js";
import { easier, thinned } from "./valuechart.js";

export class Quality {
  constructor(context) {
    Object.assign(this, context);
    this.parallel = new Parallel(document.getElementById("lines"), context);
    this.importance = new Importance(context);
    this.overlay = new Overlay(context);
    this.each = new Map();
  }

  draw(changes) {
    this.parallel.draw();
    this.importance.draw(changes);
    this.overlay.draw();
    const box = document.getElementById("each");
    for (const name of this.trials.parameters) {
      if (!this.each.has(name)) {
        const at = element("div", { className: "small-chart" });
        const frame = element("div", { dataset: { parameter: name } }, at);
        box.append(frame);
        const open = (point) => { if (point.customdata !== undefined) location.assign(`${this.base}/trials/${point.customdata}`); };
        this.each.set(name, new Chart(at, () => this.#against(name), { name: `${this.study}-${name}`, onClick: open }));
        saveSmall(frame, `${this.study}-${name}`, () => this.each.get(name));
      }
      this.each.get(name).draw();
    }
  }

  #against(name) {
    const told = thinned(this.trials.all().filter((trial) => trial.value !== null && trial.position !== null), []);
    const title = this.units[name] ? `${name} (${this.units[name]})` : name;
    const axes = { x: { title, more: this.space[name]?.log ? { type: "log" } : {} }, y: { title: this.value.title }, margin: { t: 6, r: 6 } };
    if (!told.length) return { traces: [], empty: "No value yet.", ...axes };
    return {
      traces: [{
        type: "scatter", mode: "markers", x: told.map((t) => t.params[name]), y: told.map((t) => t.value), customdata: told.map((t) => t.number),
        text: told.map((t) => `trial ${t.number}<br>${name} ${number(t.params[name])}<br>${this.value.title} ${number(t.value)}${easier(t)}`), hoverinfo: "text",
        marker: { size: 6, color: colour("complete"), opacity: told.map((t) => (answers(t) ? 0.75 : 0.3)) },
      }],
      ...axes,
    };
  }
}
