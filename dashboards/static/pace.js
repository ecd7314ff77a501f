// Rate and time left from the last finished trials: a mean over the whole study would hide that it has become slower.
import { amount, duration } from "./format.js";
import { api } from "./live.js";
import { finished } from "./progress.js";

const RECENT = 30;

export class Pace {
  #ended = new Map();

  constructor(base) { this.base = base; }

  async load() {
    const newest = await api(`${this.base}/window?sort=-position&limit=${RECENT}`);
    this.#ended.clear();
    this.add(newest.trials);
  }

  add(trials) {
    for (const trial of trials) {
      if (trial.position === null || trial.finished_at === null) continue;
      const ended = Date.parse(trial.finished_at) / 1000;
      this.#ended.set(trial.number, { ended, started: trial.started_at === null ? ended : Date.parse(trial.started_at) / 1000, samples: trial.cost.samples });
    }
    if (this.#ended.size > RECENT) this.#ended = new Map([...this.#ended].sort(([, a], [, b]) => b.ended - a.ended).slice(0, RECENT));
  }

  words(study) {
    const ended = [...this.#ended.values()];
    if (study.state !== "running" || ended.length < 2) return ["–", "–"];
    const span = Date.now() / 1000 - Math.min(...ended.map((trial) => trial.started));
    const samples = ended.reduce((sum, trial) => sum + trial.samples, 0);
    const left = [];
    if (study.target_trials) left.push(((study.target_trials - finished(study)) * span) / ended.length);
    if (study.target_cost && samples) left.push(((study.target_cost - study.cost.samples) * span) / samples);
    return [`${amount(samples / span)} samples/s`, left.length ? `about ${duration(Math.max(0, Math.min(...left)))}` : "no end set"];
  }
}
