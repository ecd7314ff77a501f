// Value against trial, samples or time: every outcome, and the best so far.
import { Chart, SYMBOLS, colour, counted } from "./chart.js";
import { STATES, amount, number } from "./format.js";
import { answers } from "./trials.js";

const MOST = 2000;

// The bests and an even sample of the rest: 10,000 marks tell no more than 2,000 and take five times as long.
export function thinned(points, keep) {
  if (points.length <= MOST) return points;
  const step = points.length / MOST;
  const chosen = new Set(keep);
  for (let i = 0; i < points.length; i += step) chosen.add(points[Math.floor(i)]);
  return points.filter((point) => chosen.has(point));
}

// For a mark's hover, where its value is of an easier version of the task.
export function easier(trial) {
  return answers(trial) || trial.state !== "complete" ? "" : `<br>difficulty ${number(trial.z, 3)} only`;
}

export class ValueChart {
  constructor(at, { study, trials, value, by = "trial" }) {
    this.trials = trials;
    this.value = value;
    this.by = by;
    this.chart = new Chart(at, () => this.describe(), {
      name: `${study}-value`,
      onClick: (point) => { if (point.customdata !== undefined) location.assign(`/studies/${encodeURIComponent(study)}/trials/${point.customdata}`); },
    });
  }

  draw() { this.chart.draw(); }

  points() {
    let samples = 0;
    let best = -Infinity;
    const history = this.trials.history();
    const start = Math.min(...history.map((t) => t.started ?? Infinity));
    return history.map((trial) => {
      samples += trial.samples;
      const isBest = answers(trial) && trial.value > best;
      if (isBest) best = trial.value;
      const x = this.by === "trial" ? trial.number : this.by === "samples" ? samples : ((trial.finished ?? start) - start) / 60;
      return { trial, x, best: Number.isFinite(best) ? best : null, isBest };
    });
  }

  describe() {
    const points = this.points();
    const title = { trial: "trial", samples: "samples spent (control steps)", time: "time since the first trial started (min)" }[this.by];
    const valued = points.filter((point) => point.trial.value !== null);
    const base = { x: { title, more: this.by === "trial" ? counted(points.map((point) => point.x)) : { tickformat: "~s" } }, y: { title: this.value.title }, legend: true };
    if (this.by === "time") base.x.more = {};
    if (!points.length) return { traces: [], empty: "The first finished trial appears here.", ...base };
    const traces = [];
    const bests = points.filter((point) => point.isBest);
    if (bests.length) {
      // A step holds its height until the next best; the last one until now.
      const line = [...bests, { ...bests.at(-1), x: Math.max(...points.map((point) => point.x)) }];
      traces.push({
        type: "scatter", mode: "lines", name: "best so far", x: line.map((p) => p.x), y: line.map((p) => p.best),
        line: { shape: "hv", color: colour("ink"), width: 1.2, dash: "dot" }, hoverinfo: "skip",
      });
    }
    const shown = thinned(valued, bests);
    for (const state of STATES) {
      const of = shown.filter((point) => point.trial.state === state);
      if (!of.length) continue;
      traces.push({
        type: "scatter", mode: "markers", name: state, x: of.map((p) => p.x), y: of.map((p) => p.trial.value), customdata: of.map((p) => p.trial.number),
        text: of.map((p) => `trial ${p.trial.number}<br>${this.value.title} ${number(p.trial.value)}${easier(p.trial)}<br>${amount(p.trial.samples)} samples`), hoverinfo: "text",
        marker: { symbol: SYMBOLS[state], size: 7, color: colour(state === "cancelled" ? "queued" : state), opacity: of.map((p) => (p.trial.z === null || p.trial.z === 1 ? 0.85 : 0.35)), line: { width: 1.4, color: colour(state) } },
      });
    }
    // What ended without a value still cost something: a mark at the foot of the chart.
    const without = thinned(points.filter((point) => point.trial.value === null), []);
    for (const state of STATES) {
      const of = without.filter((point) => point.trial.state === state);
      if (!of.length) continue;
      const low = Math.min(0, ...valued.map((point) => point.trial.value));
      traces.push({
        type: "scatter", mode: "markers", name: `${state}, no value`, x: of.map((p) => p.x), y: of.map(() => low), customdata: of.map((p) => p.trial.number),
        text: of.map((p) => `trial ${p.trial.number}<br>${state}`), hoverinfo: "text",
        marker: { symbol: SYMBOLS[state], size: 8, color: colour(state), line: { width: 1.4, color: colour(state) } }, cliponaxis: false,
      });
    }
    return { traces, ...base };
  }
}
