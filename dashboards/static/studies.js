// The list of studies, live.
import { actionsFor, buttons, clone } from "./actions.js";
import { amount, duration, moment, number, stateText } from "./format.js";
import { Live, api, whenSeen } from "./live.js";
import { data, element } from "./plain.js";
import { drawProgress, progressWords, runningWords, share } from "./progress.js";
import { drawSpark } from "./spark.js";

const page = data();
const studies = new Map(page.studies.map((study) => [study.name, study]));
const pulses = new Map();
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
  distinct: (study) => pulses.get(study.name)?.distinct ?? -1,
  samples: (study) => study.cost.samples,
  rate: (study) => pulses.get(study.name)?.samples_per_second ?? -1,
  left: (study) => pulses.get(study.name)?.seconds_left ?? Infinity,
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
      best: element("td", { className: "num", dataset: { label: "Best" } }),
      course: element("td", { className: "course" }),
      distinct: element("td", { className: "num", dataset: { label: "Strategies" } }),
      samples: element("td", { className: "num", dataset: { label: "Cost" } }, element("span"), element("div", { className: "what" })),
      rate: element("td", { className: "num", dataset: { label: "Rate" } }),
      left: element("td", { className: "num", dataset: { label: "Time left" } }),
      created: element("td", { dataset: { label: "Created" } }),
      actions: element("td", { className: "actions" }),
    };
    row = { cells, tr: element("tr", { dataset: { study: study.name } }, ...Object.values(cells)) };
    rows.set(study.name, row);
  }
  const { cells } = row;
  cells.name.lastChild.textContent = `${study.task} · ${study.strategy}`;
  cells.state.firstChild.textContent = stateText(study.state);
  cells.state.firstChild.dataset.state = study.state;
  cells.state.lastChild.textContent = study.reason;
  cells.progress.firstChild.textContent = [progressWords(study), runningWords(study)].filter(Boolean).join(", ");
  drawProgress(cells.progress.lastChild, study);
  cells.samples.firstChild.textContent = `${amount(study.cost.samples)} samples`;
  cells.samples.lastChild.textContent = duration(study.cost.seconds);
  const pulse = pulses.get(study.name);
  cells.best.textContent = `${number(study.best_value)}${pulse?.unit && study.best_value !== null ? ` ${pulse.unit}` : ""}`;
  drawSpark(cells.course, pulse?.best ?? []);
  cells.distinct.textContent = number(pulse?.distinct ?? null);
  cells.rate.textContent = pulse?.samples_per_second ? `${amount(pulse.samples_per_second)}/s` : "–";
  cells.left.textContent = pulse?.seconds_left === null || pulse?.seconds_left === undefined ? "–" : duration(pulse.seconds_left);
  cells.created.textContent = moment(study.created_at);
  const names = actionsFor(study);
  if (cells.actions.dataset.names !== names.join()) {
    cells.actions.dataset.names = names.join();
    cells.actions.replaceChildren(...[...buttons(study, names), ...clone(study)].map((button) => { button.classList.add("quiet"); return button; }));
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
// How the studies are doing, asked for in one request: all of them at first, then those that something happened in.
const due = new Set(studies.keys());
let pulseTimer = 0;
async function pulse() {
  pulseTimer = 0;
  const wanted = [...due].filter((name) => studies.has(name)).slice(0, 100);
  for (const name of wanted) due.delete(name);
  if (!wanted.length) return;
  try {
    const query = new URLSearchParams(wanted.map((name) => ["study", name]));
    for (const one of (await api(`/pulse?${query}`)).pulses) pulses.set(one.study, one);
    draw();
  } catch {
    // The line at the top says that the service doesn't answer; what is missing is asked for when it is back.
    for (const name of wanted) due.add(name);
    return;
  }
  if (due.size) pulseSoon();
}
function pulseSoon() { pulseTimer ||= setTimeout(() => whenSeen(pulse), 2000); }
pulse();
setInterval(() => { for (const study of studies.values()) if (study.state === "running") due.add(study.name); pulseSoon(); }, 10000);

find.oninput = stateFilter.onchange = () => { remember(); draw(); };
draw();

new Live({
  position: page,
  onFrame(frame) {
    if (frame.type === "study") { studies.set(frame.study.name, frame.study); due.add(frame.study.name); pulseSoon(); }
    if (frame.type === "deleted") for (const known of [studies, rows, pulses]) known.delete(frame.name);
    if (frame.type !== "events") draw();
  },
  async onReset() {
    const fresh = await api("/studies?limit=1000");
    for (const known of [studies, rows, pulses]) known.clear();
    for (let page = fresh; ; page = await api(`/studies?limit=1000&page=${page.next}`)) {
      for (const study of page.studies) { studies.set(study.name, study); due.add(study.name); }
      if (page.next === null) break;
    }
    draw();
    pulse();
    return fresh;
  },
});
