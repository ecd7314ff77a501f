// The tools above the table of trials: states, conditions, columns, download. All of it is kept in the address.
import { conditionsOf } from "./columns.js";
import { STATES, number, stateText } from "./format.js";
import { element } from "./plain.js";

const list = (text) => (text ?? "").split(",").filter(Boolean);
const PATIENCE = 200;

export function filters(at, table, csv) {
  const address = new URLSearchParams(location.search);
  const off = new Set(list(address.get("without")));
  const find = element("input", { type: "search", placeholder: "value > 0.5 and state = failed", value: address.get("where") ?? "", "aria-label": "Conditions, for example value > 0.5 and samples < 10000", className: "where" });
  const note = element("span", { className: "hint", role: "status" });
  const chips = element("div", { className: "choice", role: "group", "aria-label": "States" });
  const columns = element("details", { className: "columns" }, element("summary", { className: "button", textContent: "Columns" }), element("div", { className: "panel" }));
  const download = element("a", { className: "button", href: csv, textContent: "Download CSV", title: "The trials that pass, in this order, with these columns" });
  const sort = address.get("sort") ?? "-number";
  // Links of before name a feature by its name.
  const key = table.columns().find((one) => one.also?.includes(sort.replace(/^-/, "")))?.key;
  table.rows.sort = key ? (sort.startsWith("-") ? "-" : "") + key : sort;
  for (const hidden of list(address.get("hide"))) table.hidden.add(hidden);
  for (const chosen of list(address.get("show"))) table.chosen.add(chosen);
  at.append(chips, find, note, element("span", { className: "space" }), columns, download);
  let problem = "";
  let counts = {};

  function remember() {
    const query = new URLSearchParams();
    if (find.value.trim()) query.set("where", find.value.trim());
    if (off.size) query.set("without", [...off].join());
    if (table.hidden.size) query.set("hide", [...table.hidden].join());
    if (table.chosen.size) query.set("show", [...table.chosen].join());
    if (table.rows.sort !== "-number") query.set("sort", table.rows.sort);
    history.replaceState(null, "", query.size ? `?${query}` : location.pathname);
    const wanted = table.rows.query();
    for (const column of table.shown()) wanted.append("column", column.key);
    download.href = `${csv}?${wanted}`;
  }

  function apply() {
    const parsed = conditionsOf(find.value, table.columns());
    problem = parsed.problem;
    if (!problem) {
      const states = off.size ? STATES.filter((state) => !off.has(state)) : null;
      // No state at all is asked for by a condition that none fulfils: an empty list would mean all of them.
      table.rows.ask(states && !states.length ? { states: null, where: ["number<0"] } : { states, where: parsed.conditions });
    }
    remember();
    say();
  }

  function say() {
    const { matched, count } = table.rows;
    const wrong = problem || table.rows.problem;
    note.classList.toggle("problem", Boolean(wrong));
    note.textContent = wrong || (count === null ? "" : matched === count ? `${number(count)} trials` : `${number(matched)} of ${number(count)} trials`);
  }

  function drawStates() {
    for (const state of STATES) {
      let chip = chips.querySelector(`[data-state="${state}"]`);
      if (!chip && !counts[state] && !off.has(state)) continue;
      if (!chip) {
        chip = element("button", { type: "button", dataset: { state } });
        chip.onclick = () => { if (!off.delete(state)) off.add(state); drawStates(); table.at.scrollTop = 0; apply(); };
        // In their own order, whichever came first.
        chips.insertBefore(chip, [...chips.children].find((other) => STATES.indexOf(other.dataset.state) > STATES.indexOf(state)) ?? null);
      }
      chip.textContent = `${stateText(state)} ${number(counts[state] ?? 0)}`;
      chip.setAttribute("aria-pressed", String(!off.has(state)));
    }
  }

  function drawColumns() {
    const box = columns.lastChild;
    const known = table.columns();
    const signature = known.map((one) => one.key + one.rare).join();
    if (box.dataset.keys === signature) return;
    box.dataset.keys = signature;
    box.replaceChildren(...known.slice(1).map((column) => {
      const input = element("input", { type: "checkbox", checked: column.rare ? table.chosen.has(column.key) : !table.hidden.has(column.key) });
      input.onchange = () => {
        const [set, put] = column.rare ? [table.chosen, input.checked] : [table.hidden, !input.checked];
        if (put) set.add(column.key); else set.delete(column.key);
        remember();
        table.draw();
      };
      return element("label", {}, input, ` ${column.head}`);
    }));
  }

  let timer = 0;
  find.oninput = () => { clearTimeout(timer); timer = setTimeout(() => { table.at.scrollTop = 0; apply(); }, PATIENCE); };
  find.onkeydown = (event) => { if (event.key === "Enter") { clearTimeout(timer); apply(); } };
  columns.onkeydown = (event) => { if (event.key === "Escape") { columns.open = false; columns.firstChild.focus(); } };
  document.addEventListener("pointerdown", (event) => { if (!columns.contains(event.target)) columns.open = false; });
  table.onChange = remember;
  table.onTold = () => { drawColumns(); say(); };
  drawColumns();
  apply();
  return { draw(study) { counts = study.trials; drawStates(); } };
}
