// Who is doing what, what waits, and who has had how much, live: asked for again when something happened, at most once
// a second.
import { amount, bytes, duration, moment, number, stateText } from "./format.js";
import { Live, api } from "./live.js";
import { data, element, setText } from "./plain.js";

let known = null;
let timer = 0;

const cell = (content, properties = {}) => element("td", properties, content);
const right = (text) => element("td", { className: "num", textContent: text });

// A bar with its words beside it: the words say all, so the bar is for the eye only.
function meter(share, text) {
  const fill = element("i");
  fill.style.width = `${100 * Math.max(0, Math.min(1, share))}%`;
  return element("td", { className: "meter" }, element("span", { className: "track", "aria-hidden": "true" }, fill), element("span", { textContent: text }));
}

function draw() {
  const { pools, workers, queue } = known;
  const now = Date.now();
  document.getElementById("pools-section").hidden = !pools.length;
  document.getElementById("pools").replaceChildren(...pools.map((pool) => {
    const cores = pool.cores === null ? `${number(pool.held)} cores in use` : `${number(pool.held)} of ${number(pool.cores)} cores in use`;
    const fill = element("i");
    fill.style.width = `${pool.cores ? Math.min(100, (100 * pool.held) / pool.cores) : pool.held ? 100 : 0}%`;
    return element("div", { className: "pool", dataset: { pool: pool.name } }, element("strong", { textContent: pool.name }), element("span", { textContent: cores }),
      element("span", { className: "track", "aria-hidden": "true" }, fill), element("span", { className: "hint", textContent: `${pool.running} running, ${pool.queued} waiting` }));
  }));
  document.querySelector("#workers tbody").replaceChildren(...workers.map((one) => element("tr", {},
    cell(one.worker), cell(one.host ? `${one.host}${one.pid ? ` (process ${one.pid})` : ""}` : "–"), cell(one.pool),
    cell(element("a", { href: `/studies/${encodeURIComponent(one.study)}/trials/${one.trial}`, textContent: `${one.study} ${one.trial}${one.attempt > 1 ? `, attempt ${one.attempt}` : ""}` })),
    right(number(one.iteration)), right(amount(one.samples)), right(one.samples_per_second === null ? "–" : amount(one.samples_per_second)), right(one.memory === null ? "–" : bytes(one.memory)),
    cell(moment(one.started_at)), cell(`${duration(Math.max(0, (now - Date.parse(one.beat_at)) / 1000))} ago`),
  )));
  const spent = queue.reduce((sum, one) => sum + one.core_seconds, 0);
  document.querySelector("#queue tbody").replaceChildren(...queue.map((one) => element("tr", {},
    cell(element("a", { href: `/studies/${encodeURIComponent(one.study)}`, textContent: one.study })),
    cell(element("span", { className: "state", dataset: { state: one.state }, textContent: stateText(one.state) })),
    cell(one.pool), right(number(one.priority)), meter(one.cores_wanted ? one.cores_held / one.cores_wanted : 0, `${number(one.cores_held)} of ${number(one.cores_wanted)}`),
    right(number(one.running)), right(number(one.queued)), meter(spent ? one.core_seconds / spent : 0, `${spent ? Math.round((100 * one.core_seconds) / spent) : 0} %, ${duration(one.core_seconds)}`),
  )));
  document.getElementById("workers").parentElement.hidden = !workers.length;
  document.getElementById("idle").hidden = workers.length > 0;
  document.getElementById("queue").parentElement.hidden = !queue.length;
  document.getElementById("empty").hidden = queue.length > 0;
  const rate = workers.reduce((sum, one) => sum + (one.samples_per_second ?? 0), 0);
  const memory = workers.reduce((sum, one) => sum + (one.memory ?? 0), 0);
  setText("summary", workers.length ? `${workers.length} at work, ${amount(rate)} samples/s together${memory ? `, ${bytes(memory)} of memory` : ""}` : "");
}

async function load() {
  known = await api("/cluster");
  draw();
  return known;
}

function soon() {
  timer ||= setTimeout(() => { timer = 0; load().catch(() => {}); }, 1000);
}

// While the first answer is missing, the page's own line says whether the service answers.
load().catch(() => {}).finally(() => {
  new Live({ position: data(), onFrame: soon, onReset: load });
});
setInterval(() => { if (known) draw(); }, 1000);
