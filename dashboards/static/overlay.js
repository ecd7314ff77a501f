// Learning curves of several trials on one picture, one metric at a time.
import { Chart, KINDS, counted, series } from "./chart.js";
import { api } from "./live.js";
import { metricRange, metricTitle } from "./metricwords.js";
import { element, setText } from "./plain.js";
import { answers } from "./trials.js";

const MOST = 12;
const DASHES = ["solid", "dash", "dot"];
const FIRST = ["return", "bar", "level", "success", "height", "reward", "value"];

export class Overlay {
  #timer = 0;

  constructor({ base, study, trials, task }) {
    Object.assign(this, { base, trials, task });
    const address = new URLSearchParams(location.search);
    this.metric = document.getElementById("overlay-metric");
    this.input = document.getElementById("overlay-trials");
    this.by = document.getElementById("overlay-by");
    this.metricWanted = address.get("metric");
    this.input.value = address.get("curves") ?? "";
    this.by.value = address.get("over") === "samples" ? "samples" : "iteration";
    this.curves = new Map();
    this.chart = new Chart(document.getElementById("overlay"), () => this.#describe(), { name: `${study}-curves` });
    const remember = () => {
      const query = new URLSearchParams(location.search);
      for (const [key, value] of [["metric", this.metric.value], ["curves", this.input.value.trim()], ["over", this.by.value === "samples" ? "samples" : ""]]) if (value) query.set(key, value); else query.delete(key);
      history.replaceState(null, "", query.size ? `?${query}` : location.pathname);
    };
    this.metric.onchange = this.by.onchange = () => { this.metricWanted = this.metric.value; remember(); this.chart.draw(); };
    this.input.onchange = () => { remember(); this.#load(); };
  }

  // The named ones, or the best six and what runs now.
  wanted() {
    const named = [...new Set((this.input.value.match(/\d+/g) ?? []).map(Number))].filter((number) => this.trials.rows.has(number));
    if (named.length) return named.slice(0, MOST);
    const all = this.trials.all();
    const best = all.filter((trial) => answers(trial) && trial.iteration > 0).sort((a, b) => b.value - a.value).slice(0, 6);
    return [...best, ...all.filter((trial) => trial.state === "running" && trial.iteration > 0).slice(0, 4)].map((trial) => trial.number);
  }

  draw() {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#load(), this.curves.size ? 2000 : 0);
  }

  async #load() {
    const wanted = this.wanted();
    try {
      await Promise.all(wanted.map(async (number) => {
        const known = this.curves.get(number);
        if (known && known.iteration === this.trials.rows.get(number)?.iteration) return;
        const metrics = await api(`${this.base}/trials/${number}/metrics`);
        this.curves.set(number, { ...metrics, iteration: metrics.iterations.at(-1) ?? 0 });
      }));
    } catch (error) {
      setText("overlay-note", error.message);
      return;
    }
    setText("overlay-note", this.input.value.trim() && !wanted.length ? "no such trial" : "");
    const names = [...new Set(wanted.flatMap((number) => Object.keys(this.curves.get(number).series)))];
    if (this.metric.dataset.names !== names.join()) {
      this.metric.dataset.names = names.join();
      const rank = (name) => { const at = FIRST.findIndex((word) => name.includes(word)); return at < 0 ? FIRST.length : at; };
      const chosen = names.includes(this.metricWanted) ? this.metricWanted : [...names].sort((a, b) => rank(a) - rank(b))[0];
      this.metric.replaceChildren(...names.map((name) => element("option", { value: name, textContent: name.replaceAll("_", " "), selected: name === chosen })));
    }
    this.chart.draw();
  }

  #describe() {
    const metric = this.metric.value;
    const bySamples = this.by.value === "samples";
    const shown = this.wanted().filter((number) => this.curves.get(number)?.series[metric]);
    const iterations = shown.flatMap((number) => this.curves.get(number).iterations);
    const axes = {
      x: { title: bySamples ? "samples (control steps)" : "iteration", more: bySamples ? { tickformat: "~s" } : counted(iterations) },
      y: { title: metric ? metricTitle(metric, this.task) : "metric", more: metricRange(metric) ? { range: metricRange(metric) } : {} }, legend: true, always: true,
    };
    const traces = shown.map((number, index) => {
      const { iterations, series: metrics } = this.curves.get(number);
      const x = bySamples && metrics.samples ? metrics.samples : iterations;
      return {
        type: "scatter", mode: iterations.length > 1 ? "lines" : "markers", name: `trial ${number}`, x, y: metrics[metric], hovertemplate: `trial ${number}<br>${bySamples ? "samples" : "iteration"} %{x}<br>${metric} %{y:.4g}<extra></extra>`,
        line: { width: 1.7, color: series(index), dash: DASHES[Math.floor(index / KINDS) % DASHES.length] },
      };
    });
    return { traces, empty: "Curves appear as trials report their first iterations.", ...axes };
  }
}
