// The learning curve of a trial: one small chart a metric, fetched from the last iteration known.
import { Chart, counted, series } from "./chart.js";
import { api } from "./live.js";
import { metricRange, metricTitle } from "./metricwords.js";
import { element } from "./plain.js";
import { saveSmall } from "./svg.js";

// What tells a training: one metric for each of these words, if it was reported.
const FIRST = ["return", "bar", "level", "success", "kl", "samples_per_second", "height", "reward", "value", "loss"];
const MOST = 6;
const REMEMBER = "halma-metrics";

export class Curves {
  constructor(at, choice, path, { task = "", called = "trial" } = {}) {
    this.task = task;
    this.called = called;
    this.at = at;
    this.choice = choice;
    this.path = path;
    this.iterations = [];
    this.attempts = [];
    this.series = {};
    this.charts = new Map();
    this.chosen = JSON.parse(localStorage.getItem(REMEMBER) ?? "null");
  }

  async refresh() {
    const after = this.iterations.at(-1) ?? 0;
    const news = await api(`${this.path}/metrics?after=${after}`);
    const before = this.iterations.length;
    this.iterations.push(...news.iterations);
    this.attempts.push(...news.attempts);
    for (const name of Object.keys(news.series)) this.series[name] ??= new Array(before).fill(null);
    for (const [name, values] of Object.entries(this.series)) values.push(...(news.series[name] ?? new Array(news.iterations.length).fill(null)));
    if (news.iterations.length || !this.drawn) this.draw();
  }

  async reload() {
    this.iterations = [];
    this.attempts = [];
    this.series = {};
    await this.refresh();
  }

  shown() {
    const names = Object.keys(this.series);
    if (this.chosen) return names.filter((name) => this.chosen.includes(name));
    const telling = FIRST.map((word) => names.find((name) => name === word) ?? names.find((name) => name.startsWith(word))).filter(Boolean);
    return [...new Set([...telling, ...names])].slice(0, MOST);
  }

  draw() {
    this.drawn = true;
    const names = Object.keys(this.series);
    if (!names.length) {
      this.at.replaceChildren(element("p", { className: "empty", textContent: "The curves begin with the first finished iteration." }));
      return;
    }
    const shown = this.shown();
    if (this.choice.dataset.names !== names.join()) {
      this.choice.dataset.names = names.join();
      this.choice.replaceChildren(...names.map((name) => element("button", { type: "button", textContent: name.replaceAll("_", " "), onclick: () => this.toggle(name), dataset: { metric: name } })));
    }
    for (const button of this.choice.children) button.setAttribute("aria-pressed", String(shown.includes(button.dataset.metric)));
    if (!this.charts.size) this.at.replaceChildren();
    for (const [name, { box }] of this.charts) if (!shown.includes(name)) { box.remove(); this.charts.delete(name); }
    for (const [index, name] of shown.entries()) {
      if (!this.charts.has(name)) {
        const at = element("div", { className: "small-chart" });
        const box = element("div", { dataset: { metric: name } }, at);
        this.at.append(box);
        const chart = new Chart(at, () => this.describe(name, index), { name: `${this.called}-${name}` });
        saveSmall(box, `${this.called}-${name}`, () => chart);
        this.charts.set(name, { box, chart });
      }
      this.charts.get(name).chart.draw();
    }
  }

  describe(name, index) {
    const values = this.series[name];
    return {
      traces: [{ type: "scatter", mode: values.length > 1 ? "lines" : "markers", x: this.iterations, y: values, line: { color: series(index), width: 1.6 }, hovertemplate: `iteration %{x}<br>${name} %{y:.4g}<extra></extra>` }],
      x: { title: "iteration", more: counted(this.iterations) }, y: { title: metricTitle(name, this.task), more: metricRange(name) ? { range: metricRange(name) } : {} }, margin: { t: 6, r: 6 },
      // Where a new attempt took over: a thin line, so that a step back would be seen for what it is.
      shapes: this.attempts.flatMap((attempt, at) => (at && attempt !== this.attempts[at - 1]
        ? [{ type: "line", x0: this.iterations[at] - 0.5, x1: this.iterations[at] - 0.5, yref: "paper", y0: 0, y1: 1, line: { width: 1, dash: "dot", color: "#888" } }] : [])),
    };
  }

  toggle(name) {
    const shown = this.shown();
    this.chosen = shown.includes(name) ? shown.filter((other) => other !== name) : [...shown, name];
    localStorage.setItem(REMEMBER, JSON.stringify(this.chosen));
    this.draw();
  }
}
