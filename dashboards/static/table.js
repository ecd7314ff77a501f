// A table of trials that stays smooth at 50,000 rows: only the rows in view are in the document.
import { amount, duration, feature, number, stateText } from "./format.js";
import { element } from "./plain.js";

const ROW = 30;
const SPARE = 12;

export class TrialTable {
  #visible = [];
  #queued = false;

  constructor(at, { study, trials, behaviour, units, value = { name: "value", title: "value" }, onHover = () => {} }) {
    this.valueTitle = value.title;
    this.at = at;
    this.study = study;
    this.trials = trials;
    this.behaviour = behaviour;
    this.units = units;
    this.onHover = onHover;
    this.filter = () => true;
    this.hidden = new Set();
    this.sort = { key: "number", down: true };
    this.table = element("table", { "aria-label": "Trials" }, element("thead"), element("tbody"));
    at.tabIndex = 0;
    at.setAttribute("role", "region");
    at.setAttribute("aria-label", "Trials, scrollable");
    at.append(this.table);
    at.addEventListener("scroll", () => this.#soon(), { passive: true });
    new ResizeObserver(() => this.#soon()).observe(at);
    const body = this.table.tBodies[0];
    body.addEventListener("click", (event) => {
      const row = event.target.closest("tr[data-number]");
      if (row && !event.target.closest("a") && !String(getSelection())) location.assign(this.#address(row.dataset.number));
    });
    body.addEventListener("mouseover", (event) => this.onHover(Number(event.target.closest("tr[data-number]")?.dataset.number ?? -1)));
    body.addEventListener("mouseleave", () => this.onHover(-1));
  }

  #address(number) {
    return `/studies/${encodeURIComponent(this.study)}/trials/${number}`;
  }

  columns() {
    const { behaviour, trials, units } = this;
    const rows = trials.all();
    const unitOf = (name) => (units[name] ? ` (${units[name]})` : "");
    const columns = [
      { key: "number", head: "#", num: true, value: (t) => t.number, text: (t) => element("a", { href: this.#address(t.number), textContent: t.number }) },
      { key: "state", head: "State", value: (t) => t.state, text: (t) => element("span", { className: "state", dataset: { state: t.state }, textContent: stateText(t.state) }) },
      { key: "value", head: this.valueTitle[0].toUpperCase() + this.valueTitle.slice(1), num: true, value: (t) => t.value, text: (t) => number(t.value) },
    ];
    for (const [index, name] of (behaviour?.names ?? []).entries()) {
      columns.push({ key: `feature.${name}`, head: name, num: true, value: (t) => t.features?.[index] ?? null, text: (t) => (t.features ? feature(t.features[index], behaviour.kind === "rotation" ? "" : behaviour.unit) : "–") });
    }
    if (rows.some((t) => t.z !== null)) columns.push({ key: "z", head: "Difficulty", num: true, value: (t) => t.z, text: (t) => number(t.z, 3) });
    for (const name of trials.parameters) {
      const numeric = rows.some((t) => typeof t.params[name] === "number");
      columns.push({ key: `params.${name}`, head: name + unitOf(name), num: numeric, value: (t) => t.params[name] ?? null, text: (t) => number(t.params[name] ?? null) });
    }
    if (rows.some((t) => t.mode !== null)) columns.push({ key: "mode", head: "Proposed to", value: (t) => t.mode ?? "", text: (t) => t.mode ?? "" });
    if (rows.some((t) => t.warm_start !== null)) columns.push({ key: "warm_start", head: "Starts from", num: true, value: (t) => t.warm_start, text: (t) => (t.warm_start === null ? "" : element("a", { href: this.#address(t.warm_start), textContent: t.warm_start })) });
    columns.push(
      { key: "samples", head: "Samples", num: true, value: (t) => t.samples, text: (t) => amount(t.samples) },
      { key: "seconds", head: "Time", num: true, value: (t) => t.seconds, text: (t) => duration(t.seconds) },
      { key: "attempts", head: "Attempts", num: true, value: (t) => t.attempts, text: (t) => String(t.attempts) },
    );
    return columns;
  }

  draw() {
    const columns = this.columns();
    this.shown = columns.filter((column) => !this.hidden.has(column.key));
    const by = columns.find((column) => column.key === this.sort.key) ?? columns[0];
    const rows = this.trials.all().filter(this.filter);
    const sign = this.sort.down ? -1 : 1;
    rows.sort((a, b) => {
      const [x, y] = [by.value(a), by.value(b)];
      if (x === y) return b.number - a.number;
      if (x === null) return 1;
      if (y === null) return -1;
      return x < y ? -sign : sign;
    });
    this.#visible = rows;
    const head = this.shown.map((column) => {
      const th = element("th", { textContent: column.head, className: column.num ? "num" : "", dataset: { sort: column.key }, tabIndex: 0, scope: "col" });
      if (column.key === by.key) th.setAttribute("aria-sort", this.sort.down ? "descending" : "ascending");
      const turn = () => { this.sort = { key: column.key, down: column.key === this.sort.key ? !this.sort.down : column.num }; this.onSort?.(); this.draw(); };
      th.onclick = turn;
      th.onkeydown = (event) => { if (event.key === "Enter") turn(); };
      return th;
    });
    const signature = this.shown.map((column) => column.key + column.head).join() + this.sort.key + this.sort.down;
    if (signature !== this.signature) {
      this.signature = signature;
      this.table.tHead.replaceChildren(element("tr", {}, ...head));
    }
    this.table.setAttribute("aria-rowcount", rows.length + 1);
    this.#soon();
  }

  #soon() {
    if (this.#queued) return;
    this.#queued = true;
    requestAnimationFrame(() => { this.#queued = false; this.#rows(); });
  }

  #rows() {
    const body = this.table.tBodies[0];
    const rows = this.#visible;
    if (!this.shown) return;
    if (!rows.length) {
      const text = this.trials.rows.size ? "No trial matches the filter." : "No trials yet: the first ones appear here as soon as they are proposed.";
      body.replaceChildren(element("tr", {}, element("td", { className: "empty", colSpan: this.shown.length, textContent: text })));
      return;
    }
    const first = Math.max(0, Math.min(Math.floor(this.at.scrollTop / ROW) - SPARE, rows.length - 1));
    const last = Math.min(rows.length, first + Math.ceil((this.at.clientHeight || 600) / ROW) + 2 * SPARE);
    const gap = (height) => {
      const cell = element("td", { colSpan: this.shown.length });
      cell.style.height = `${height}px`;
      return element("tr", { className: "gap", "aria-hidden": "true" }, cell);
    };
    const made = rows.slice(first, last).map((trial, index) => element(
      "tr", { dataset: { number: trial.number }, "aria-rowindex": first + index + 2, className: trial.number === this.lit ? "lit" : "" },
      ...this.shown.map((column) => element("td", { className: column.num ? "num" : "" }, column.text(trial))),
    ));
    const focused = body.contains(document.activeElement) ? document.activeElement.closest("tr")?.dataset.number : null;
    body.replaceChildren(...(first ? [gap(first * ROW)] : []), ...made, ...(last < rows.length ? [gap((rows.length - last) * ROW)] : []));
    if (focused) body.querySelector(`tr[data-number="${focused}"] a`)?.focus({ preventScroll: true });
  }

  light(number) {
    this.lit = number;
    for (const row of this.table.tBodies[0].rows) row.classList.toggle("lit", Number(row.dataset.number) === number);
  }
}
