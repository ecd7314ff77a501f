// Events from a cursor over one WebSocket, and what to do when it breaks.
//
// A frame says "this is all that happened between `from` and `to`". It is applied when it joins on to what is known
// and answered with a fresh start when something lies between; so nothing gets lost between page, data and socket.

const LONGEST_WAIT = 15000;
// A network that is cut says nothing: after so long without a word the service is asked whether it is there.
const QUIET = 6000;
const PATIENCE = 4000;

export class Live {
  #cursor;
  #history;
  #socket = null;
  #wait = 500;
  #timer = 0;
  #since = null;
  #heard = Date.now();
  #asking = false;

  /**
   * position: {cursor, history} of the page; study: a name, or null for everything;
   * onFrame(frame): events, study, deleted; onReset(): load everything again, resolves to the new {cursor, history}.
   */
  constructor({ position, study = null, onFrame, onReset }) {
    this.#cursor = position.cursor;
    this.#history = position.history;
    this.study = study;
    this.onFrame = onFrame;
    this.onReset = onReset;
    addEventListener("online", () => this.#soon(0));
    addEventListener("offline", () => this.#gone(this.#socket));
    setInterval(() => this.#listen(), QUIET / 3);
    // A page that comes back from the browser's cache has a dead socket and an old picture.
    addEventListener("pageshow", (event) => { if (event.persisted) location.reload(); });
    this.#connect();
  }

  #connect() {
    const address = new URL("/api/v1/events", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.searchParams.set("after", this.#cursor);
    if (this.study !== null) address.searchParams.set("study", this.study);
    const socket = (this.#socket = new WebSocket(address));
    socket.onmessage = (message) => { for (const frame of [JSON.parse(message.data)].flat()) this.#take(socket, frame); };
    socket.onclose = () => { if (socket === this.#socket) this.#lost(); };
  }

  async #listen() {
    const socket = this.#socket;
    if (this.#asking || socket?.readyState !== WebSocket.OPEN || Date.now() - this.#heard < QUIET) return;
    this.#asking = true;
    try {
      await fetch("/healthz", { cache: "no-store", signal: AbortSignal.timeout(PATIENCE) });
      this.#heard = Date.now();
    } catch {
      this.#gone(socket);
    } finally {
      this.#asking = false;
    }
  }

  // Nobody answers at the other end, though the socket doesn't know yet.
  #gone(socket) {
    if (!socket || socket !== this.#socket) return;
    this.#socket = null;
    socket.close();
    this.#lost();
  }

  #take(socket, frame) {
    if (socket !== this.#socket) return;
    this.#heard = Date.now();
    if (frame.type === "hello") {
      this.#wait = 500;
      this.#since = null;
      this.#say("live", "live");
      document.getElementById("banner").hidden = true;
      if (frame.history !== this.#history) this.#restart();
    } else if (frame.type === "reset") {
      this.#restart();
    } else if (frame.type === "events") {
      if (frame.from > this.#cursor) { this.#restart(); return; }
      if (frame.to <= this.#cursor) return;
      frame.events = frame.events.filter((event) => event.id > this.#cursor);
      this.#cursor = frame.to;
      this.onFrame(frame);
    } else {
      this.onFrame(frame);
    }
  }

  // What is on the page may be wrong: load it again and listen from there.
  async #restart() {
    const old = this.#socket;
    this.#socket = null;
    old?.close();
    try {
      const position = await this.onReset();
      this.#cursor = position.cursor;
      this.#history = position.history;
      this.#connect();
    } catch {
      this.#lost();
    }
  }

  #lost() {
    this.#since ??= new Date();
    this.#say("waiting", "reconnecting");
    if (Date.now() - this.#since > 1500) {
      banner(`The service does not answer since ${this.#since.toLocaleTimeString("en-GB")}. What you see is from before; it is brought up to date as soon as the service is back.`);
    }
    this.#soon(this.#wait * (0.75 + Math.random() / 2));
    this.#wait = Math.min(this.#wait * 1.7, LONGEST_WAIT);
  }

  #soon(wait) {
    clearTimeout(this.#timer);
    if (this.#socket?.readyState === WebSocket.OPEN) return;
    this.#timer = setTimeout(() => this.#again(), wait);
  }

  // A browser doesn't tell why a socket was refused; a plain request does.
  async #again() {
    try {
      const answer = await fetch("/api/v1/server", { signal: AbortSignal.timeout(8000) });
      if (answer.status === 401) { location.assign(`/login?next=${encodeURIComponent(location.pathname + location.search)}`); return; }
      if (!answer.ok) { this.#lost(); return; }
    } catch {
      this.#lost();
      return;
    }
    this.#connect();
  }

  #say(state, text) {
    const link = document.getElementById("link");
    link.dataset.state = state;
    if (link.textContent !== text) link.textContent = text;
  }
}

export function banner(text) {
  const at = document.getElementById("banner");
  if (at.textContent !== text) at.textContent = text;
  at.hidden = false;
}

// The answer as JSON, or an Error that carries the service's own words.
export async function api(path, options = {}) {
  let answer;
  try {
    answer = await fetch(`/api/v1${path}`, options);
  } catch {
    throw new Error("The service does not answer. Is it still running?");
  }
  if (answer.status === 401) {
    location.assign(`/login?next=${encodeURIComponent(location.pathname + location.search)}`);
    throw new Error("The session has ended.");
  }
  const body = await answer.json();
  if (!answer.ok) throw Object.assign(new Error(body.error.message), { problem: body.error, status: answer.status });
  return body;
}

// Work that nobody would see waits until somebody looks: a tab in the background asks for nothing by itself.
export function whenSeen(work) {
  if (!document.hidden) { work(); return; }
  document.addEventListener("visibilitychange", () => whenSeen(work), { once: true });
}

export function post(path, body = {}) {
  return api(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) });
}
