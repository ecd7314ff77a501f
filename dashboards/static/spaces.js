// The kinds of behaviour space, each with where an outcome stands, its frame, and how far two outcomes are apart.
//
// place(trial) gives [x, y, visible] in a square of SIZE; frame(root) draws what doesn't depend on the trials, and
// words(root) what has to be read over them.
import { colour } from "./chart.js";
import { feature, number } from "./format.js";
import { svg } from "./svg.js";

export const SIZE = 340;
const HALF = SIZE / 2;
const TURN = 2 * Math.PI;

// A vector turned by the unit quaternion x y z w.
export function rotated([a, b, c], [x, y, z, w]) {
  const [p, q, r] = [y * c - z * b + w * a, z * a - x * c + w * b, x * b - y * a + w * c];
  return [a + 2 * (y * r - z * q), b + 2 * (z * p - x * r), c + 2 * (x * q - y * p)];
}

const DISTANCE = {
  circle: (a, b) => { const gap = Math.abs(a[0] - b[0]) % TURN; return Math.min(gap, TURN - gap); },
  rotation: (a, b) => {
    const [near, far] = [-1, 1].map((sign) => Math.hypot(...a.map((value, i) => value + sign * b[i])));
    return 4 * Math.atan2(Math.min(near, far), Math.max(near, far));
  },
  euclidean: (a, b) => Math.hypot(...a.map((value, i) => value - b[i])),
};

export function distance(behaviour, a, b) { return DISTANCE[behaviour.kind](a, b); }

export function distanceWords(behaviour, value) { return feature(value, behaviour.unit || (behaviour.kind === "euclidean" ? "" : "rad")); }

const line = () => ({ stroke: colour("line"), fill: "none" });
const soft = (more = {}) => ({ fill: colour("soft"), "font-size": 11, ...more });
const middle = { "text-anchor": "middle" };
// Words that marks may lie under or over: a rim in the paper's colour keeps them readable.
const rimmed = () => ({ stroke: colour("sheet"), "stroke-width": 3, "stroke-linejoin": "round", "paint-order": "stroke" });

function share(value, { low, high }) { return value === null || high === low ? 1 : (value - low) / (high - low); }

// An angle all the way round: direction the behaviour, distance from the centre the value.
class Circle {
  constructor(behaviour, range) { this.behaviour = behaviour; this.range = range; this.outer = HALF - 36; }

  // The scale is told here: words on the rings would lie under the marks.
  hint() {
    const { low, high, label } = this.range;
    const rings = high > low ? `, ${number(low, 3)} (inner ring) to ${number(high, 3)} (outer ring)` : "";
    return `direction: ${this.behaviour.names[0]}; away from the centre: ${label}${rings}`;
  }

  radius(trial) { return (0.25 + 0.75 * share(trial.value, this.range)) * this.outer; }

  place(trial) {
    const r = this.radius(trial);
    return [HALF + r * Math.cos(trial.features[0]), HALF - r * Math.sin(trial.features[0]), true];
  }

  frame(root) {
    for (const part of [0.25, 0.625, 1]) root.append(svg("circle", { cx: HALF, cy: HALF, r: part * this.outer, ...line() }));
    for (let turn = 0; turn < 8; turn++) {
      const [c, s] = [Math.cos((turn * Math.PI) / 4), Math.sin((turn * Math.PI) / 4)];
      root.append(svg("line", { x1: HALF + 0.25 * this.outer * c, y1: HALF - 0.25 * this.outer * s, x2: HALF + this.outer * c, y2: HALF - this.outer * s, ...line() }));
      const degrees = turn > 4 ? turn * 45 - 360 : turn * 45;
      root.append(svg("text", { x: HALF + (this.outer + 18) * c, y: HALF - (this.outer + 18) * s + 4, ...middle, ...soft() }, `${String(degrees).replace("-", "−")}°`));
    }
  }

  words() {}
}

// One angle between 0 and a half turn, as an inclination is: a dial that opens to the right, 0 at the top.
class Dial extends Circle {
  constructor(behaviour, range) { super(behaviour, range); this.outer = SIZE - 150; this.at = [78, HALF]; }

  hint() { return `direction: ${this.behaviour.names[0]} (0° is up); away from the centre: ${this.range.label}`; }

  place(trial) {
    const r = (0.25 + 0.75 * share(trial.value, this.range)) * (HALF - 30);
    return [this.at[0] + r * Math.sin(trial.features[0]), this.at[1] - r * Math.cos(trial.features[0]), true];
  }

  frame(root) {
    const [x, y] = this.at;
    const most = HALF - 30;
    for (const part of [0.25, 0.625, 1]) root.append(svg("path", { d: `M ${x} ${y - part * most} A ${part * most} ${part * most} 0 0 1 ${x} ${y + part * most}`, ...line() }));
    for (let degrees = 0; degrees <= 180; degrees += 30) {
      const [s, c] = [Math.sin((degrees * Math.PI) / 180), Math.cos((degrees * Math.PI) / 180)];
      root.append(svg("line", { x1: x + 0.25 * most * s, y1: y - 0.25 * most * c, x2: x + most * s, y2: y - most * c, ...line() }));
      root.append(svg("text", { x: x + (most + 17) * s, y: y - (most + 15) * c + 4, ...middle, ...soft() }, `${degrees}°`));
    }
    if (this.behaviour.names[0] === "facing") {
      for (const [text, at] of [["face up", y - most - 1], ["face down", y + most + 8]]) root.append(svg("text", { x: x - 16, y: at, "text-anchor": "end", ...soft() }, text));
    }
    if (this.range.high > this.range.low) {
      root.append(svg("text", { x: x - 6, y: y - 0.25 * most + 10, "text-anchor": "end", ...soft() }, number(this.range.low, 3)));
      root.append(svg("text", { x: x - 6, y: y - most + 24, "text-anchor": "end", ...soft() }, number(this.range.high, 3)));
      root.append(svg("text", { x: x - 26, y: y - 0.625 * most + 18, transform: `rotate(-90 ${x - 26} ${y - 0.625 * most + 18})`, ...middle, ...soft() }, this.range.label));
    }
  }
}

