// A trial, live: its curve grows, and what the server renders is fetched again when the trial's state changes.
import { Curves } from "./curves.js";
import { Live, api, banner } from "./live.js";
import { data, localTimes } from "./plain.js";

const page = data();
const path = `/studies/${encodeURIComponent(page.study)}/trials/${page.trial}`;
const curves = new Curves(document.getElementById("curves"), document.getElementById("metric-choice"), path, { task: page.task, called: `${page.study}-${page.trial}` });

async function motion() {
  const form = document.getElementById("beside");
  if (!form || form.dataset.wired) return;
  form.dataset.wired = "yes";
  const { besides } = await import("./beside.js");
  besides(form, document.getElementById("motions"), page);
}

motion();

// The log is read when somebody opens it: it may be long, and its end is what matters.
const LONGEST_LOG = 200_000;
async function log() {
  const box = document.getElementById("log");
  if (!box?.open || box.dataset.read === page.state) return;
  box.dataset.read = page.state;
  const at = box.querySelector("pre");
  try {
    const answer = await fetch(`/api/v1${path}/artifacts/log.txt`);
    if (!answer.ok) throw new Error(`the service answered with status ${answer.status}`);
    const text = await answer.text();
    at.textContent = (text.length > LONGEST_LOG ? `… the last ${LONGEST_LOG} of ${text.length} characters\n` : "") + text.slice(-LONGEST_LOG) || "The log is empty.";
  } catch (error) {
    at.textContent = `The log could not be read: ${error.message}`;
  }
}
document.addEventListener("toggle", (event) => { if (event.target.id === "log") log(); }, true);
document.addEventListener("click", async (event) => {
  const button = event.target.closest("[data-copy]");
  if (!button) return;
  await navigator.clipboard?.writeText(button.previousElementSibling.textContent);
  button.textContent = "Copied";
  setTimeout(() => { button.textContent = "Copy"; }, 1500);
});

// Replace the parts that the server renders by how it renders them now; what didn't change keeps its place and focus.
async function refresh() {
  const answer = await fetch(location.href, { headers: { accept: "text/html" } });
  if (answer.status === 404) { banner(`Trial ${page.trial} of ${page.study} does not exist any more.`); return; }
  if (!answer.ok || answer.redirected) throw new Error("the page could not be fetched");
  const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
  localTimes(fresh);
  for (const part of document.querySelectorAll("[data-live]")) {
    const news = fresh.querySelector(`[data-live="${part.dataset.live}"]`);
    const same = !news || news.innerHTML === part.innerHTML;
    if (!same && !("once" in part.dataset && part.querySelector("halma-replay"))) part.replaceChildren(...news.childNodes);
  }
  motion();
}

// How often what changes with every iteration is fetched: not more than this share of the time.
const SHARE = 0.05;
let took = 0;
let busy = false;
let again = false;
async function update({ rendered }) {
  again ||= rendered;
  if (busy) return;
  busy = true;
  try {
    await curves.refresh();
    while (again) {
      again = false;
      const began = Date.now();
      await refresh();
      took = Date.now() - began;
    }
  } catch (error) {
    console.warn(error.message);
  } finally {
    busy = false;
    if (again) setTimeout(() => update({ rendered: false }), 500);
  }
}

curves.refresh().catch((error) => banner(error.message)).finally(() => { document.body.dataset.ready = "yes"; });
let last = 0;
new Live({
  position: page,
  study: page.study,
  onFrame(frame) {
    if (frame.type === "deleted") { banner(`The study ${page.study} was deleted. What you see is what was known of it.`); return; }
    if (frame.type !== "events") return;
    const mine = frame.events.filter((event) => event.trial === page.trial);
    if (!mine.length) return;
    // Iterations come often and change two numbers; the rest of the page only changes with the state.
    const changed = mine.some((event) => event.kind !== "progress");
    const due = Date.now() - last > Math.min(15_000, Math.max(2000, took / SHARE));
    if (changed || due) last = Date.now();
    update({ rendered: changed || due });
  },
  async onReset() {
    const server = await api("/server");
    await curves.reload();
    await refresh();
    return server;
  },
});
