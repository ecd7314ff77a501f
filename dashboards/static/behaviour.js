// The space of behaviours: every outcome where it belongs, the distinct strategies by number, distances on hover.
import { colour } from "./chart.js";
import { feature, number } from "./format.js";
import { element, onTheme } from "./plain.js";
import { SIZE, distance, distanceWords, spaceOf } from "./spaces.js";
import { svg } from "./svg.js";

const MOST = 1500;
const MOST_LINES = 12;

export class BehaviourChart {
  constructor(at, { study, trials, behaviour, value, onHover = () => {}, onHint = () => {} }) {
    Object.assign(this, { at, study, trials, behaviour, value, onHover, onHint });
    this.strategies = [];
    this.view = { turn: 0.9, tilt: 0.38 };
    onTheme(() => this.draw());
    if (behaviour.kind === "rotation") this.#turnable();
  }

  draw() {
    if (this.queued) return;
    this.queued = true;
    requestAnimationFrame(() => { this.queued = false; this.#draw(); });
  }

  #turnable() {
    const { at, view } = this;
    at.classList.add("turnable");
    const turn = (dx, dy) => {
      view.turn += dx;
      view.tilt = Math.max(-1.5, Math.min(1.5, view.tilt + dy));
      this.draw();
    };
    // A drag that ends on a mark is no click on it.
    at.addEventListener("click", (event) => { if (this.dragged) event.preventDefault(); }, { capture: true });
    at.addEventListener("pointerdown", (event) => {
      this.dragged = false;
      let [x, y, moved] = [event.clientX, event.clientY, 0];
      const move = (now) => {
        moved += Math.abs(now.clientX - x) + Math.abs(now.clientY - y);
        turn((now.clientX - x) * 0.01, (now.clientY - y) * 0.01);
        [x, y] = [now.clientX, now.clientY];
      };
      const up = () => {
        removeEventListener("pointermove", move);
        this.dragged = moved > 4;
      };
      addEventListener("pointermove", move);
      addEventListener("pointerup", up, { once: true });
      event.preventDefault();
    });
    at.tabIndex = 0;
    at.setAttribute("role", "group");
    at.setAttribute("aria-label", "Sphere of behaviours; the arrow keys turn it");
    at.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, -0.15], ArrowDown: [0, 0.15] }[event.key];
      if (by && event.target === at) { event.preventDefault(); turn(...by); }
    });
  }

  #range(trials) {
    const values = trials.map((trial) => trial.value).filter((value) => value !== null);
    const axes = this.behaviour.names.map((_, index) => {
      const found = trials.map((trial) => trial.features[index]);
      return [this.behaviour.low?.[index] ?? Math.min(...found), this.behaviour.high?.[index] ?? Math.max(...found)];
    });
    const [low, high] = values.length ? [Math.min(...values), Math.max(...values)] : [0, 0];
    return { low, high, axes, label: this.value.title };
  }

  words(trial) {
    const where = this.behaviour.names.map((name, index) => `${name} ${feature(trial.features[index], this.behaviour.kind === "rotation" ? "" : this.behaviour.unit)}`).join(", ");
    return `trial ${trial.number}: ${where}, ${this.value.title} ${number(trial.value)}`;
  }

  #draw() {
    let trials = this.trials.all().filter((trial) => trial.features !== null);
    if (!trials.length) {
      this.at.replaceChildren(element("p", { className: "empty", textContent: "Behaviours appear here as trials finish." }));
      return;
    }
    const space = (this.space = spaceOf(this.behaviour, this.#range(trials), this.view));
    this.onHint(space.hint());
    const names = new Map(this.strategies.map((strategy, index) => [strategy.number, index + 1]));
    if (trials.length > MOST) {
      const step = Math.ceil(trials.length / MOST);
      trials = trials.filter((trial, index) => index % step === 0 || names.has(trial.number));
    }
    const root = svg("svg", { viewBox: `0 0 ${SIZE} ${SIZE}`, role: "group", "aria-label": `Behaviours of ${trials.length} trials` });
    space.frame(root);
    const [behind, lines, front] = [svg("g"), svg("g", { "data-lines": "" }), svg("g")];
    this.places = new Map();
    for (const trial of trials) {
      const [x, y, visible] = space.place(trial);
      const rank = names.get(trial.number);
      this.places.set(trial.number, { x, y, visible, r: rank ? 10 : 4, trial });
      (rank && visible ? front : behind).append(this.#mark(trial, rank, x, y, visible, space));
    }
    const words = svg("g");
    space.words(words);
    root.append(behind, lines, words, front);
    this.at.replaceChildren(root);
    if (this.lit !== undefined && this.lit >= 0) this.light(this.lit);
  }

  #mark(trial, rank, x, y, visible, space) {
    // Only strategies take part in the tab order: a thousand outcomes would make it useless.
    const mark = svg("a", { href: `/studies/${encodeURIComponent(this.study)}/trials/${trial.number}`, "data-number": trial.number, tabindex: rank ? 0 : -1, opacity: visible ? 1 : 0.35 });
    const done = trial.state === "complete";
    if (space.stroke && visible) {
      const [dx, dy] = space.stroke(trial);
      mark.append(svg("line", { x1: x, y1: y, x2: x + dx, y2: y + dy, stroke: rank ? colour("accent") : colour("complete"), "stroke-width": 1.6 }));
    }
    mark.append(svg("circle", {
      cx: x, cy: y, r: rank ? 10 : 4, fill: rank ? colour("accent") : done ? colour("complete") : "none", "fill-opacity": rank ? 1 : 0.45,
      stroke: done ? colour("sheet") : colour("failed"), "stroke-width": 1.2,
    }));
    if (rank) mark.append(svg("text", { x, y: y + 4, "text-anchor": "middle", "font-size": 11.5, "font-weight": 600, fill: colour("on-accent") }, rank));
    mark.append(svg("title", {}, this.words(trial)));
    const [on, off] = [() => this.onHover(trial.number), () => this.onHover(-1)];
    for (const [event, act] of [["mouseenter", on], ["mouseleave", off], ["focus", on], ["blur", off]]) mark.addEventListener(event, act);
    return mark;
  }

  // A ring around one outcome, and how far the strategies are from it.
  light(wanted) {
    this.lit = wanted;
    const lines = this.at.querySelector("[data-lines]");
    for (const mark of this.at.querySelectorAll(".lit-mark")) mark.remove();
    lines?.replaceChildren();
    const from = this.places?.get(wanted);
    if (!from || !lines) return;
    for (const strategy of this.strategies.slice(0, MOST_LINES)) {
      const to = this.places.get(strategy.number);
      if (!to || strategy.number === wanted || !to.visible) continue;
      const words = distanceWords(this.behaviour, distance(this.behaviour, from.trial.features, to.trial.features));
      const [x, y] = [(from.x + to.x) / 2, (from.y + to.y) / 2];
      lines.append(
        svg("line", { x1: from.x, y1: from.y, x2: to.x, y2: to.y, stroke: colour("soft"), "stroke-width": 1, "stroke-dasharray": "3 3" }),
        svg("text", { x, y: y - 3, "text-anchor": "middle", "font-size": 11, fill: colour("ink"), stroke: colour("sheet"), "stroke-width": 3, "paint-order": "stroke" }, words),
      );
    }
    this.at.querySelector("svg").append(svg("circle", { class: "lit-mark", cx: from.x, cy: from.y, r: from.r + 4, fill: "none", stroke: colour("ink"), "stroke-width": 1.6 }));
  }
}
