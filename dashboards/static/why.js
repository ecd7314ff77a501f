// Why each trial was proposed: how many of each kind so far, and every proposal with the figures that decided it.
import { Chart, counted, series } from "./chart.js";
import { feature, number, stateText } from "./format.js";
import { api } from "./live.js";
import { element, setText } from "./plain.js";
import { distance, distanceWords } from "./spaces.js";

const NEWEST = 60;
// What the figures of a proposal are, for people; others keep their own name.
const WORDS = {
  start: "a first look: no model yet", explore: "explore: the model knows least there", diversify: "diversify: furthest from every known behaviour",
  "diversify inside": "diversify, away from the edges of the space", improve: "improve: likely better than the best", "learn easy": "learn at a lower difficulty, where it is cheap",
  given: "given by the study: tried before the search decides", ucb: "highest upper confidence bound",
};

export class Why {
  constructor({ base, study, trials, behaviour }) {
    Object.assign(this, { base, trials, behaviour });
    this.infos = new Map();
    this.chart = new Chart(document.getElementById("why"), () => this.#kinds(), { name: `${study}-proposals` });
    this.body = document.querySelector("#reasons tbody");
  }

  // Frames bring what is new; what was there before is asked for once.
  async load() {
    this.infos.clear();
    const last = Math.max(-1, ...this.trials.all().slice(-1).map((trial) => trial.number));
    const page = await api(`${this.base}/trials?after=${Math.max(-1, last - NEWEST)}&limit=${NEWEST}`);
    for (const trial of page.trials) this.infos.set(trial.number, trial.info);
  }

  add(trials) { for (const trial of trials) this.infos.set(trial.number, trial.info); }

  draw() {
    this.chart.draw();
    const newest = this.trials.all().slice(-NEWEST).reverse();
    setText("reasons-note", this.trials.rows.size > NEWEST ? `the newest ${NEWEST} of ${this.trials.rows.size}` : "");
    const signature = newest.map((trial) => `${trial.number}${trial.state}${this.infos.has(trial.number)}`).join();
    if (signature === this.signature) return;
    this.signature = signature;
    this.body.replaceChildren(...newest.map((trial) => this.#row(trial)));
    if (!newest.length) this.body.append(element("tr", {}, element("td", { className: "empty", colSpan: 4, textContent: "The first proposals appear here." })));
  }

  #row(trial) {
    const { mode, predicted, ...figures } = this.infos.get(trial.number) ?? {};
    const kind = mode ?? trial.mode ?? trial.stage;
    const said = Object.entries(figures).filter(([, value]) => typeof value === "number" || typeof value === "string").map(([name, value]) => `${name.replaceAll("_", " ")} ${number(value, 3)}`);
    // Four coordinates of a rotation tell nobody anything: how far it came from where it was expected does.
    if (this.behaviour?.kind === "rotation" && Array.isArray(predicted) && predicted.length === 4 && trial.features) {
      return this.#line(trial, kind, said, `came ${distanceWords(this.behaviour, distance(this.behaviour, predicted, trial.features))} from there`);
    }
    const expected = Array.isArray(predicted) ? this.#behaviour(predicted) : typeof predicted === "number" ? number(predicted, 3) : "";
    const came = trial.state === "complete" ? (trial.features && Array.isArray(predicted) ? this.#behaviour(trial.features) : number(trial.value, 3)) : stateText(trial.state);
    return this.#line(trial, kind, said, expected ? `${expected} → ${came}` : came);
  }

  #line(trial, kind, said, came) {
    return element("tr", { dataset: { number: trial.number } },
      element("td", { className: "num" }, element("a", { href: `${this.base}/trials/${trial.number}`, textContent: trial.number })),
      element("td", {}, element("span", { textContent: WORDS[kind] ?? kind }), ...(trial.warm_start === null ? [] : [element("span", { className: "faint", textContent: `, from the policy of trial ${trial.warm_start}` })])),
      element("td", { className: "faint", textContent: said.join(" · ") }),
      element("td", { textContent: came }));
  }

  #behaviour(features) { return features.map((value) => feature(value, this.behaviour?.kind === "rotation" ? "" : this.behaviour?.unit ?? "")).join(" "); }

  // The balance of exploring and using, in the order in which the proposals were made.
  #kinds() {
    const all = this.trials.all();
    const axes = { x: { title: "trial", more: counted(all.map((t) => t.number)) }, y: { title: "proposals so far", more: counted([0, all.length]) }, legend: true, always: true };
    const modes = [...new Set(all.map((trial) => trial.mode ?? trial.stage))];
    if (!all.length) return { traces: [], empty: "The first proposals appear here.", ...axes };
    const step = Math.max(1, Math.floor(all.length / 1000));
    const traces = modes.map((mode, index) => {
      let count = 0;
      const y = all.map((trial) => ((trial.mode ?? trial.stage) === mode ? ++count : count));
      const keep = (list) => list.filter((_, i) => i % step === 0 || i === list.length - 1);
      return { type: "scatter", mode: "lines", name: mode, x: keep(all.map((t) => t.number)), y: keep(y), line: { shape: "hv", width: 1.8, color: series(index) }, hoverinfo: "name+y" };
    });
    return { traces, ...axes };
  }
}
