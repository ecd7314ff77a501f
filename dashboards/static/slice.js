// What the search believes: a slice through its surrogate over two parameters, and what was tried there. Where there is
// one parameter only, the slice is a line and its deviation a band around it.
//
// The samples come from the record on the page, so they are live; the surrogate is asked for again when it has learnt.
import { Chart, SYMBOLS, colour, series } from "./chart.js";
import { STATES, number } from "./format.js";
import { api } from "./live.js";
import { element, setText } from "./plain.js";
import { Sliders } from "./sliders.js";
import { answers } from "./trials.js";
import { thinned } from "./valuechart.js";

// Cividis, which reads the same with every kind of colour vision; and one hue for what isn't known.
export const SCALE = [[0, "#00224e"], [0.25, "#434e6c"], [0.5, "#7d7c78"], [0.75, "#bcaf6f"], [1, "#fee838"]];
const UNSURE = [[0, "#f7f4ee"], [0.35, "#d8c9e3"], [0.7, "#9a79b8"], [1, "#4b2466"]];
const UNSURE_DARK = [[0, "#20242a"], [0.35, "#4b3c5e"], [0.7, "#9a79b8"], [1, "#ead9f7"]];
// Marks that are seen on every colour of both scales, and on the paper of the legend.
const OVER = { failed: "#f2641c", running: "#12b88c", queued: "#12b88c" };
const PATIENCE = 180;
const LEAST_PAUSE = 2000;
// Share of the time that the service may be busy with slices that nobody but new trials asked for.
const SHARE = 0.05;
const MOST_PAUSE = 15_000;

export class SliceView {
  #asked = 0;
  #timer = 0;
  #last = 0;
  #took = 0;

