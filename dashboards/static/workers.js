// Who is doing what, live: asked for again when something happened, at most once a second.
import { amount, duration, moment, number, stateText } from "./format.js";
import { Live, api } from "./live.js";
import { data, element, setText } from "./plain.js";

let known = null;
let timer = 0;

function row(...cells) {
  return element("tr", {}, ...cells.map((cell) => (cell instanceof HTMLTableCellElement ? cell : element("td", {}, cell))));
}

const right = (text) => element("td", { className: "num", textContent: text });

function draw() {
  const { workers, queue } = known;
  const now = Date.now();
  document.querySelector("#workers tbody").replaceChildren(...workers.map((one) => row(
    one.pool,
    `${one.worker}${one.host ? ` on ${one.host}` : ""}${one.pid ? ` (process ${one.pid})` : ""}`,
    element("a", { href: `/studies/${encodeURIComponent(one.study)}/trials/${one.trial}`, textContent: `${one.study} ${one.trial}${one.attempt > 1 ? `, attempt ${one.attempt}` : ""}` }),
    right(number(one.iteration)), right(amount(one.samples)), right(one.samples_per_second === null ? "–" : amount(one.samples_per_second)),
    moment(one.started_at), `${duration(Math.max(0, (now - Date.parse(one.beat_at)) / 1000))} ago`,
  )));
  document.querySelector("#queue tbody").replaceChildren(...queue.map((one) => row(
    element("a", { href: `/studies/${encodeURIComponent(one.study)}`, textContent: one.study }),
    element("span", { className: "state", dataset: { state: one.state }, textContent: stateText(one.state) }),
    one.pool, right(number(one.priority)), right(number(one.parallel)), right(number(one.running)), right(number(one.queued)),
  )));
  document.getElementById("workers").parentElement.hidden = !workers.length;
  document.getElementById("idle").hidden = workers.length > 0;
  document.getElementById("queue").parentElement.hidden = !queue.length;
  document.getElementById("empty").hidden = queue.length > 0;
  const rate = workers.reduce((sum, one) => sum + (one.samples_per_second ?? 0), 0);
  setText("summary", workers.length ? `${workers.length} at work, ${amount(rate)} samples/s together` : "");
}

async function load() {
  known = await api("/workers");
  draw();
  return known;
}

function soon() {
  timer ||= setTimeout(() => { timer = 0; load().catch(() => {}); }, 1000);
}

load().catch(() => {}).finally(() => {
  new Live({ position: data(), onFrame: soon, onReset: load });
});
setInterval(() => { if (known) draw(); }, 1000);
