// What happened in a study, newest first. Progress of single iterations is left out unless asked for.
import { moment } from "./format.js";
import { eventText } from "./eventwords.js";
import { api } from "./live.js";
import { element } from "./plain.js";

const MOST = 2000;

export class Events {
  constructor(at, tools, base) {
    this.at = at;
    this.base = base;
    this.known = new Map();
    this.progress = element("input", { type: "checkbox" });
    this.progress.onchange = () => this.draw();
    tools.append(element("label", {}, this.progress, " every iteration"), element("span", { className: "hint", id: "events-note", role: "status" }));
  }

  // The newest events; older ones than MOST stay on the server.
  async load() {
    this.known.clear();
    let from = "";
    for (;;) {
      const page = await api(`${this.base}/events?limit=1000${from}`);
      for (const event of page.events) this.known.set(event.id, event);
      for (const id of [...this.known.keys()].slice(0, Math.max(0, this.known.size - 20 * MOST))) this.known.delete(id);
      if (page.next === null) break;
      from = `&page=${page.next}`;
    }
    this.draw();
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

  #draw() {
    const shown = [...this.known.values()].filter((event) => this.progress.checked || event.kind !== "progress").sort((a, b) => b.id - a.id);
    const items = shown.slice(0, MOST).map((event) => this.item(event));
    this.at.replaceChildren(...items);
    if (!items.length) this.at.append(element("li", { className: "empty", textContent: "Nothing has happened yet." }));
    document.getElementById("events-note").textContent = shown.length > MOST ? `the newest ${MOST} of ${shown.length} events` : `${shown.length} events`;
  }

  item(event) {
    const trial = event.trial === null
      ? element("span", { className: "faint", textContent: "study" })
      : element("a", { href: `${this.base}/trials/${event.trial}`, textContent: `trial ${event.trial}` });
    return element("li", { dataset: { id: event.id } }, element("time", { dateTime: event.at, textContent: moment(event.at), title: event.at }), trial, element("span", { textContent: eventText(event) }));
  }
}
