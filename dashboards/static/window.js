// A window on the trials of a study: the service filters and sorts, and here are only the rows that somebody looks at.
//
// Rows come in blocks. While the study goes on, a frame changes rows that are here at once, and what it may have moved
// is asked for again. An answer that was on its way when a frame came is older than the frame: the frame wins.
import { api } from "./live.js";

const BLOCK = 100;
const KEPT = 24;
const PATIENCE = 70;
const LEAST_PAUSE = 800;
const RECENT = 200;

export class TrialWindow {
  #blocks = new Map();
  #asked = new Map();
  #turn = 0;
  #recent = [];
  #range = [0, BLOCK];
  #timer = 0;
  #again = 0;
  #last = 0;
  #moved = 0;

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

  // Another order or filter: what is here stays to be seen until the answer comes.
  ask({ sort = this.sort, where = this.where, states = this.states }) {
    const before = String(this.query());
    Object.assign(this, { sort, where, states });
    if (String(this.query()) === before && this.matched !== null && !this.problem) return;
    this.#forget();
    this.#fetch();
  }

  row(index) { return this.#blocks.get(Math.floor(index / BLOCK))?.rows[index % BLOCK] ?? null; }

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

  #fetch() {
    clearTimeout(this.#timer);
    const [from, to] = [Math.floor(this.#range[0] / BLOCK), Math.floor(Math.max(this.#range[0], this.#range[1] - 1) / BLOCK)];
    for (const [block, asked] of this.#asked) if (block < from || block > to) { asked.abort(); this.#asked.delete(block); }
    for (let block = from; block <= to; block++) {
      if (!this.#asked.has(block) && this.#blocks.get(block)?.turn !== this.#turn) this.#get(block);
    }
  }

  async #get(block) {
    const asked = new AbortController();
    this.#asked.set(block, asked);
    const query = this.query();
    query.set("offset", block * BLOCK);
    query.set("limit", BLOCK);
    try {
      const found = await api(`${this.base}/window?${query}`, { signal: asked.signal });
      if (asked.signal.aborted) return;
      this.#take(block, found);
    } catch (error) {
      if (asked.signal.aborted) return;
      this.problem = error.message;
      // What can't be asked shows nothing rather than the rows of another question.
      if (error.status === 422) { this.#blocks.clear(); this.matched = 0; }
    } finally {
      if (this.#asked.get(block) === asked) this.#asked.delete(block);
    }
    this.tell();
  }

  #take(block, found) {
    if (this.turnShown !== this.#turn) {
      // The first answer to another question replaces all rows of the old one; one of the same question only its own.
      if (this.shownQuery !== String(this.query())) this.#blocks.clear();
      this.shownQuery = String(this.query());
      this.turnShown = this.#turn;
    }
    this.#blocks.delete(block);
    this.#blocks.set(block, { turn: this.#turn, rows: found.trials });
    for (const key of this.#blocks.keys()) { if (this.#blocks.size <= KEPT) break; this.#blocks.delete(key); }
    Object.assign(this, { count: found.count, matched: found.matched, problem: "", position: { cursor: found.cursor, history: found.history } });
    for (const frame of this.#recent) if (frame.to > found.cursor) this.#change(frame.trials);
  }

  #change(trials) {
    const news = new Map(trials.map((trial) => [trial.number, trial]));
    let found = 0;
    for (const { rows } of this.#blocks.values()) for (const [at, row] of rows.entries()) if (news.has(row.number)) { rows[at] = news.get(row.number); found++; }
    return found;
  }

  // What a frame of the live events says.
  apply(frame) {
    if (!frame.trials.length) return;
    this.#recent.push({ to: frame.to, trials: frame.trials });
    if (this.#recent.length > RECENT) this.#recent.shift();
    this.#change(frame.trials);
    this.tell();
    // In the plain order only a new trial moves rows; in every other one any change may.
    const plain = /^-?number$/.test(this.sort) && !this.where.length && !this.states;
    if (!plain || frame.trials.some((trial) => trial.number >= (this.count ?? 0))) this.refresh();
  }

  // Ask for the seen rows again, at most so often.
  refresh() {
    this.#again ||= setTimeout(() => {
      this.#again = 0;
      this.#last = performance.now();
      this.#forget();
      this.#fetch();
    }, Math.max(0, this.#last + LEAST_PAUSE - performance.now()));
  }

  // Everything may be different: another database, or a gap in the events.
  async reset() {
    this.#forget();
    this.#blocks.clear();
    this.#recent = [];
    await this.#get(Math.floor(this.#range[0] / BLOCK));
    if (this.problem) throw new Error(this.problem);
    this.#fetch();
    return this.position;
  }
}
