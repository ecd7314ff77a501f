// Numbers, times and states in words: the same as dashboards/words.py says on the server.
export const GLYPHS = {
  queued: "○", running: "◐", paused: "‖", complete: "●", infeasible: "◇", diverged: "≈", failed: "✕",
  cancelled: "–", lost: "⌁", preempted: "‖",
};
export const STATES = ["complete", "infeasible", "diverged", "failed", "cancelled", "running", "queued"];

const THIN = "\u202f";

export function number(value, digits = 4) {
  if (value === null || value === undefined) return "–";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value !== "number") return String(value);
  if (Number.isInteger(value) && Math.abs(value) < 1e15) return value.toLocaleString("en").replaceAll(",", THIN).replace("-", "−");
  const short = Math.abs(value) >= 1e-4 && Math.abs(value) < 1e7 ? String(Number(value.toPrecision(digits))) : value.toExponential(digits - 1);
  return short.replaceAll("-", "−");
}

export function amount(value) {
  for (const [size, letter] of [[1e9, "G"], [1e6, "M"], [1e3, "k"]]) {
    if (Math.abs(value) >= size) return `${Number((value / size).toPrecision(3))}${THIN}${letter}`;
  }
  return String(Number(value.toPrecision(3)));
}

export function bytes(value) { return `${amount(value)}${amount(value).includes(THIN) ? "B" : `${THIN}B`}`; }

export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "–";
  if (seconds < 10) return `${seconds.toFixed(1)}${THIN}s`;
  let whole = Math.round(seconds);
  const parts = [];
  for (const [size, unit] of [[86400, "d"], [3600, "h"], [60, "min"], [1, "s"]]) {
    const count = Math.floor(whole / size);
    whole -= count * size;
    if (count || parts.length) parts.push(`${count}${THIN}${unit}`);
    if (parts.length === 2) break;
  }
  return parts.join(" ");
}

export function moment(iso) {
  const at = new Date(iso);
  const today = at.toDateString() === new Date().toDateString();
  return today
    ? at.toLocaleTimeString("en-GB")
    : `${at.toLocaleDateString("en-CA")} ${at.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" })}`;
}

export function feature(value, unit) {
  if (unit === "rad") return `${Math.round((value * 180) / Math.PI)}°`.replace("-", "−");
  return number(value, 3) + (unit ? `${THIN}${unit}` : "");
}

export function stateText(state) {
  return `${GLYPHS[state] ?? "·"} ${state}`;
}