  constructor({ base, study, trials, behaviour, units, space, value, hasDifficulty, dark }) {
    Object.assign(this, { base, study, trials, behaviour, units, space, value, dark });
    const [x, y, shows] = ["map-x", "map-y", "map-colour"].map((id) => document.getElementById(id));
    Object.assign(this, { x, y, shows });
    const address = new URLSearchParams(location.search);
    this.names = Object.keys(space);
    const outputs = [...(behaviour ? [["novelty", "novelty"], ...behaviour.names.map((name, i) => [`feature:${i}`, name])] : []), ["value", value.title], ["feasible", "chance to complete"]];
    const fill = (select, options, chosen) => select.replaceChildren(...options.map(([key, text]) => element("option", { value: key, textContent: text, selected: key === chosen })));
    const named = this.names.map((name) => [name, name]);
    fill(x, named, address.get("x") ?? this.names[0]);
    fill(y, named, address.get("y") ?? this.names.find((name) => name !== x.value) ?? this.names[0]);
    fill(shows, outputs, address.get("output") ?? outputs[0][0]);
    y.parentElement.hidden = this.names.length === 1;
    this.outputs = new Map(outputs);
    const open = (point) => { if (point.customdata !== undefined) location.assign(`${base}/trials/${point.customdata}`); };
    this.mean = new Chart(document.getElementById("map"), () => this.#mean(), { name: `${study}-surrogate-mean`, onClick: open });
    this.deviation = new Chart(document.getElementById("unsure"), () => this.#deviation(), { name: `${study}-surrogate-uncertainty`, onClick: open });
    this.sliders = new Sliders(document.getElementById("sliders"), { space, units, hasDifficulty, address, onChange: () => this.#changed() });
    for (const select of [x, y, shows]) {
      select.onchange = () => {
        // Two times the same axis would be a line: the other one gives way.
        if (x.value === y.value && this.names.length > 1) (select === x ? y : x).value = this.names.find((name) => name !== select.value);
        this.sliders.show([x.value, y.value]);
        this.#changed();
      };
    }
    this.sliders.show([x.value, y.value]);
    document.getElementById("at-best").onclick = () => { const best = this.#best(); if (best) { this.sliders.set(best.params, best.z); this.#changed(); } };
    document.getElementById("at-next").onclick = () => { if (this.slice?.next) { this.sliders.set(this.slice.next.params, this.slice.next.z); this.#changed(); } };
  }

  #best() {
    return this.trials.history().filter(answers)
      .reduce((best, trial) => (best === null || trial.value > best.value ? trial : best), null);
  }

  // The choices are in the address, so that a link shows the same slice.
  #changed() {
    const query = new URLSearchParams({ x: this.x.value, y: this.y.value, output: this.shows.value });
    for (const [key, value] of this.sliders.query()) query.set(key, value);
    history.replaceState(null, "", `?${query}`);
    this.mean.draw();
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#ask(), PATIENCE);
  }

  async #ask() {
    const turn = ++this.#asked;
    this.#last = Date.now();
    const query = new URLSearchParams({ x: this.x.value, y: this.y.value, output: this.shows.value, size: 40 });
    if (this.x.value === this.y.value) query.delete("y");
    for (const [key, value] of this.sliders.query()) query.set(key, value);
    document.getElementById("slice").setAttribute("aria-busy", "true");
    try {
      const slice = await api(`${this.base}/slice?${query}`);
      if (turn !== this.#asked) return;
      this.#took = Date.now() - this.#last;
      this.slice = slice;
      this.sliders.follow(slice.others);
      setText("slice-note", slice.note ?? "");
    } catch (error) {
      if (turn !== this.#asked) return;
      this.slice = null;
      setText("slice-note", error.message);
    } finally {
      if (turn === this.#asked) document.getElementById("slice").removeAttribute("aria-busy");
    }
    document.getElementById("at-next").hidden = !this.slice?.next;
    document.getElementById("unsure-panel").hidden = !this.#has("deviation");
    document.getElementById("slice").classList.toggle("alone", !this.#has("deviation"));
    this.mean.draw();
    this.deviation.draw();
  }

  draw({ history } = {}) {
    document.getElementById("at-best").hidden = !this.#best();
    this.mean.draw();
    if (!history && this.slice !== undefined) return;
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#ask(), Math.max(0, this.#last + Math.min(MOST_PAUSE, Math.max(LEAST_PAUSE, this.#took / SHARE)) - Date.now()));
  }

  #has(which) {
    const rows = this.slice?.[which];
    return Array.isArray(rows) && rows.length > 0 && this.slice.y !== null && this.slice.x.name === this.x.value && this.slice.y.name === this.y.value;
  }

  #axes() {
    const axis = (name) => ({ title: this.units[name] ? `${name} (${this.units[name]})` : name, more: this.space[name]?.log ? { type: "log" } : {} });
    return { x: axis(this.x.value), y: axis(this.y.value), legend: true, margin: { r: 8, t: 46 } };
  }

  #heat(values, scale) {
    const { x, y } = this.slice;
    return {
      type: "heatmap", x: x.values, y: y.values, z: values, colorscale: scale, showscale: false, zsmooth: "fast", hoverongaps: false,
      hovertemplate: `${x.name} %{x:.4g}<br>${y.name} %{y:.4g}<br>%{z:.4g}<extra></extra>`,
    };
  }

  #legend(id, values, text, scale) {
    const flat = values.flat().filter((value) => typeof value === "number");
    const [low, high] = [Math.min(...flat), Math.max(...flat)];
    this.#ends(id, flat.length ? [low, high] : null, text, scale);
  }

  // Not plotly's own scale: it sets style attributes, which our policy refuses.
  #ends(id, range, text, scale) {
    const at = document.getElementById(id);
    at.hidden = range === null;
    if (range === null) return;
    at.dataset.scale = scale;
    at.firstElementChild.textContent = `${text} ${number(range[0], 3)}`;
    at.lastElementChild.textContent = number(range[1], 3);
  }

  outcome(trial) {
    const what = this.shows.value;
    if (what === "value") return trial.value;
    if (what.startsWith("feature:")) return trial.features?.[Number(what.slice(8))] ?? null;
    return null;
  }

  #words(trial) {
    const why = !trial.mode ? "" : trial.mode === "given" ? "<br>given by the study" : `<br>proposed to ${trial.mode}`;
    return `trial ${trial.number} · ${trial.state}<br>${this.value.title} ${number(trial.value)}${why}`;
  }

  #samples(coloured) {
    const [x, y] = [this.x.value, this.y.value];
    const all = this.trials.all();
    const place = (some) => ({
      type: "scatter", mode: "markers", x: some.map((t) => t.params[x]), y: some.map((t) => t.params[y]), customdata: some.map((t) => t.number),
      text: some.map((t) => this.#words(t)), hoverinfo: "text",
    });
    const near = new Map((this.slice?.samples ?? []).map((sample) => [sample.number, sample.near ?? 1]));
    const finished = thinned(all.filter((trial) => trial.state === "complete"), []);
    const traces = [];
    if (finished.length) {
      const told = finished.map((trial) => this.outcome(trial));
      traces.push({
        ...place(finished), name: "finished",
        marker: coloured && told.some((value) => value !== null)
          ? { size: 9, color: told, colorscale: SCALE, line: { width: 0.8, color: colour("ink") } }
          // What lies far from this slice, in the parameters that it doesn't show, is small and pale.
          : { size: finished.map((t) => 5 + 4 * (near.get(t.number) ?? 1)), opacity: finished.map((t) => 0.35 + 0.65 * (near.get(t.number) ?? 1)), color: "#ffffff", line: { width: 1.2, color: "#15181b" } },
      });
    }
    for (const state of STATES) {
      const of = thinned(all.filter((trial) => trial.state === state && state !== "complete" && state !== "cancelled"), []);
      if (of.length) traces.push({ ...place(of), name: state, marker: { size: 10, symbol: SYMBOLS[state], color: coloured ? colour(state) : OVER[state] ?? OVER.failed, line: { width: 2.2, color: coloured ? colour(state) : OVER[state] ?? OVER.failed } } });
    }
    const next = this.slice?.next;
    if (next && next.params[x] !== undefined) {
      traces.push({
        type: "scatter", mode: "markers", name: "next proposal", x: [next.params[x]], y: [next.params[y]], hoverinfo: "text", text: ["what the search would ask for next"],
        marker: { size: 15, symbol: "star", color: "#e69f00", line: { width: 1.4, color: "#15181b" } },
      });
    }
    return traces;
  }

  // One parameter: what is expected along it, how far that may be off, and what came.
  #line() {
    const { x, mean, deviation, y } = this.slice ?? {};
    const traces = [];
    if (mean?.length && y === null) {
      const band = (factor) => mean[0].map((value, i) => value + factor * deviation[0][i]);
      if (deviation?.length) {
        traces.push({
          type: "scatter", mode: "lines", name: "one deviation", x: [...x.values, ...x.values.toReversed()], y: [...band(1), ...band(-1).toReversed()],
          fill: "toself", fillcolor: colour("line"), line: { width: 0 }, hoverinfo: "skip",
        });
      }
      traces.push({ type: "scatter", mode: "lines", name: "expected", x: x.values, y: mean[0], line: { width: 2, color: series(0) }, hoverinfo: "x+y" });
    }
    const came = thinned(this.trials.all().filter((trial) => this.outcome(trial) !== null), []);
    if (came.length) {
      traces.push({
        type: "scatter", mode: "markers", name: "finished", x: came.map((t) => t.params[this.x.value]), y: came.map((t) => this.outcome(t)),
        customdata: came.map((t) => t.number), text: came.map((t) => this.#words(t)), hoverinfo: "text", marker: { size: 8, color: colour("ink") },
      });
    }
    this.#ends("scale", null);
    const axes = this.#axes();
    return { traces, empty: "The first proposals appear here.", ...axes, y: { title: this.slice?.output?.label ?? this.outputs.get(this.shows.value) } };
  }

  #mean() {
    if (this.names.length === 1) return this.#line();
    if (this.#has("mean")) {
      this.#legend("scale", this.slice.mean, this.slice.output?.label ?? this.outputs.get(this.shows.value), "mean");
      return { traces: [this.#heat(this.slice.mean, SCALE), ...this.#samples(false)], ...this.#axes(), always: true };
    }
    const traces = this.#samples(true);
    const told = this.trials.all().map((trial) => this.outcome(trial)).filter((value) => value !== null);
    this.#ends("scale", told.length ? [Math.min(...told), Math.max(...told)] : null, this.outputs.get(this.shows.value), "mean");
    return { traces, empty: "The first proposals appear here.", ...this.#axes() };
  }

  #deviation() {
    if (!this.#has("deviation")) return { traces: [], empty: "No surrogate yet.", ...this.#axes() };
    this.#legend("scale-unsure", this.slice.deviation, "standard deviation", "unsure");
    const traces = this.#samples(false).map((trace) => ({ ...trace, showlegend: false }));
    return { traces: [this.#heat(this.slice.deviation, this.dark() ? UNSURE_DARK : UNSURE), ...traces], ...this.#axes() };
  }
}
