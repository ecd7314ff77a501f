// The gallery: one card for each distinct strategy, and how far they are apart. Asked for when the history has grown.
import { feature, number } from "./format.js";
import { api, whenSeen } from "./live.js";
import { element, setText } from "./plain.js";
import { facingName, poseName } from "./posewords.js";
import { distance, distanceWords } from "./spaces.js";

const MOST_DISTANCES = 8;

// A task that names what it did knows best.
function told(name) { return typeof name === "string" && name ? name[0].toUpperCase() + name.slice(1) : null; }

// A trial that is like one of the strategies, and no better, changes a count only: that may wait. A hundred people who
// watch a busy study would otherwise all ask for all strategies at every trial.
const SOON = 1000;
const LATER = 20_000;

export class Strategies {
  #asked = -1;
  #busy = false;
  #timer = 0;
  #due = Infinity;

  constructor({ base, trials, behaviour, value, light }) {
    Object.assign(this, { base, trials, behaviour, value, light });
  }

  // Finished trials: asked for again soon where they may change the gallery, else some time later.
  onTrials(trials, tell) {
    const ended = trials.filter((trial) => trial.state === "complete" && trial.features !== null);
    if (!ended.length) return;
    const wait = ended.some((trial) => this.#matters(trial)) ? SOON : LATER * (1 + Math.random());
    const at = performance.now() + (this.found?.strategies.length ? wait : 0);
    if (at >= this.#due) return;
    clearTimeout(this.#timer);
    this.#due = at;
    this.#timer = setTimeout(() => whenSeen(() => this.refresh(tell)), at - performance.now());
  }

  #matters(trial) {
    if (!this.found || this.found.distance === null) return true;
    // What the task's own audit refused is nobody's strategy.
    if (trial.details.audit?.passed === false) return false;
    // The best stands for all that are like it: nobody who is as good and alike is there, or it changes nothing.
    return !this.found.strategies.some((one) => (one.value ?? -Infinity) >= (trial.value ?? -Infinity) && distance(this.behaviour, one.features, trial.features) <= this.found.distance);
  }

  async refresh(tell) {
    clearTimeout(this.#timer);
    this.#due = Infinity;
    const length = this.trials.history().length;
    if (this.#busy || length === this.#asked) return;
    this.#busy = true;
    this.#asked = length;
    try {
      this.found = await api(`${this.base}/strategies?limit=1000`);
      this.draw(this.found);
      tell(this.found.strategies);
    } catch {
      this.#asked = -1;
      this.#timer = setTimeout(() => whenSeen(() => this.refresh(tell)), LATER);
    } finally {
      this.#busy = false;
    }
  }

  draw({ strategies, distance: apart }) {
    setText("fact-distinct", String(strategies.length));
    const gallery = document.getElementById("gallery");
    const moving = strategies.filter((found) => found.replay).slice(0, 4).map((found) => found.number);
    const together = document.getElementById("together");
    together.hidden = moving.length < 2;
    together.href = `${this.base}/trials/${moving[0]}?beside=${moving.slice(1).join()}`;
    setText("strategies-hint", apart === null ? "" : `more than ${distanceWords(this.behaviour, apart)} apart`);
    if (!strategies.length) {
      gallery.replaceChildren(element("p", { className: "empty", textContent: "The first strategy appears here as soon as a trial completes." }));
      this.#distances([]);
      return;
    }
    const focused = document.activeElement?.closest?.(".strategy")?.dataset.number;
    const cards = new Map([...gallery.querySelectorAll(".strategy")].map((card) => [card.dataset.key, card]));
    // A task without pictures: its cards are words only.
    gallery.classList.toggle("plain", !strategies.some((found) => found.pose));
    // A card that hasn't changed stays the same element: its picture isn't loaded again and nothing jumps.
    gallery.replaceChildren(...strategies.map((found, index) => cards.get(this.#key(found, index)) ?? this.#card(found, index)));
    if (focused) gallery.querySelector(`[data-number="${focused}"]`)?.focus();
    this.#distances(strategies);
  }

  #key(found, index) { return `${index} ${found.number} ${found.members} ${found.pose}`; }

  #card(found, index) {
    const { behaviour } = this;
    const coordinates = behaviour.names.map((one, i) => `${one.replaceAll("_", " ")} ${feature(found.features[i], behaviour.unit)}`).join(", ");
    // An inclination has a name; a direction all the way round is best told by its degrees.
    const inclined = behaviour.names[0] === "facing" && behaviour.kind === "euclidean";
    const name = told(found.details.name) ?? poseName(found.details.rotation) ?? (inclined ? facingName(found.features[0]) : told(coordinates));
    const where = behaviour.kind === "rotation" ? (typeof found.details.facing === "number" ? `facing ${feature(found.details.facing, "rad")}` : "") : name === told(coordinates) ? "" : coordinates;
    const picture = element("span", { className: "picture" });
    if (found.pose) picture.append(element("img", { src: `/api/v1${this.base}/trials/${found.number}/artifacts/pose.png`, alt: `The pose of trial ${found.number}: ${name}`, loading: "lazy", width: 480, height: 360 }));
    else picture.append("no picture");
    const card = element(
      "a", { className: "strategy", href: `${this.base}/trials/${found.number}`, dataset: { number: found.number, key: this.#key(found, index) } }, picture,
      element("span", { className: "rank", textContent: index + 1, "aria-hidden": "true" }),
      element("span", { className: "words" },
        element("strong", { textContent: name }),
        element("span", { className: "figure", textContent: `${this.value.name} ${number(found.value)}${this.value.unit ? ` ${this.value.unit}` : ""}` }),
        ...(where ? [element("span", { textContent: where })] : []),
        element("span", { textContent: `trial ${found.number}${found.members > 1 ? `, and ${found.members - 1} like it` : ""}` })),
    );
    card.onmouseenter = card.onfocus = () => this.light(found.number);
    card.onmouseleave = card.onblur = () => this.light(-1);
    return card;
  }

  #distances(strategies) {
    const at = document.getElementById("distances");
    if (!at) return;
    const shown = strategies.slice(0, MOST_DISTANCES);
    at.hidden = shown.length < 2;
    if (at.hidden) return;
    const head = element("tr", {}, element("th", { scope: "col" }, element("span", { className: "hide", textContent: "Strategy" })), ...shown.map((_, index) => element("th", { scope: "col", className: "num", textContent: index + 1 })));
    const rows = shown.map((one, row) => element("tr", {}, element("th", { scope: "row", textContent: row + 1 }), ...shown.map((other, column) => element(
      "td", { className: "num", textContent: row === column ? "·" : distanceWords(this.behaviour, distance(this.behaviour, one.features, other.features)) },
    ))));
    at.querySelector("table").replaceChildren(element("thead", {}, head), element("tbody", {}, ...rows));
    setText("distances-note", strategies.length > shown.length ? `the first ${shown.length} of ${strategies.length}` : "");
  }
}
