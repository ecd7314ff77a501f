// How far a study is: words, and a bar with one segment a state.
import { element } from "./plain.js";
import { amount, number } from "./format.js";

const FINAL = ["complete", "infeasible", "diverged", "failed"];

export function finished(study) {
  return FINAL.reduce((sum, state) => sum + (study.trials[state] ?? 0), 0);
}

export function share(study) {
  const parts = [];
  if (study.target_trials) parts.push(finished(study) / study.target_trials);
  if (study.target_cost) parts.push(study.cost.samples / study.target_cost);
  return parts.length ? Math.min(1, Math.max(...parts)) : null;
}

export const runningWords = (study) => (study.trials.running ? `${number(study.trials.running)} running` : "");

export function progressWords(study) {
  const done = finished(study);
  const goal = study.target_trials ? ` of ${number(study.target_trials)}` : "";
  const cost = study.target_cost ? `, ${amount(study.cost.samples)} of ${amount(study.target_cost)} samples` : "";
  return `${number(done)}${goal} done${cost}`;
}

export function drawProgress(bar, study) {
  const known = [...FINAL, "running"].map((state) => [state, study.trials[state] ?? 0]);
  const all = Math.max(study.target_trials ?? 0, known.reduce((sum, [, count]) => sum + count, 0), 1);
  const text = known.filter(([, count]) => count).map(([state, count]) => `${count} ${state}`).join(", ");
  bar.setAttribute("aria-label", text || "no trials yet");
  bar.title = text;
  for (const [state, count] of known) {
    let part = bar.querySelector(`[data-state="${state}"]`);
    if (!part && count) {
      part = element("i", { dataset: { state } });
      // In the order of `known`, whichever state came first.
      const order = known.map(([one]) => one);
      bar.insertBefore(part, [...bar.children].find((other) => order.indexOf(other.dataset.state) > order.indexOf(state)) ?? null);
    }
    if (part) part.style.width = `${(100 * count) / all}%`;
  }
}
