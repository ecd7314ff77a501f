// A table of trials that stays smooth at 50,000 rows: the service sorts and filters, blocks of rows are loaded as they
// come into view, and only the rows in view are in the document.
import { columnsOf } from "./columns.js";
import { element } from "./plain.js";
import { TrialWindow } from "./window.js";

const ROW = 30;
const SPARE = 12;
const WIDEST = 300;
const PADDING = 22;

export class TrialTable {
  #queued = false;
  #drawn = new Map();
  #widths = new Map();
  #pen = document.createElement("canvas").getContext("2d");

  constructor(at, context, { onHover = () => {} } = {}) {
    Object.assign(this, { at, context, base: context.base, onHover, hidden: new Set(), chosen: new Set(), onChange: () => {} });
    this.known = { parameters: [], details: [], troubled: false };
    this.rows = new TrialWindow(context.base, () => this.#told());
    this.table = element("table", { "aria-label": "Trials" }, element("colgroup"), element("thead"), element("tbody"));
    this.cols = this.table.firstElementChild;
    this.gaps = [0, 1].map(() => element("tr", { className: "gap", "aria-hidden": "true" }, element("td")));
    at.tabIndex = 0;
    at.setAttribute("role", "region");
    at.setAttribute("aria-label", "Trials, scrollable");
    at.append(this.table);
    at.addEventListener("scroll", () => this.#soon(), { passive: true });
    new ResizeObserver(() => this.#soon()).observe(at);
    const body = this.table.tBodies[0];
    body.addEventListener("click", (event) => {
      const row = event.target.closest("tr[data-number]");
      if (row && !event.target.closest("a") && !String(getSelection())) location.assign(`${this.base}/trials/${row.dataset.number}`);
    });
    body.addEventListener("mouseover", (event) => this.onHover(Number(event.target.closest("tr[data-number]")?.dataset.number ?? -1)));
    body.addEventListener("mouseleave", () => this.onHover(-1));
    this.#soon();
  }

  columns() { return columnsOf(this.context, this.known); }

  shown() { return this.columns().filter((column) => (column.rare ? this.chosen.has(column.key) : !this.hidden.has(column.key))); }

  get sort() { return { key: this.rows.sort.replace(/^-/, ""), down: this.rows.sort.startsWith("-") }; }

  // Columns, order or filter have changed.
  draw() {
    const shown = (this.shownColumns = this.shown());
    const signature = shown.map((column) => column.key + column.head).join() + this.rows.sort;
    if (signature !== this.signature) {
      this.signature = signature;
      this.#drawn.clear();
      this.table.tHead.replaceChildren(element("tr", {}, ...shown.map((column) => this.#head(column))));
      this.cols.replaceChildren(...shown.map(() => element("col")));
      for (const column of shown) this.#measure(column, `${column.head} ↓`);
    }
    this.#soon();
  }

  #head(column) {
    const { key, down } = this.sort;
    const th = element("th", { textContent: column.head, title: column.head, className: column.num ? "num" : "", dataset: { sort: column.key }, tabIndex: 0, scope: "col" });
    if (column.key === key) th.setAttribute("aria-sort", down ? "descending" : "ascending");
    const turn = () => {
      this.order(column.key === key ? (down ? "" : "-") + key : (column.num ? "-" : "") + column.key);
      this.table.tHead.querySelector(`[data-sort="${CSS.escape(column.key)}"]`)?.focus({ preventScroll: true });
    };
    th.onclick = turn;
    th.onkeydown = (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); turn(); } };
    return th;
  }

  order(sort) {
    this.rows.ask({ sort });
    this.counted = undefined;
    this.at.scrollTop = 0;
    this.draw();
    this.onChange();
  }

  // The columns that only rows tell: parameters outside the space, named results, messages.
  #told() {
    const { parameters, details, troubled } = this.known;
    const before = parameters.length + details.length + Number(troubled);
    for (let index = 0; index < Math.min(this.rows.matched ?? 0, 100); index++) {
      const trial = this.rows.row(index);
      if (!trial) continue;
      for (const name of Object.keys(trial.params)) if (!(name in this.context.space) && !parameters.includes(name)) parameters.push(name);
      for (const [name, value] of Object.entries(trial.details)) if (!details.some((one) => one.name === name)) details.push({ name, num: typeof value === "number" });
      if (trial.message) this.known.troubled = true;
    }
    this.#stay();
    if (parameters.length + details.length + Number(this.known.troubled) !== before || !this.signature) this.draw();
    else this.#soon();
    this.onTold?.();
  }

  // New trials come at the top: somebody who has scrolled down keeps the rows that he reads.
  #stay() {
    const { matched, plain, sort } = this.rows;
    const more = matched - (this.counted ?? matched);
    this.counted = matched;
    if (more > 0 && plain && sort === "-number" && this.at.scrollTop >= ROW) {
      this.gaps[0].cells[0].style.height = `${parseFloat(this.gaps[0].cells[0].style.height || 0) + more * ROW}px`;
      this.gaps[0].hidden = false;
      this.at.scrollTop += more * ROW;
    }
  }

  // A column is as wide as the widest that was seen in it: it may grow, and never swings while somebody scrolls.
  #measure(column, text) {
    this.#pen.font = this.font ??= `550 ${getComputedStyle(document.body).fontSize} ${getComputedStyle(document.body).fontFamily}`;
    const width = Math.min(WIDEST, Math.ceil(this.#pen.measureText(text).width) + PADDING);
    if (width > (this.#widths.get(column.key) ?? 0)) { this.#widths.set(column.key, width); this.wider = true; }
  }

  #soon() {
    if (this.#queued) return;
    this.#queued = true;
    requestAnimationFrame(() => { this.#queued = false; this.#rows(); });
  }

  #rows() {
    const { rows, shownColumns: shown } = this;
    if (!shown) return;
    const body = this.table.tBodies[0];
    const count = rows.matched;
    this.table.setAttribute("aria-rowcount", (count ?? 0) + 1);
    if (!count) {
      if (count === null && !rows.problem) return;
      const text = rows.problem || (rows.count ? "No trial matches the filter." : "No trials yet: the first ones appear here as soon as they are proposed.");
      this.#drawn.clear();
      this.#widen(shown);
      body.replaceChildren(element("tr", {}, element("td", { className: "empty", colSpan: shown.length, textContent: text })));
      return;
    }
    const first = Math.max(0, Math.min(Math.floor(this.at.scrollTop / ROW) - SPARE, count - 1));
    const last = Math.min(count, first + Math.ceil((this.at.clientHeight || 600) / ROW) + 2 * SPARE);
    rows.want(first, last);
    const focused = body.contains(document.activeElement) ? document.activeElement.closest("tr")?.dataset.number : null;
    this.#gap(0, first, shown);
    this.#gap(1, count - last, shown);
    if (this.gaps[0].parentNode !== body) { body.replaceChildren(...this.gaps); this.#drawn.clear(); }
    // Rows that stay are left where they are; what left the view goes, what came into it is put between.
    for (const [index, { tr }] of this.#drawn) if (index < first || index >= last) { tr.remove(); this.#drawn.delete(index); }
    let next = this.gaps[0].nextSibling;
    for (let index = first; index < last; index++) {
      const trial = rows.row(index);
      let known = this.#drawn.get(index);
      if (!known || known.trial !== trial || known.signature !== this.signature) {
        const tr = this.#row(index, trial, shown);
        if (known) { if (known.tr === next) next = tr; known.tr.replaceWith(tr); }
        known = { tr, trial, signature: this.signature };
        this.#drawn.set(index, known);
      }
      if (known.tr === next) next = next.nextSibling;
      else body.insertBefore(known.tr, next);
    }
    while (next && next !== this.gaps[1]) { const old = next; next = next.nextSibling; old.remove(); }
    this.#widen(shown);
    if (focused && document.activeElement === document.body) body.querySelector(`tr[data-number="${focused}"] a`)?.focus({ preventScroll: true });
  }

  #gap(which, rows, shown) {
    const [cell] = this.gaps[which].cells;
    cell.colSpan = shown.length;
    cell.style.height = `${rows * ROW}px`;
    this.gaps[which].hidden = rows === 0;
  }

  #row(index, trial, shown) {
    // Not loaded yet: a row of its height, so that nothing moves when it comes.
    if (!trial) return element("tr", { className: "coming", "aria-rowindex": index + 2 }, element("td", { colSpan: shown.length, textContent: "…" }));
    return element("tr", { dataset: { number: trial.number }, "aria-rowindex": index + 2, className: trial.number === this.lit ? "lit" : "" }, ...shown.map((column) => {
      const text = column.text(trial);
      this.#measure(column, text);
      const cell = element("td", { className: column.num ? "num" : "" }, column.cell ? column.cell(trial) : text);
      if (text.length > 40) cell.title = text;
      return cell;
    }));
  }

  #widen(shown) {
    if (!this.wider && this.widened === this.signature) return;
    this.wider = false;
    this.widened = this.signature;
    let all = 0;
    for (const [index, column] of shown.entries()) {
      const width = this.#widths.get(column.key) ?? 60;
      all += width;
      this.cols.children[index].style.width = `${width}px`;
    }
    this.table.style.minWidth = `${all}px`;
  }

  light(number) {
    this.lit = number;
    for (const row of this.table.tBodies[0].rows) row.classList.toggle("lit", Number(row.dataset.number) === number);
  }
}
