// A window on the trials of a study: the service filters and sorts, and here are only the rows that somebody looks at.
//
// In the plain order a row's place follows from its number, so what the live events bring is put where it belongs and
// nothing is asked for again: a hundred people who watch cost the service next to nothing. In every other order, and
// under a filter, what may have moved is asked for again, the more rarely the longer the service takes.
// An answer that was on its way when a frame came is older than the frame: the frame wins.
import { api, whenSeen } from "./live.js";

const BLOCK = 100;
const KEPT = 3000;
const PATIENCE = 70;
const LEAST_PAUSE = 1000;
// Share of the time that the service may be busy with what this page asks for again by itself.
const SHARE = 0.05;
const MOST_PAUSE = 15_000;
const RECENT = 200;

export class TrialWindow {
  #rows = new Map();
  #asked = new Map();
  #turn = 0;
  #recent = [];
  #range = [0, BLOCK];
  #timer = 0;
  #again = 0;
  #last = -Infinity;
  #took = 0;
  #moved = 0;
  #countable = true;

  // `tell()` is called when rows, counts or the problem have changed.
  constructor(base, tell = () => {}) {
    Object.assign(this, { base, tell, sort: "-number", where: [], states: null, count: null, matched: null, problem: "" });
  }

  query() {
    const query = new URLSearchParams({ sort: this.sort });
    for (const state of this.states ?? []) query.append("state", state);
    for (const condition of this.where) query.append("where", condition);
    return query;
  }

  // Whether every row's place follows from its number.
  get plain() { return this.#countable && /^-?number$/.test(this.sort) && !this.where.length && !this.states; }

  #key(index) { return !this.plain || this.sort === "number" ? index : (this.count ?? 0) - 1 - index; }

  // Another order or filter: what is here stays to be seen until the answer comes.
  ask({ sort = this.sort, where = this.where, states = this.states }) {
    const before = String(this.query());
    Object.assign(this, { sort, where, states });
    if (String(this.query()) === before && this.matched !== null && !this.problem) return;
    this.#forget();
    this.#fetch();
  }

  row(index) { return this.shownQuery === undefined ? null : this.#rows.get(this.shownPlain ? this.#shownKey(index) : index)?.trial ?? null; }

  #shownKey(index) { return this.shownSort === "number" ? index : (this.count ?? 0) - 1 - index; }

  // The rows that are seen. While somebody scrolls fast only the last of many ranges is asked for.
  want(first, last) {
    this.#range = [first, last];
    clearTimeout(this.#timer);
    const now = performance.now();
    const quick = now - this.#moved < PATIENCE;
    this.#moved = now;
    this.#timer = setTimeout(() => this.#fetch(), quick ? PATIENCE : 0);
  }

  #forget() {
    this.#turn++;
    for (const asked of this.#asked.values()) asked.abort();
    this.#asked.clear();
  }

  #here(block) {
    const end = Math.min((block + 1) * BLOCK, this.matched ?? Infinity);
    if (this.matched === null || this.shownQuery !== String(this.query())) return false;
    for (let index = block * BLOCK; index < end; index++) {
      const known = this.#rows.get(this.#key(index));
      if (!known || (!this.plain && known.turn !== this.#turn)) return false;
    }
    return true;
  }

  #fetch() {
    clearTimeout(this.#timer);
    const [from, to] = [Math.floor(this.#range[0] / BLOCK), Math.floor(Math.max(this.#range[0], this.#range[1] - 1) / BLOCK)];
    for (const [block, asked] of this.#asked) if (block < from || block > to) { asked.abort(); this.#asked.delete(block); }
    for (let block = from; block <= to; block++) if (!this.#asked.has(block) && !this.#here(block)) this.#get(block);
  }

  async #get(block) {
    const asked = new AbortController();
    this.#asked.set(block, asked);
    const query = this.query();
    query.set("offset", block * BLOCK);
    query.set("limit", BLOCK);
    const began = performance.now();
    try {
      const found = await api(`${this.base}/window?${query}`, { signal: asked.signal });
      if (asked.signal.aborted) return;
      this.#took = performance.now() - began;
      this.#take(found);
    } catch (error) {
      if (asked.signal.aborted) return;
      this.problem = error.message;
      // What can't be asked shows nothing rather than the rows of another question.
      if (error.status === 422) { this.#rows.clear(); this.matched = 0; }
    } finally {
      if (this.#asked.get(block) === asked) this.#asked.delete(block);
    }
    this.tell();
  }

  #take(found) {
    // The first answer to another question replaces all rows of the old one.
    if (this.shownQuery !== String(this.query())) { this.#rows.clear(); this.#countable = true; }
    Object.assign(this, { count: found.count, matched: found.matched, problem: "", position: { cursor: found.cursor, history: found.history } });
    const plain = this.plain;
    if (plain && found.trials.some((trial, at) => trial.number !== this.#key(found.offset + at))) {
      this.#countable = false;
      this.#rows.clear();
    }
    Object.assign(this, { shownQuery: String(this.query()), shownPlain: this.plain, shownSort: this.sort });
    for (const [at, trial] of found.trials.entries()) {
      const key = this.plain ? trial.number : found.offset + at;
      this.#rows.delete(key);
      this.#rows.set(key, { trial, turn: this.#turn });
    }
    for (const key of this.#rows.keys()) { if (this.#rows.size <= KEPT) break; this.#rows.delete(key); }
    for (const frame of this.#recent) if (frame.to > found.cursor) this.#change(frame.trials);
  }

  #change(trials) {
    const news = new Map(trials.map((trial) => [trial.number, trial]));
    if (!this.shownPlain) {
      for (const known of this.#rows.values()) if (news.has(known.trial.number)) known.trial = news.get(known.trial.number);
      return;
    }
    for (const [number, trial] of [...news].sort(([a], [b]) => a - b)) {
      if (number >= this.count) this.count = this.matched = number + 1;
      this.#rows.set(number, { trial, turn: this.#turn });
    }
  }

  // What a frame of the live events says.
  apply(frame) {
    if (!frame.trials.length) return;
    this.#recent.push({ to: frame.to, trials: frame.trials });
    if (this.#recent.length > RECENT) this.#recent.shift();
    if (this.count === null) return;
    this.#change(frame.trials);
    this.tell();
    if (!this.plain) this.refresh();
  }

  // Ask for the seen rows again.
  refresh() {
    const pause = Math.min(MOST_PAUSE, Math.max(LEAST_PAUSE, this.#took / SHARE));
    this.#again ||= setTimeout(() => whenSeen(() => {
      this.#again = 0;
      this.#last = performance.now();
      this.#forget();
      this.#fetch();
    }), Math.max(0, this.#last + pause - performance.now()));
  }

  // Everything may be different: another database, or a gap in the events.
  async reset() {
    this.#forget();
    this.#rows.clear();
    this.#recent = [];
    this.shownQuery = undefined;
    await this.#get(Math.floor(this.#range[0] / BLOCK));
    if (this.problem) throw new Error(this.problem);
    this.#fetch();
    return this.position;
  }
}
