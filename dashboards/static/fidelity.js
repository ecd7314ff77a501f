// A study with difficulties: what each level cost, what was found there, and which policy came from which.
import { Chart, SYMBOLS, colour } from "./chart.js";
import { STATES, amount, number } from "./format.js";
import { onTheme, element } from "./plain.js";
import { svg } from "./svg.js";

const MOST_NODES = 500;

export class Fidelity {
  constructor({ base, study, trials, value }) {
    Object.assign(this, { base, trials, value });
    const open = (point) => { if (point.customdata !== undefined) location.assign(`${base}/trials/${point.customdata}`); };
    this.ladder = new Chart(document.getElementById("ladder"), () => this.#ladder(), { name: `${study}-ladder`, onClick: open });
    this.costs = new Chart(document.getElementById("costs"), () => this.#costs(), { name: `${study}-cost-by-difficulty` });
    this.at = document.getElementById("lineage");
    onTheme(() => this.#lineage());
    new ResizeObserver(() => this.#lineage()).observe(this.at);
  }

  get trialsWithLevel() { return this.trials.all().filter((trial) => trial.z !== null); }

  draw() {
    const some = this.trialsWithLevel.length > 0;
    document.getElementById("fidelity").hidden = !some;
    if (!some) return;
    this.ladder.draw();
    this.costs.draw();
    this.#lineage();
  }

  #ladder() {
    const axes = { x: { title: "difficulty z", more: { range: [-0.06, 1.06] } }, y: { title: this.value.title }, legend: true };
    const told = this.trialsWithLevel.filter((trial) => trial.value !== null);
    if (!told.length) return { traces: [], empty: "The first finished trial appears here.", ...axes };
    const traces = STATES.flatMap((state) => {
      const of = told.filter((trial) => trial.state === state);
      return of.length ? [{
        type: "scatter", mode: "markers", name: state, x: of.map((t) => t.z), y: of.map((t) => t.value), customdata: of.map((t) => t.number),
        text: of.map((t) => `trial ${t.number}<br>difficulty ${number(t.z, 3)}<br>${this.value.title} ${number(t.value)}<br>${amount(t.samples)} samples`), hoverinfo: "text",
        marker: { symbol: SYMBOLS[state], size: 8, color: colour(state === "cancelled" ? "queued" : state), opacity: 0.8 },
      }] : [];
    });
    return { traces, ...axes };
  }

  levels() {
    const levels = new Map();
    const distinct = new Set(this.trialsWithLevel.map((trial) => trial.z));
    // A continuous difficulty is gathered into tenths, or every bar would be one trial.
    const level = (z) => (distinct.size > 12 ? Math.min(9, Math.floor(z * 10)) / 10 + 0.05 : z);
    for (const trial of this.trialsWithLevel) {
      const known = levels.get(level(trial.z)) ?? { z: level(trial.z), trials: 0, samples: 0, seconds: 0 };
      levels.set(known.z, { z: known.z, trials: known.trials + 1, samples: known.samples + trial.samples, seconds: known.seconds + trial.seconds });
    }
    return [...levels.values()].sort((a, b) => a.z - b.z);
  }

  #costs() {
    const levels = this.levels();
    const gaps = levels.slice(1).map((level, i) => level.z - levels[i].z);
    const width = Math.min(0.08, ...(gaps.length ? gaps.map((gap) => gap * 0.7) : [0.08]));
    return {
      traces: [{
        type: "bar", x: levels.map((l) => l.z), y: levels.map((l) => l.samples), width: levels.map(() => width), marker: { color: colour("complete"), opacity: 0.85 },
        text: levels.map((l) => `${l.trials}`), textposition: "outside", cliponaxis: false, hoverinfo: "text",
        hovertext: levels.map((l) => `difficulty ${number(l.z, 3)}<br>${l.trials} trials<br>${amount(l.samples)} samples`),
      }],
      x: { title: "difficulty z (number of trials above each bar)", more: { range: [-0.06, 1.06] } }, y: { title: "samples (control steps)", more: { tickformat: "~s" } },
    };
  }

  // Trials from left to right in their order, the difficulty upwards; a curve leads from a policy to who started with it.
  #lineage() {
    const all = this.trialsWithLevel;
    if (!all.length || !this.at.clientWidth) return;
    const parents = new Set(all.map((trial) => trial.warm_start).filter((parent) => parent !== null));
    const linked = all.filter((trial) => trial.warm_start !== null || parents.has(trial.number));
    if (!linked.length) {
      this.at.replaceChildren(element("p", { className: "empty", textContent: "No trial started from another's policy yet." }));
      return;
    }
    const nodes = (all.length > MOST_NODES ? linked.slice(-MOST_NODES) : all);
    const [width, height, left, foot, top] = [Math.max(320, this.at.clientWidth), 280, 46, 40, 14];
    const [first, last] = [nodes[0].number, nodes.at(-1).number];
    const x = (trial) => left + 10 + (last === first ? 0.5 : (trial.number - first) / (last - first)) * (width - left - 30);
    const y = (trial) => height - foot - trial.z * (height - foot - top - 10) - 5;
    const known = new Map(nodes.map((trial) => [trial.number, trial]));
    const root = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "group", "aria-label": `Lineage of ${nodes.length} trials` });
    const soft = { fill: colour("soft"), "font-size": 11 };
    for (const level of [0, 0.25, 0.5, 0.75, 1]) {
      const at = y({ z: level });
      root.append(svg("line", { x1: left, x2: width - 8, y1: at, y2: at, stroke: colour("line") }), svg("text", { x: left - 6, y: at + 4, "text-anchor": "end", ...soft }, String(level)));
    }
    root.append(
      svg("text", { x: 12, y: (height - foot) / 2, transform: `rotate(-90 12 ${(height - foot) / 2})`, "text-anchor": "middle", ...soft }, "difficulty z"),
      svg("text", { x: (left + width) / 2, y: height - 6, "text-anchor": "middle", ...soft }, "trial"),
      svg("text", { x: x(nodes[0]), y: height - 22, "text-anchor": "middle", ...soft }, String(first)), svg("text", { x: x(nodes.at(-1)), y: height - 22, "text-anchor": "middle", ...soft }, String(last)),
    );
    const edges = svg("g", { fill: "none" });
    for (const trial of nodes) {
      const parent = known.get(trial.warm_start);
      if (!parent) continue;
      const [x1, y1, x2, y2] = [x(parent), y(parent), x(trial), y(trial)];
      // Between trials of one level a curve has to bow, or all would lie on one line.
      const bow = Math.abs(y1 - y2) < 12 ? Math.min(46, 0.35 * (x2 - x1)) * (y1 > height / 2 ? -1 : 1) : 0;
      edges.append(svg("path", { d: `M ${x1} ${y1} C ${(x1 + x2) / 2} ${y1 + bow}, ${(x1 + x2) / 2} ${y2 + bow}, ${x2} ${y2}`, stroke: colour("soft"), "stroke-width": 1.1, "stroke-opacity": 0.6, "data-from": parent.number, "data-to": trial.number }));
    }
    root.append(edges);
    for (const trial of nodes) {
      const mark = svg("a", { href: `${this.base}/trials/${trial.number}`, "data-number": trial.number, tabindex: -1 });
      const done = trial.state === "complete";
      mark.append(
        svg("circle", { cx: x(trial), cy: y(trial), r: 5, fill: done ? colour("complete") : colour("sheet"), stroke: colour(trial.state === "cancelled" ? "queued" : trial.state), "stroke-width": 1.6 }),
        svg("title", {}, `trial ${trial.number}, ${trial.state}, difficulty ${number(trial.z, 3)}, ${this.value.title} ${number(trial.value)}${trial.warm_start === null ? "" : `, from trial ${trial.warm_start}`}`),
      );
      mark.addEventListener("mouseenter", () => this.#follow(edges, known, trial.number));
      mark.addEventListener("mouseleave", () => this.#follow(edges, known, null));
      root.append(mark);
    }
    this.at.replaceChildren(root);
  }

  // All ancestors and all descendants of one trial.
  #follow(edges, known, number) {
    const family = new Set();
    for (let at = number; at !== null && at !== undefined && !family.has(at); at = known.get(at)?.warm_start ?? null) family.add(at);
    const below = [number];
    for (let i = 0; number !== null && i < below.length; i++) for (const trial of known.values()) if (trial.warm_start === below[i]) { below.push(trial.number); family.add(trial.number); }
    for (const edge of edges.children) {
      const lit = number !== null && family.has(Number(edge.dataset.from)) && family.has(Number(edge.dataset.to));
      edge.setAttribute("stroke", colour(lit ? "accent" : "soft"));
      edge.setAttribute("stroke-width", lit ? 2.2 : 1.1);
    }
  }
}
