// The space of behaviours: every outcome where it belongs, the distinct strategies by name.
//
// A circle is drawn as one (angle = the behaviour, radius = the value); a vector as a plane of two of its
// coordinates; a rotation as the directions in which the body's forward axis points, on a map of the sphere.
import { colour } from "./chart.js";
import { feature, number } from "./format.js";
import { onTheme } from "./plain.js";

const SVG = "http://www.w3.org/2000/svg";
const SIZE = 320;
const MOST = 1500;

function svg(tag, attributes = {}, text = null) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== null) made.textContent = text;
  return made;
}

// The forward axis (x) of a body turned by the unit quaternion x y z w.
export function forward([x, y, z, w]) {
  return [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)];
}

// Lambert's equal-area projection of a unit vector seen from +z, the whole sphere in a disc of radius 1.
export function lambert([x, y, z]) {
  const k = Math.sqrt(1 / Math.max(1e-9, 1 + z)) / Math.SQRT2;
  return [x * k, y * k];
}

export class BehaviourChart {
  constructor(at, { study, trials, behaviour, onHover = () => {} }) {
    this.at = at;
    this.study = study;
    this.trials = trials;
    this.behaviour = behaviour;
    this.onHover = onHover;
    this.strategies = [];
    onTheme(() => this.draw());
  }

  hint() {
    return {
      circle: `angle: ${this.behaviour.names[0]}; distance from the centre: value`,
      euclidean: this.behaviour.names.length > 2 ? `the first two of ${this.behaviour.names.length} features` : "",
      rotation: "where the body's forward axis points, equal-area, seen from above",
    }[this.behaviour.kind];
  }

