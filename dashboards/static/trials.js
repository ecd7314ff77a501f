// All trials of a study in memory: loaded as columns, kept up to date by frames.
import { api } from "./live.js";

export class Trials {
  constructor(study) {
    this.study = study;
    this.rows = new Map();
    this.parameters = [];
    this.version = 0;
  }

  async load() {
    const table = await api(`/studies/${encodeURIComponent(this.study)}/table`);
    this.rows = new Map();
    this.parameters = Object.keys(table.params);
    for (let i = 0; i < table.count; i++) {
      const params = {};
      for (const name of this.parameters) params[name] = table.params[name][i];
      this.rows.set(table.numbers[i], {
        number: table.numbers[i], state: table.states[i], stage: table.stages[i], position: table.positions[i], z: table.z[i],
        value: table.values[i], features: table.features[i], samples: table.samples[i], seconds: table.seconds[i],
        iteration: table.iterations[i], attempts: table.attempts[i], warm_start: table.warm_starts[i],
        started: table.started[i], finished: table.finished[i], mode: table.modes[i], params,
      });
    }
    this.version++;
    return table;
  }

  // Rows of a frame; whole states replace whole states, so applying one twice changes nothing.
  apply(trials) {
    for (const trial of trials) {
      this.rows.set(trial.number, {
        number: trial.number, state: trial.state, stage: trial.stage, position: trial.position, z: trial.z, value: trial.value,
        features: trial.features, samples: trial.cost.samples, seconds: trial.cost.seconds, iteration: trial.iteration,
        attempts: trial.attempts, warm_start: trial.warm_start, started: epoch(trial.started_at), finished: epoch(trial.finished_at),
        mode: typeof trial.info.mode === "string" ? trial.info.mode : null, params: trial.params,
      });
      for (const name of Object.keys(trial.params)) if (!this.parameters.includes(name)) this.parameters.push(name);
    }
    this.version++;
  }

  all() {
    if (this.sorted?.version !== this.version) {
      const list = [...this.rows.values()].sort((a, b) => a.number - b.number);
      this.sorted = { version: this.version, list };
    }
    return this.sorted.list;
  }

  // Finished trials in the order in which they ended.
  history() {
    return this.all().filter((trial) => trial.position !== null).sort((a, b) => a.position - b.position);
  }
}

// Complete, with a value, and of the real task: the values of easier versions don't compare with those of the task.
export function answers(trial) {
  return trial.state === "complete" && trial.value !== null && (trial.z === null || trial.z === 1);
}

function epoch(iso) {
  return iso === null ? null : Date.parse(iso) / 1000;
}
