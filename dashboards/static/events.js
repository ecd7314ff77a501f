// What happened in a study, newest first. Older events stay on the server until they are asked for; progress of single
// iterations is left out unless wanted. What is looked for is kept in the address.
import { GLYPHS, moment, number } from "./format.js";
import { eventState, eventText } from "./eventwords.js";
import { api } from "./live.js";
import { element } from "./plain.js";

const MOST = 2000;
// Ids of all studies' events count up together, so a stretch of ids holds at most so many of one study.
const STRETCH = 3000;
const ENOUGH = 100;

export class Events {
  constructor(at, tools, base, position) {
    Object.assign(this, { at, base, position, known: new Map(), from: 0 });
    const address = new URLSearchParams(location.search);
    this.progress = element("input", { type: "checkbox", checked: address.has("iterations") });
    this.find = element("input", { type: "search", placeholder: "Find: trial 7, lost, complete …", value: address.get("find") ?? "", "aria-label": "Find events" });
    this.progress.onchange = this.find.oninput = () => { this.#remember(); this.draw(); };
    this.note = element("span", { className: "hint", role: "status" });
    this.older = element("button", { type: "button", textContent: "Show older events", onclick: () => this.#load(this.from) });
    tools.append(this.find, element("label", { className: "field" }, this.progress, " every iteration"), this.note);
    at.after(element("p", { className: "row" }, this.older));
  }

  #remember() {
    const query = new URLSearchParams();
    if (this.find.value.trim()) query.set("find", this.find.value.trim());
    if (this.progress.checked) query.set("iterations", "yes");
    history.replaceState(null, "", query.size ? `?${query}` : location.pathname);
  }

  async load() {
    this.known.clear();
    this.from = Infinity;
    await this.#load((await api("/server")).cursor);
  }

  // A stretch of events up to `until`, and earlier ones as long as there are few.
  async #load(until) {
    this.older.disabled = true;
    let found = 0;
    try {
      for (let stretch = STRETCH; until > 0 && found < ENOUGH; stretch *= 4) {
        const from = Math.max(0, until - stretch);
        for (let place = `after=${from}`; place !== null;) {
          const page = await api(`${this.base}/events?${place}&limit=1000`);
          for (const event of page.events) if (event.id <= until) { this.known.set(event.id, event); found++; }
          place = page.next !== null && page.events.at(-1).id < until ? `page=${page.next}` : null;
        }
        this.from = until = from;
      }
    } finally {
      this.older.disabled = false;
      this.older.hidden = this.from <= 0;
      this.draw();
    }
  }

  add(frame) {
    for (const event of frame.events) this.known.set(event.id, event);
    if (frame.events.length) this.draw();
  }

  draw() {
    if (this.queued) return;
    this.queued = true;
    requestAnimationFrame(() => { this.queued = false; this.#draw(); });
  }

  #passes(event) {
    if (event.kind === "progress" && !this.progress.checked) return false;
    const word = this.find.value.trim().toLowerCase();
    const trial = /^(?:trial\s+|#)(\d+)$/.exec(word);
    if (trial) return event.trial === Number(trial[1]) || (event.kind === "proposed" && event.payload.trials?.includes(Number(trial[1])));
    return !word || `${event.kind} ${event.trial === null ? "study" : `trial ${event.trial}`} ${eventText(event)}`.toLowerCase().includes(word);
  }

  #draw() {
    const shown = [...this.known.values()].filter((event) => this.#passes(event)).sort((a, b) => b.id - a.id);
    const items = shown.slice(0, MOST).map((event) => this.item(event));
    this.at.replaceChildren(...items);
    if (!items.length) this.at.append(element("li", { className: "empty", textContent: this.known.size ? "No event matches." : "Nothing has happened yet." }));
    const more = this.older.hidden ? "" : " so far";
    this.note.textContent = shown.length > MOST ? `the newest ${number(MOST)} of ${number(shown.length)} events${more}` : `${number(shown.length)} events${more}`;
  }

  item(event) {
    const trial = event.trial === null
      ? element("span", { className: "faint", textContent: "study" })
      : element("a", { href: `${this.base}/trials/${event.trial}`, textContent: `trial ${event.trial}` });
    const state = eventState(event);
    const words = element("span", {}, element("span", { className: "state mark", dataset: { state: state ?? "" }, textContent: state ? GLYPHS[state] : "·", "aria-hidden": "true" }), eventText(event));
    return element("li", { dataset: { id: event.id, kind: event.kind } }, element("time", { dateTime: event.at, textContent: moment(event.at), title: event.at }), trial, words);
  }
}