// A vector: two of its coordinates; a single one against the value.
class Plane {
  constructor(behaviour, range) {
    this.behaviour = behaviour;
    this.range = range;
    this.single = behaviour.names.length === 1;
  }

  hint() { return this.behaviour.names.length > 2 ? `the first two of ${this.behaviour.names.length} features` : ""; }

  along(index, trial) {
    const [low, high] = this.single && index === 1 ? [this.range.low, this.range.high] : this.range.axes[index];
    const value = this.single && index === 1 ? trial.value : trial.features[index];
    return high === low || value === null ? 0.5 : (value - low) / (high - low);
  }

  place(trial) { return [50 + this.along(0, trial) * (SIZE - 66), SIZE - 44 - this.along(1, trial) * (SIZE - 60), true]; }

  frame(root) {
    const unit = this.behaviour.unit ? ` (${this.behaviour.unit})` : "";
    root.append(svg("rect", { x: 50, y: 16, width: SIZE - 66, height: SIZE - 60, ...line() }));
    const [low, high] = this.range.axes[0];
    const [bottom, top] = this.single ? [this.range.low, this.range.high] : this.range.axes[1];
    root.append(
      svg("text", { x: 50, y: SIZE - 29, ...soft() }, number(low, 3)), svg("text", { x: SIZE - 16, y: SIZE - 29, "text-anchor": "end", ...soft() }, number(high, 3)),
      svg("text", { x: HALF + 16, y: SIZE - 12, ...middle, ...soft() }, this.behaviour.names[0] + unit),
      svg("text", { x: 46, y: SIZE - 44, "text-anchor": "end", ...soft() }, number(bottom, 3)), svg("text", { x: 46, y: 26, "text-anchor": "end", ...soft() }, number(top, 3)),
      svg("text", { x: 14, y: HALF, transform: `rotate(-90 14 ${HALF})`, ...middle, ...soft() }, this.single ? this.range.label : this.behaviour.names[1] + unit),
    );
  }

  words() {}
}

// Rotations: where the body's forward axis points, on a sphere that can be turned; a stroke shows where its head is.
class Sphere {
  constructor(behaviour, range, view = { turn: 0.9, tilt: 0.38 }) { this.behaviour = behaviour; this.range = range; this.view = view; this.radius = HALF - 34; }

  hint() { return "where the forward axis points, the stroke towards the head; drag to turn"; }

  // World (x through the bar, y up) to the screen: right, up, towards the eye.
  seen([x, y, z]) {
    const { turn, tilt } = this.view;
    const [a, b] = [x * Math.cos(turn) - z * Math.sin(turn), x * Math.sin(turn) + z * Math.cos(turn)];
    return [a, y * Math.cos(tilt) - b * Math.sin(tilt), y * Math.sin(tilt) + b * Math.cos(tilt)];
  }

  screen(vector) {
    const [x, y, depth] = this.seen(vector);
    return [HALF + x * this.radius, HALF - y * this.radius, depth >= 0];
  }

  place(trial) { return this.screen(rotated([1, 0, 0], trial.features)); }

  // The tangent towards the head, in the picture.
  stroke(trial) {
    const [x, y] = this.seen(rotated([0, 1, 0], trial.features));
    return [x * 13, -y * 13];
  }

  arc(root, at) {
    for (const front of [false, true]) {
      let path = "";
      let pen = false;
      for (let i = 0; i <= 72; i++) {
        const [x, y, visible] = this.screen(at((i / 72) * TURN));
        if (visible === front) { path += `${pen ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`; pen = true; } else pen = false;
      }
      root.append(svg("path", { d: path, ...line(), "stroke-dasharray": front ? null : "2 4" }));
    }
  }

  frame(root) {
    root.append(svg("circle", { cx: HALF, cy: HALF, r: this.radius, stroke: colour("line"), "stroke-width": 1.5, fill: colour("hover"), "fill-opacity": 0.5 }));
    this.arc(root, (t) => [Math.cos(t), 0, Math.sin(t)]);
    this.arc(root, (t) => [Math.cos(t), Math.sin(t), 0]);
    this.arc(root, (t) => [0, Math.cos(t), Math.sin(t)]);
  }

  words(root) {
    for (const [vector, text] of [[[1, 0, 0], "over the bar"], [[-1, 0, 0], "back"], [[0, 1, 0], "up"], [[0, -1, 0], "down"], [[0, 0, 1], "right"], [[0, 0, -1], "left"]]) {
      const [x, y, front] = this.screen(vector.map((value) => value * 1.1));
      root.append(svg("text", { x, y: y + 4, ...middle, ...soft(rimmed()), opacity: front ? 1 : 0.65 }, text));
    }
  }
}

export function spaceOf(behaviour, range, view) {
  if (behaviour.kind === "rotation") return new Sphere(behaviour, range, view);
  if (behaviour.kind === "circle") return new Circle(behaviour, range);
  const halfTurn = behaviour.names.length === 1 && behaviour.unit === "rad" && behaviour.low?.[0] === 0 && Math.abs((behaviour.high?.[0] ?? 0) - Math.PI) < 1e-6;
  return halfTurn ? new Dial(behaviour, range) : new Plane(behaviour, range);
}
