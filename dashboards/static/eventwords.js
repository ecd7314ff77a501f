// What happened, in words.
import { amount, number } from "./format.js";

const WORDS = {
  created: (p) => `study created${p.target_trials ? `, for ${number(p.target_trials)} trials` : ""}`,
  deleted: (p) => `study ${p.study} deleted`,
  asked: (p) => `somebody asked to ${p.wanted === "run" ? "resume" : p.wanted}`,
  extended: (p) => `budget raised${p.trials ? ` by ${number(p.trials)} trials` : ""}${p.cost ? ` by ${amount(p.cost)} samples` : ""}`,
  driven: (p) => `driven by process ${p.pid ?? "?"} on ${p.host ?? "?"}`,
  released: (p) => `now ${p.state}${p.reason ? `: ${p.reason}` : ""}`,
  proposed: (p) => `${p.strategy ?? "the strategy"} proposed ${p.trials?.length === 1 ? "trial" : "trials"} ${(p.trials ?? []).join(", ")}`,
  started: (p) => `attempt ${p.attempt} started on ${p.worker}${p.host ? ` (${p.host})` : ""}`,
  progress: (p) => `iteration ${number(p.iteration)}${p.samples !== undefined ? `, ${amount(p.samples)} samples` : ""}`,
  finished: (p) => `${p.state}${p.value !== undefined && p.value !== null ? `, value ${number(p.value)}` : ""}${p.message ? `: ${p.message}` : ""}`,
  lost: (p) => `worker lost${p.reason ? `: ${p.reason}` : ""}; the trial is tried again`,
  preempted: (p) => `stopped at a checkpoint${p.reason ? `: ${p.reason}` : ""}`,
  failed: (p) => `attempt failed${p.reason ? `: ${p.reason}` : ""}`,
  warning: (p) => p.reason ?? p.message ?? "warning",
  refused: (p) => `refused: ${p.reason ?? p.message ?? ""}`,
};

export function eventText(event) {
  const words = WORDS[event.kind];
  if (words) return words(event.payload);
  const rest = Object.entries(event.payload).map(([name, value]) => `${name} ${typeof value === "object" ? JSON.stringify(value) : value}`).join(", ");
  return rest ? `${event.kind}: ${rest}` : event.kind;
}
