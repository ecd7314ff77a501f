// What a training reports, in words and with its unit.
const TITLES = {
  return_mean: "mean return", return: "return", success_rate: "success rate (share)", success: "success rate (share)", kl: "KL divergence (nats)",
  samples_per_second: "samples a second", samples: "samples (control steps)", episode_length: "episode length (control steps)", episodes: "episodes", sigma: "sigma (of the action)",
};
const METRES = new Set(["bar", "level", "level_mastered"]);
// The curriculum of a high jump is the height of its bar.
const JUMPS = new Set(["high_jump"]);

export function metricTitle(name, task = "") {
  if (METRES.has(name) && (JUMPS.has(task) || name === "bar")) return name === "level_mastered" ? "bar height mastered (m)" : "bar height (m)";
  return TITLES[name] ?? name.replaceAll("_", " ");
}

// A share lies between none and all of it, whatever was seen so far.
export function metricRange(name) { return name.startsWith("success") ? [-0.03, 1.03] : null; }
