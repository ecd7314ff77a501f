// What happened, in words: the same as services/cli/events.py says in a terminal.
import { GLYPHS, amount, number } from "./format.js";

const WORDS = {
  created: (p) => `study created${p.target_trials ? `, for ${number(p.target_trials)} trials` : ""}`,
  deleted: (p) => `study ${p.study} deleted`,
  asked: (p) => `somebody asked to ${p.wanted === "run" ? "run it" : `${p.wanted} it`}`,
  extended: (p) => `budget raised${p.trials ? ` by ${number(p.trials)} trials` : ""}${p.cost ? ` by ${amount(p.cost)} samples` : ""}${p.rounds ? ` by ${number(p.rounds)} rounds of the polish` : ""}`,
  driven: (p) => `driven by process ${p.pid ?? "?"} on ${p.host ?? "?"}`,
  released: (p) => `now ${p.state}${p.reason ? `: ${p.reason}` : ""}`,
  waiting: (p) => `waits: ${p.reason}`,
  going_on: () => "what it waited for is there; it goes on",
  proposed: (p) => `${p.strategy ?? "the strategy"} proposed ${p.trials?.length === 1 ? "trial" : "trials"} ${(p.trials ?? []).join(", ")}`,
  started: (p) => `attempt ${p.attempt} given to ${p.worker}${p.host ? ` (${p.host})` : ""}`,
  began: (p) => `attempt ${p.attempt} runs in process ${p.pid ?? "?"} on ${p.host ?? "?"}`,
  progress: (p) => `iteration ${number(p.iteration)}${p.samples !== undefined ? `, ${amount(p.samples)} samples` : ""}`,
  finished: (p) => `${p.state}${p.value !== undefined && p.value !== null ? `, value ${number(p.value)}` : ""}${p.message ? `: ${p.message}` : ""}`,
  lost: (p) => `worker lost${p.reason ? `: ${p.reason}` : ""}; the trial is tried again`,
  preempted: (p) => `stopped at a checkpoint${p.reason ? `: ${p.reason}` : ""}; it goes on from there`,
  failed: (p) => `attempt ${p.attempt ?? ""} failed${p.reason ? `: ${p.reason}` : ""}; the trial is tried again`,
  warning: (p) => p.reason ?? p.message ?? "warning",
  refused: (p) => `refused: ${p.reason ?? p.message ?? ""}`,
};

export function eventText(event) {
  const words = WORDS[event.kind];
  if (words) return words(event.payload);
  const rest = Object.entries(event.payload).map(([name, value]) => `${name} ${typeof value === "object" ? JSON.stringify(value) : value}`).join(", ");
  return rest ? `${event.kind}: ${rest}` : event.kind;
}

const STATE_OF = { started: "queued", began: "running", lost: "lost", failed: "failed", preempted: "preempted", progress: "running", waiting: "paused", refused: "failed", warning: "infeasible" };

// The state that an event is about, for its shape and colour; none for plain news.
export function eventState(event) {
  const state = event.kind === "finished" || event.kind === "released" ? event.payload.state : STATE_OF[event.kind];
  return state in GLYPHS ? state : null;
}
