// Parameters against outcomes: any two on a map, all of them together, each against the value, and why it was asked.
import { Chart, SERIES, SYMBOLS, colour } from "./chart.js";
import { STATES, number } from "./format.js";
import { element, onTheme } from "./plain.js";
import { thinned } from "./valuechart.js";

const SVG = "http://www.w3.org/2000/svg";
const MOST_LINES = 400;
// Cividis, which reads the same with every kind of colour vision.
const SCALE = [[0, "#00224e"], [0.25, "#434e6c"], [0.5, "#7d7c78"], [0.75, "#bcaf6f"], [1, "#fee838"]];

export class Parameters {
  constructor({ study, trials, behaviour, units, space }) {
    Object.assign(this, { study, trials, behaviour, units, space });
    const open = (point) => { if (point.customdata !== undefined) location.assign(`/studies/${encodeURIComponent(study)}/trials/${point.customdata}`); };
    this.map = new Chart(document.getElementById("map"), () => this.#map(), { name: `${study}-map`, onClick: open });
    this.why = new Chart(document.getElementById("why"), () => this.#why(), { name: `${study}-proposals`, onClick: open });
    this.each = new Map();
    this.open = open;
    this.picked = new Map();
    [this.x, this.y, this.by] = ["map-x", "map-y", "map-colour"].map((id) => document.getElementById(id));
    const address = new URLSearchParams(location.search);
    this.wanted = { x: address.get("x"), y: address.get("y"), by: address.get("colour") };
    for (const select of [this.x, this.y, this.by]) {
      select.onchange = () => {
        history.replaceState(null, "", `?${new URLSearchParams({ x: this.x.value, y: this.y.value, colour: this.by.value })}`);
        this.map.draw();
      };
    }
    onTheme(() => this.#lines());
    new ResizeObserver(() => this.#lines()).observe(document.getElementById("lines"));
  }

  title(name) { return this.units[name] ? `${name} (${this.units[name]})` : name; }

  draw() {
    const names = this.trials.parameters;
    const outcomes = ["value", ...(this.behaviour?.names ?? []).map((name) => `feature ${name}`), "trial"];
    this.#fill(this.x, names, this.wanted.x ?? names[0]);
    this.#fill(this.y, names, this.wanted.y ?? names[1] ?? names[0]);
    this.#fill(this.by, outcomes, this.wanted.by ?? "value");
    this.map.draw();
    this.why.draw();
    this.#lines();
    const box = document.getElementById("each");
    for (const name of names) {
      if (!this.each.has(name)) {
        const at = element("div", { dataset: { parameter: name } });
        box.append(at);
        this.each.set(name, new Chart(at, () => this.#against(name), { name: `${this.study}-${name}`, onClick: this.open }));
      }
      this.each.get(name).draw();
    }
  }

  #fill(select, options, chosen) {
    if (select.dataset.options === options.join()) return;
    select.dataset.options = options.join();
    select.replaceChildren(...options.map((option) => element("option", { textContent: option, selected: option === chosen })));
  }

  outcome(trial, what) {
    if (what === "value") return trial.value;
    if (what === "trial") return trial.number;
    const index = this.behaviour.names.indexOf(what.replace("feature ", ""));
    return trial.features?.[index] ?? null;
  }

  axisOf(name) {
    const known = this.space[name] ?? {};
    return { title: this.title(name), more: known.log ? { type: "log" } : {} };
  }

  #map() {
    const [x, y, by] = [this.x.value, this.y.value, this.by.value];
    const all = this.trials.all();
    const axes = { x: this.axisOf(x), y: this.axisOf(y), legend: true };
    if (!all.length) return { traces: [], empty: "The first proposals appear here.", ...axes };
    const traces = [];
    const told = all.filter((trial) => this.outcome(trial, by) !== null && trial.position !== null);
    const shown = thinned(told, []);
    // Not plotly's own scale: it sets style attributes, which our policy refuses.
    document.getElementById("scale").hidden = !shown.length;
    if (shown.length) {
      const range = shown.map((t) => this.outcome(t, by));
      document.getElementById("scale-low").textContent = `${by} ${number(Math.min(...range), 3)}`;
      document.getElementById("scale-high").textContent = number(Math.max(...range), 3);
      traces.push({
        type: "scatter", mode: "markers", name: "finished", x: shown.map((t) => t.params[x]), y: shown.map((t) => t.params[y]), customdata: shown.map((t) => t.number),
        text: shown.map((t) => `trial ${t.number}<br>${by} ${number(this.outcome(t, by))}${t.mode ? `<br>proposed to ${t.mode}` : ""}`), hoverinfo: "text",
        marker: {
          size: 9, color: shown.map((t) => this.outcome(t, by)), colorscale: SCALE, line: { width: 0.8, color: colour("ink") },
        },
      });
    }
    for (const state of STATES) {
      const of = all.filter((t) => t.state === state && (t.position === null || this.outcome(t, by) === null) && state !== "cancelled");
      if (!of.length) continue;
      traces.push({
        type: "scatter", mode: "markers", name: state, x: of.map((t) => t.params[x]), y: of.map((t) => t.params[y]), customdata: of.map((t) => t.number),
        text: of.map((t) => `trial ${t.number}<br>${state}`), hoverinfo: "text",
        marker: { size: 10, symbol: SYMBOLS[state], color: colour(state), line: { width: 1.6, color: colour(state) } },
      });
    }
    return { traces, ...axes, margin: { r: 8 } };
  }

  // How many proposals of each kind, in the order in which they were made: the balance of exploring and using.
  #why() {
    const all = this.trials.all();
    const axes = { x: { title: "trial", more: { tickformat: "d" } }, y: { title: "proposals so far" }, legend: true, always: true };
    const modes = [...new Set(all.map((trial) => trial.mode ?? trial.stage))];
    if (!all.length) return { traces: [], empty: "The first proposals appear here.", ...axes };
    const traces = modes.map((mode, index) => {
      let count = 0;
      const y = all.map((trial) => ((trial.mode ?? trial.stage) === mode ? ++count : count));
      return { type: "scatter", mode: "lines", name: mode, x: all.map((t) => t.number), y, line: { shape: "hv", width: 1.8, color: SERIES[index % SERIES.length] }, hoverinfo: "name+y" };
    });
    return { traces, ...axes };
  }

  #against(name) {
    const told = thinned(this.trials.all().filter((trial) => trial.value !== null && trial.position !== null), []);
    const axes = { x: this.axisOf(name), y: { title: "value" }, margin: { t: 6, r: 6 } };
    if (!told.length) return { traces: [], empty: "No value yet.", ...axes };
    return {
      traces: [{
        type: "scatter", mode: "markers", x: told.map((t) => t.params[name]), y: told.map((t) => t.value), customdata: told.map((t) => t.number),
        text: told.map((t) => `trial ${t.number}<br>${name} ${number(t.params[name])}<br>value ${number(t.value)}`), hoverinfo: "text",
        marker: { size: 6, color: colour("complete"), opacity: 0.7 },
      }],
      ...axes,
    };
  }

  // Parallel coordinates. A range dragged along an axis keeps the lines that pass through it.
  #lines() {
    const at = document.getElementById("lines");
    if (at.dataset.dragging) return;
    const told = this.trials.all().filter((trial) => trial.value !== null && trial.position !== null);
    const numeric = this.trials.parameters.filter((name) => told.some((trial) => typeof trial.params[name] === "number"));
    if (!told.length || !numeric.length) {
      at.replaceChildren(element("p", { className: "empty", textContent: "Lines appear as trials finish." }));
      return;
    }
    const axes = [
      ...numeric.map((name) => ({ name, title: this.title(name), of: (t) => t.params[name], log: this.space[name]?.log })),
      ...(this.behaviour?.names ?? []).map((name, index) => ({ name: `feature.${name}`, title: name, of: (t) => t.features?.[index] ?? null })),
      { name: "value", title: "value", of: (t) => t.value },
    ];
    const [width, height, top, foot, side] = [Math.max(320, at.clientWidth), 320, 34, 20, 60];
    for (const [index, axis] of axes.entries()) {
      const values = told.map(axis.of).filter((value) => typeof value === "number");
      [axis.low, axis.high] = [Math.min(...values), Math.max(...values)];
      axis.x = side + (index * (width - 2 * side)) / (axes.length - 1);
      const scale = axis.log ? Math.log : (value) => value;
      axis.y = (value) => height - foot - (axis.high === axis.low ? 0.5 : (scale(value) - scale(axis.low)) / (scale(axis.high) - scale(axis.low))) * (height - top - foot);
    }
    const ranked = [...told].sort((a, b) => b.value - a.value);
    const step = Math.max(1, ranked.length / MOST_LINES);
    const drawn = ranked.filter((trial, index) => index < 50 || Math.floor(index / step) !== Math.floor((index - 1) / step)).reverse();
    const make = (tag, attributes, text) => {
      const made = document.createElementNS(SVG, tag);
      for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
      if (text !== undefined) made.textContent = text;
      return made;
    };
    const root = make("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `Parallel coordinates of ${drawn.length} trials` });
    const lines = make("g", { fill: "none" });
    const passes = (trial) => axes.every((axis) => {
      const range = this.picked.get(axis.name);
      const value = axis.of(trial);
      return !range || (value !== null && axis.y(value) >= range[0] && axis.y(value) <= range[1]);
    });
    const paint = () => lines.replaceChildren(...drawn.map((trial, index) => {
      const points = axes.filter((axis) => typeof axis.of(trial) === "number").map((axis) => `${axis.x.toFixed(1)},${axis.y(axis.of(trial)).toFixed(1)}`);
      const share = drawn.length > 1 ? index / (drawn.length - 1) : 1;
      const line = make("polyline", {
        points: points.join(" "), stroke: passes(trial) ? colour("accent") : colour("line"), "stroke-width": share > 0.9 ? 1.8 : 1.1,
        "stroke-opacity": passes(trial) ? 0.15 + 0.75 * share ** 3 : 0.5,
      });
      line.append(make("title", {}, `trial ${trial.number}, value ${number(trial.value)}`));
      return line;
    }));
    paint();
    root.append(lines);
    for (const axis of axes) {
      const soft = { fill: colour("soft"), "font-size": 12, "text-anchor": "middle" };
      root.append(make("line", { x1: axis.x, x2: axis.x, y1: top, y2: height - foot, stroke: colour("soft") }));
      root.append(make("text", { x: axis.x, y: 12, ...soft, fill: colour("ink") }, axis.title));
      root.append(make("text", { x: axis.x, y: top - 6, ...soft, "font-size": 11 }, number(axis.high, 3)), make("text", { x: axis.x, y: height - 4, ...soft, "font-size": 11 }, number(axis.low, 3)));
      const pick = make("rect", { x: axis.x - 7, width: 14, y: top, height: 0, fill: colour("accent"), "fill-opacity": 0.25 });
      const range = this.picked.get(axis.name);
      if (range) { pick.setAttribute("y", range[0]); pick.setAttribute("height", range[1] - range[0]); }
      const grip = make("rect", { x: axis.x - 14, width: 28, y: top - 4, height: height - top - foot + 8, fill: "transparent", "data-axis": axis.name });
      grip.style.cursor = "ns-resize";
      const where = (event) => { const box = root.getBoundingClientRect(); return Math.max(top, Math.min(height - foot, ((event.clientY - box.top) * height) / box.height)); };
      grip.onpointerdown = (event) => {
        const from = where(event);
        grip.setPointerCapture(event.pointerId);
        at.dataset.dragging = "yes";
        grip.onpointermove = (move) => {
          const to = where(move);
          const [low, high] = [Math.min(from, to), Math.max(from, to)];
          if (high - low < 3) this.picked.delete(axis.name); else this.picked.set(axis.name, [low, high]);
          pick.setAttribute("y", low);
          pick.setAttribute("height", high - low < 3 ? 0 : high - low);
          paint();
        };
        grip.onpointerup = () => {
          grip.onpointermove = null;
          delete at.dataset.dragging;
          if (Math.abs((Number(pick.getAttribute("height")) || 0)) < 3) { this.picked.delete(axis.name); pick.setAttribute("height", 0); paint(); }
        };
        // A click without a drag lets the axis go.
        this.picked.delete(axis.name);
        pick.setAttribute("height", 0);
        paint();
      };
      root.append(pick, grip);
    }
    at.replaceChildren(root);
  }
}
