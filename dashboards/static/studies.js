// The list of studies, live.
import { actionsFor, buttons } from "./actions.js";
import { amount, duration, moment, number, stateText } from "./format.js";
import { Live, api } from "./live.js";
import { data, element } from "./plain.js";
import { drawProgress, progressWords, share } from "./progress.js";

const page = data();
const studies = new Map(page.studies.map((study) => [study.name, study]));
const rows = new Map();
const body = document.querySelector("#studies tbody");
const find = document.getElementById("find");
const stateFilter = document.getElementById("state");
const nothing = document.getElementById("nothing");
const keys = {
  name: (study) => study.name.toLowerCase(),
  state: (study) => study.state,
  progress: (study) => share(study) ?? -1,
  best: (study) => study.best_value ?? -Infinity,
  samples: (study) => study.cost.samples,
  seconds: (study) => study.cost.seconds,
  created: (study) => study.created_at,
};

// Filters and sorting live in the address, so that a link keeps them.
const address = new URLSearchParams(location.search);
find.value = address.get("find") ?? "";
stateFilter.value = address.get("state") ?? "";
let [sort, down] = (address.get("sort") ?? "-created").startsWith("-") ? [(address.get("sort") ?? "-created").slice(1), true] : [address.get("sort"), false];
if (!(sort in keys)) [sort, down] = ["created", true];

function remember() {
  const query = new URLSearchParams();
  if (find.value) query.set("find", find.value);
  if (stateFilter.value) query.set("state", stateFilter.value);
  if (sort !== "created" || !down) query.set("sort", (down ? "-" : "") + sort);
  history.replaceState(null, "", query.size ? `?${query}` : location.pathname);
}

function rowOf(study) {
  let row = rows.get(study.name);
  if (!row) {
    const address = `/studies/${encodeURIComponent(study.name)}`;
    const cells = {
      name: element("td", {}, element("a", { href: address, textContent: study.name }), element("div", { className: "what" })),
      state: element("td", {}, element("span", { className: "state" }), element("div", { className: "what" })),
      progress: element("td", {}, element("span"), element("div", { className: "progress", role: "img" })),
      best: element("td", { className: "num" }),
      samples: element("td", { className: "num" }),
      seconds: element("td", { className: "num" }),
      created: element("td"),
      actions: element("td"),
    };
    row = { cells, tr: element("tr", { dataset: { study: study.name } }, ...Object.values(cells)) };
    rows.set(study.name, row);
  }
  const { cells } = row;
  cells.name.lastChild.textContent = `${study.task} · ${study.strategy}`;
  cells.state.firstChild.textContent = stateText(study.state);
  cells.state.firstChild.dataset.state = study.state;
  cells.state.lastChild.textContent = study.reason;
  cells.progress.firstChild.textContent = progressWords(study);
  drawProgress(cells.progress.lastChild, study);
  cells.best.textContent = number(study.best_value);
  cells.samples.textContent = amount(study.cost.samples);
  cells.seconds.textContent = duration(study.cost.seconds);
  cells.created.textContent = moment(study.created_at);
  const names = actionsFor(study);
  if (cells.actions.dataset.names !== names.join()) {
    cells.actions.dataset.names = names.join();
    cells.actions.replaceChildren(...buttons(study, names).map((button) => { button.classList.add("quiet"); return button; }));
  }
  return row.tr;
}

function draw() {
  const wanted = find.value.trim().toLowerCase();
  const shown = [...studies.values()]
    .filter((study) => !stateFilter.value || study.state === stateFilter.value)
    .filter((study) => !wanted || `${study.name} ${study.task} ${study.strategy}`.toLowerCase().includes(wanted));
  const key = keys[sort];
  shown.sort((a, b) => (key(a) < key(b) ? -1 : key(a) > key(b) ? 1 : 0) * (down ? -1 : 1) || (a.name < b.name ? -1 : 1));
  const trs = shown.map(rowOf);
  if (trs.length !== body.children.length || trs.some((tr, index) => tr !== body.children[index])) body.replaceChildren(...trs);
  for (const th of document.querySelectorAll("th[data-sort]")) {
    if (th.dataset.sort === sort) th.setAttribute("aria-sort", down ? "descending" : "ascending");
    else th.removeAttribute("aria-sort");
  }
  document.getElementById("studies").parentElement.hidden = !shown.length;
  nothing.hidden = shown.length > 0;
  if (!studies.size) nothing.replaceChildren(document.getElementById("no-studies").content.cloneNode(true));
  else nothing.textContent = "No study matches. Clear the search to see all of them.";
}

for (const th of document.querySelectorAll("th[data-sort]")) {
  th.tabIndex = 0;
  const turn = () => { [sort, down] = th.dataset.sort === sort ? [sort, !down] : [th.dataset.sort, th.dataset.sort !== "name"]; remember(); draw(); };
  th.onclick = turn;
  th.onkeydown = (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); turn(); } };
}
find.oninput = stateFilter.onchange = () => { remember(); draw(); };
draw();

new Live({
  position: page,
  onFrame(frame) {
    if (frame.type === "study") studies.set(frame.study.name, frame.study);
    if (frame.type === "deleted") { studies.delete(frame.name); rows.delete(frame.name); }
    if (frame.type !== "events") draw();
  },
  async onReset() {
    const fresh = await api("/studies");
    studies.clear();
    rows.clear();
    for (const study of fresh.studies) studies.set(study.name, study);
    draw();
    return fresh;
  },
});
