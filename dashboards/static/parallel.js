// Parallel coordinates. A range dragged along an axis keeps the lines that pass through it.
import { colour } from "./chart.js";
import { number } from "./format.js";
import { element, onTheme } from "./plain.js";
import { svg } from "./svg.js";
import { answers } from "./trials.js";

const MOST_LINES = 400;

export class Parallel {
  constructor(at, { study, trials, behaviour, units, space, value }) {
    Object.assign(this, { at, study, trials, behaviour, units, space, value });
    this.picked = new Map();
    onTheme(() => this.draw());
    new ResizeObserver(() => this.draw()).observe(at);
  }

  #axes(told) {
    const numeric = this.trials.parameters.filter((name) => told.some((trial) => typeof trial.params[name] === "number"));
    const title = (name, unit) => (unit ? `${name} (${unit})` : name);
    return [
      ...numeric.map((name) => ({ name, title: title(name, this.units[name]), of: (t) => t.params[name], log: this.space[name]?.log })),
      ...(this.behaviour && this.behaviour.kind !== "rotation" ? this.behaviour.names : []).map((name, index) => ({ name: `feature.${name}`, title: title(name, this.behaviour.kind === "rotation" ? "" : this.behaviour.unit), of: (t) => t.features?.[index] ?? null })),
      // Beside the value, which means little without it.
      ...(told.some((trial) => trial.z !== null && trial.z !== 1) ? [{ name: "difficulty", title: "difficulty", of: (t) => t.z }] : []),
      { name: "value", title: this.value.title, of: (t) => t.value },
    ];
  }

  #passes(axes, trial) {
    return axes.every((axis) => {
      const range = this.picked.get(axis.name);
      const value = axis.of(trial);
      return !range || (value !== null && axis.y(value) >= range[0] && axis.y(value) <= range[1]);
    });
  }

  draw() {
    const { at } = this;
    if (at.dataset.dragging || !at.clientWidth) return;
    const told = this.trials.all().filter((trial) => trial.value !== null && trial.position !== null);
    const axes = this.#axes(told);
    if (!told.length || axes.length < 2) {
      at.replaceChildren(element("p", { className: "empty", textContent: "Lines appear as trials finish." }));
      return;
    }
    const [width, height, top, foot, side] = [Math.max(320, at.clientWidth), 320, 34, 20, 60];
    for (const [index, axis] of axes.entries()) {
      const values = told.map(axis.of).filter((value) => typeof value === "number");
      [axis.low, axis.high] = [Math.min(...values), Math.max(...values)];
      axis.x = side + (index * (width - 2 * side)) / (axes.length - 1);
      const scale = axis.log ? Math.log : (value) => value;
      axis.y = (value) => height - foot - (axis.high === axis.low ? 0.5 : (scale(value) - scale(axis.low)) / (scale(axis.high) - scale(axis.low))) * (height - top - foot);
    }
    // What is behind: values of easier versions, however high.
    const ranked = [...told].sort((a, b) => answers(b) - answers(a) || b.value - a.value);
    const step = Math.max(1, ranked.length / MOST_LINES);
    const drawn = ranked.filter((trial, index) => index < 50 || Math.floor(index / step) !== Math.floor((index - 1) / step)).reverse();
    const root = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `Parallel coordinates of ${drawn.length} trials` });
    const lines = svg("g", { fill: "none" });
    const paint = () => lines.replaceChildren(...drawn.map((trial, index) => {
      const points = axes.filter((axis) => typeof axis.of(trial) === "number").map((axis) => `${axis.x.toFixed(1)},${axis.y(axis.of(trial)).toFixed(1)}`);
      const share = drawn.length > 1 ? index / (drawn.length - 1) : 1;
      const passes = this.#passes(axes, trial);
      return svg("polyline", {
        points: points.join(" "), stroke: passes ? colour("accent") : colour("line"), "stroke-width": share > 0.9 ? 1.8 : 1.1,
        "stroke-opacity": passes ? 0.15 + 0.75 * share ** 3 : 0.5,
      }, svg("title", {}, `trial ${trial.number}, ${this.value.title} ${number(trial.value)}`));
    }));
    paint();
    root.append(lines);
    const few = width / axes.length < 90;
    for (const [index, axis] of axes.entries()) {
      const soft = { fill: colour("soft"), "font-size": few ? 10 : 12, "text-anchor": "middle" };
      // On a phone every other title stands below its neighbours, or they would lie on each other.
      const title = few ? axis.name.replace("feature.", "").slice(0, 9) : axis.title;
      root.append(
        svg("line", { x1: axis.x, x2: axis.x, y1: top, y2: height - foot, stroke: colour("soft") }),
        svg("text", { x: axis.x, y: few && index % 2 ? 22 : 11, ...soft, fill: colour("ink") }, title),
        ...(few ? [] : [svg("text", { x: axis.x, y: top - 6, ...soft, "font-size": 11 }, number(axis.high, 3)), svg("text", { x: axis.x, y: height - 4, ...soft, "font-size": 11 }, number(axis.low, 3))]),
        ...this.#grip(axis, { root, top, bottom: height - foot, height, paint }),
      );
    }
    at.replaceChildren(root);
  }

  #grip(axis, { root, top, bottom, height, paint }) {
    const pick = svg("rect", { x: axis.x - 7, width: 14, y: top, height: 0, fill: colour("accent"), "fill-opacity": 0.25 });
    const range = this.picked.get(axis.name);
    if (range) { pick.setAttribute("y", range[0]); pick.setAttribute("height", range[1] - range[0]); }
    const grip = svg("rect", { x: axis.x - 14, width: 28, y: top - 4, height: bottom - top + 8, fill: "transparent", "data-axis": axis.name, class: "grip" });
    const where = (event) => { const box = root.getBoundingClientRect(); return Math.max(top, Math.min(bottom, ((event.clientY - box.top) * height) / box.height)); };
    const letGo = () => { this.picked.delete(axis.name); pick.setAttribute("height", 0); paint(); };
    grip.onpointerdown = (event) => {
      const from = where(event);
      grip.setPointerCapture(event.pointerId);
      this.at.dataset.dragging = "yes";
      grip.onpointermove = (move) => {
        const [low, high] = [Math.min(from, where(move)), Math.max(from, where(move))];
        if (high - low < 3) { letGo(); return; }
        this.picked.set(axis.name, [low, high]);
        pick.setAttribute("y", low);
        pick.setAttribute("height", high - low);
        paint();
      };
      grip.onpointerup = grip.onpointercancel = () => {
        grip.onpointermove = null;
        delete this.at.dataset.dragging;
      };
      // A click without a drag lets the axis go.
      letGo();
    };
    return [pick, grip];
  }
}