  draw() {
    if (this.queued) return;
    this.queued = true;
    requestAnimationFrame(() => { this.queued = false; this.#draw(); });
  }

  place(trial, range) {
    const { kind } = this.behaviour;
    const half = SIZE / 2;
    if (kind === "circle") {
      const share = trial.value === null || range.high === range.low ? 1 : (trial.value - range.low) / (range.high - range.low);
      const radius = (0.25 + 0.75 * share) * (half - 40);
      return [half + radius * Math.cos(trial.features[0]), half - radius * Math.sin(trial.features[0])];
    }
    if (kind === "rotation") {
      const [x, y] = lambert(forward(trial.features));
      return [half + x * (half - 30), half - y * (half - 30)];
    }
    const along = (index) => {
      const [low, high] = range.axes[index];
      return high === low ? 0.5 : ((trial.features[index] ?? 0) - low) / (high - low);
    };
    const two = this.behaviour.names.length > 1;
    return [46 + along(0) * (SIZE - 62), two ? SIZE - 40 - along(1) * (SIZE - 56) : half];
  }

  range(trials) {
    const values = trials.map((trial) => trial.value).filter((value) => value !== null);
    const axes = this.behaviour.names.map((_, index) => {
      const found = trials.map((trial) => trial.features[index]);
      return [this.behaviour.low[index] ?? Math.min(...found), this.behaviour.high[index] ?? Math.max(...found)];
    });
    return { low: Math.min(...values), high: Math.max(...values), axes };
  }

  #draw() {
    let trials = this.trials.all().filter((trial) => trial.features !== null);
    if (!trials.length) {
      this.at.replaceChildren(Object.assign(document.createElement("p"), { className: "empty", textContent: "Behaviours appear here as trials finish." }));
      return;
    }
    const range = this.range(trials);
    const names = new Map(this.strategies.map((strategy, index) => [strategy.number, index + 1]));
    if (trials.length > MOST) {
      const step = Math.ceil(trials.length / MOST);
      trials = trials.filter((trial, index) => index % step === 0 || names.has(trial.number));
    }
    const root = svg("svg", { viewBox: `0 0 ${SIZE} ${SIZE}`, role: "img", "aria-label": `Behaviours of ${trials.length} trials` });
    this.#frame(root, range);
    this.marks = new Map();
    for (const trial of trials) {
      const [x, y] = this.place(trial, range);
      const rank = names.get(trial.number);
      const mark = svg("a", { href: `/studies/${encodeURIComponent(this.study)}/trials/${trial.number}`, "data-number": trial.number });
      const done = trial.state === "complete";
      mark.append(svg("circle", {
        cx: x, cy: y, r: rank ? 9 : 4, fill: rank ? colour("accent") : done ? colour("complete") : "none", "fill-opacity": rank ? 1 : 0.45,
        stroke: done ? colour("sheet") : colour("failed"), "stroke-width": 1.2,
      }));
      if (rank) mark.append(svg("text", { x, y: y + 3.8, "text-anchor": "middle", "font-size": 11, "font-weight": 600, fill: colour("on-accent") }, rank));
      const where = this.behaviour.names.map((name, index) => `${name} ${feature(trial.features[index], this.behaviour.unit)}`).join(", ");
      mark.append(svg("title", {}, `trial ${trial.number}: ${where}, value ${number(trial.value)}`));
      mark.addEventListener("mouseenter", () => this.onHover(trial.number));
      mark.addEventListener("mouseleave", () => this.onHover(-1));
      this.marks.set(trial.number, mark);
      if (rank) root.append(mark); else root.insertBefore(mark, root.querySelector("[data-front]"));
    }
    this.at.replaceChildren(root);
  }

  #frame(root, range) {
    const half = SIZE / 2;
    const line = { stroke: colour("line"), fill: "none" };
    const soft = { fill: colour("soft"), "font-size": 11 };
    if (this.behaviour.kind === "circle") {
      for (const share of [0.25, 0.625, 1]) root.append(svg("circle", { cx: half, cy: half, r: share * (half - 40), ...line }));
      for (let turn = 0; turn < 8; turn++) {
        const angle = (turn * Math.PI) / 4;
        const [c, s] = [Math.cos(angle), Math.sin(angle)];
        root.append(svg("line", { x1: half + 0.25 * (half - 40) * c, y1: half - 0.25 * (half - 40) * s, x2: half + (half - 40) * c, y2: half - (half - 40) * s, ...line }));
        const degrees = turn > 4 ? turn * 45 - 360 : turn * 45;
        root.append(svg("text", { x: half + (half - 20) * c, y: half - (half - 20) * s + 4, "text-anchor": "middle", ...soft }, `${String(degrees).replace("-", "−")}°`));
      }
      if (range.high > range.low) {
        root.append(svg("text", { x: half + 4, y: half - 0.25 * (half - 40) - 3, ...soft }, number(range.low, 3)));
        root.append(svg("text", { x: half + 4, y: half - (half - 40) - 3, ...soft }, number(range.high, 3)));
      }
    } else if (this.behaviour.kind === "rotation") {
      root.append(svg("circle", { cx: half, cy: half, r: half - 30, ...line }));
      root.append(svg("circle", { cx: half, cy: half, r: (half - 30) / Math.SQRT2, "stroke-dasharray": "3 4", ...line }));
      for (const [x, y, text] of [[half, half + 4, "up"], [half, 22, "+y (left of the run-up)"], [half, SIZE - 14, "−y"], [SIZE - 14, half + 4, "+x"], [14, half + 4, "−x"]]) {
        root.append(svg("text", { x, y, "text-anchor": "middle", ...soft }, text));
      }
    } else {
      const two = this.behaviour.names.length > 1;
      const unit = this.behaviour.unit ? ` (${this.behaviour.unit})` : "";
      root.append(svg("rect", { x: 46, y: 16, width: SIZE - 62, height: SIZE - 56, ...line }));
      const [low, high] = range.axes[0];
      root.append(svg("text", { x: 46, y: SIZE - 26, ...soft }, number(low, 3)));
      root.append(svg("text", { x: SIZE - 16, y: SIZE - 26, "text-anchor": "end", ...soft }, number(high, 3)));
      root.append(svg("text", { x: (SIZE + 30) / 2, y: SIZE - 12, "text-anchor": "middle", ...soft }, this.behaviour.names[0] + unit));
      if (two) {
        const [bottom, top] = range.axes[1];
        root.append(svg("text", { x: 42, y: SIZE - 40, "text-anchor": "end", ...soft }, number(bottom, 3)));
        root.append(svg("text", { x: 42, y: 26, "text-anchor": "end", ...soft }, number(top, 3)));
        root.append(svg("text", { x: 14, y: half, "text-anchor": "middle", transform: `rotate(-90 14 ${half})`, ...soft }, this.behaviour.names[1] + unit));
      }
    }
    root.append(svg("g", { "data-front": "" }));
  }

  light(number) {
    for (const mark of this.at.querySelectorAll(".lit-mark")) mark.remove();
    const mark = this.marks?.get(number)?.querySelector("circle");
    if (!mark) return;
    const ring = svg("circle", { class: "lit-mark", cx: mark.getAttribute("cx"), cy: mark.getAttribute("cy"), r: Number(mark.getAttribute("r")) + 4, fill: "none", stroke: colour("ink"), "stroke-width": 1.6 });
    this.at.querySelector("svg").append(ring);
  }
}
