// A study, live: its facts, and whichever view of it is open.
import { actionsFor, buttons } from "./actions.js";
import { amount, duration, feature, number, stateText } from "./format.js";
import { Live, api, banner } from "./live.js";
import { data, element, setText } from "./plain.js";
import { drawProgress, finished, progressWords } from "./progress.js";
import { Trials } from "./trials.js";

const page = data();
let study = page.study;
const base = `/studies/${encodeURIComponent(study.name)}`;
const behaviour = study.spec.behaviour ?? null;
const units = study.spec.units ?? {};
const trials = new Trials(study.name);

function facts() {
  const state = document.getElementById("study-state");
  state.dataset.state = study.state;
  setText("study-state", stateText(study.state));
  const waits = { pause: "running", cancel: "running" }[study.wanted] === study.state;
  setText("study-reason", waits ? `${study.wanted === "pause" ? "pausing" : "cancelling"}: trials come to their next checkpoint` : study.reason);
  setText("fact-trials", progressWords(study));
  drawProgress(document.getElementById("progress"), study);
  setText("fact-best", number(study.best_value));
  setText("fact-samples", amount(study.cost.samples));
  setText("fact-seconds", duration(study.cost.seconds));
  setText("fact-search", `${study.strategy} on ${study.task}`);
  const names = actionsFor(study);
  const at = document.getElementById("actions");
  if (at.dataset.names !== names.join()) {
    at.dataset.names = names.join();
    at.replaceChildren(...buttons(study, names));
  }
}

// Rate and time left from the last finished trials: a mean over the whole study would hide that it has become slower.
function pace() {
  const ended = trials.all().filter((trial) => trial.position !== null && trial.finished !== null).sort((a, b) => a.finished - b.finished).slice(-30);
  if (study.state !== "running" || ended.length < 2) {
    setText("fact-rate", "–");
    setText("fact-left", "–");
    return;
  }
  const span = Date.now() / 1000 - Math.min(...ended.map((trial) => trial.started ?? trial.finished));
  const samples = ended.reduce((sum, trial) => sum + trial.samples, 0);
  setText("fact-rate", `${amount(samples / span)} samples/s`);
  const left = [];
  if (study.target_trials) left.push(((study.target_trials - finished(study)) * span) / ended.length);
  if (study.target_cost && samples) left.push(((study.target_cost - study.cost.samples) * span) / samples);
  setText("fact-left", left.length ? `about ${duration(Math.max(0, Math.min(...left)))}` : "no end set");
}

const views = {
  async overview() {
    const [{ ValueChart }, { BehaviourChart }, { TrialTable }] = await Promise.all([import("./valuechart.js"), import("./behaviour.js"), import("./table.js")]);
    const light = (number) => {
      space?.light(number);
      table.light(number);
      for (const card of document.querySelectorAll(".strategy")) card.classList.toggle("lit", Number(card.dataset.number) === number);
    };
    const chart = new ValueChart(document.getElementById("value-chart"), { study: study.name, trials });
    for (const button of document.querySelectorAll("[data-x]")) {
      button.onclick = () => {
        chart.by = button.dataset.x;
        for (const other of document.querySelectorAll("[data-x]")) other.setAttribute("aria-pressed", String(other === button));
        chart.draw();
      };
    }
    let space = null;
    if (behaviour) {
      space = new BehaviourChart(document.getElementById("behaviour"), { study: study.name, trials, behaviour, onHover: light });
      setText("behaviour-hint", space.hint());
    } else {
      document.getElementById("behaviour-panel").remove();
      document.querySelector(".grid.two").classList.add("alone");
    }
    const table = new TrialTable(document.getElementById("table"), { study: study.name, trials, behaviour, units, onHover: light });
    const strategies = behaviour ? new Strategies(light) : null;
    return {
      draw(changes) {
        chart.draw();
        table.draw();
        space?.draw();
        if (changes.history) strategies?.refresh((found) => { if (space) { space.strategies = found; space.draw(); } });
      },
    };
  },
  async trials() {
    const [{ TrialTable }, { filters }] = await Promise.all([import("./table.js"), import("./filters.js")]);
    const table = new TrialTable(document.getElementById("table"), { study: study.name, trials, behaviour, units });
    const bar = filters(document.getElementById("filters"), table, `/api/v1${base}/trials.csv`);
    return { draw() { bar.draw(); table.draw(); } };
  },
  async events() {
    const { Events } = await import("./events.js");
    const events = new Events(document.getElementById("events"), document.getElementById("filters"), base);
    await events.load();
    return { draw() {}, onEvents: (frame) => events.add(frame), reload: () => events.load() };
  },
  async file() {
    document.getElementById("file").textContent = JSON.stringify(study.spec, null, 2);
    return { draw() {} };
  },
};

// The gallery: one card for each distinct strategy, asked for when the history has grown.
class Strategies {
  #asked = -1;
  #busy = false;

  constructor(light) { this.light = light; }

  async refresh(tell) {
    const length = trials.history().length;
    if (this.#busy || length === this.#asked) return;
    this.#busy = true;
    this.#asked = length;
    try {
      const { strategies } = await api(`${base}/strategies`);
      this.draw(strategies);
      tell(strategies);
    } finally {
      this.#busy = false;
      if (trials.history().length !== length) setTimeout(() => this.refresh(tell), 500);
    }
  }

  draw(strategies) {
    document.getElementById("fact-distinct-box").hidden = false;
    setText("fact-distinct", String(strategies.length));
    document.getElementById("strategies").hidden = !strategies.length;
    const moving = strategies.filter((found) => found.replay).slice(0, 4).map((found) => found.number);
    const together = document.getElementById("together");
    together.hidden = moving.length < 2;
    together.href = `${base}/trials/${moving[0]}?beside=${moving.slice(1).join()}`;
    document.getElementById("gallery").replaceChildren(...strategies.map((found, index) => {
      const where = behaviour.names.map((name, i) => `${name} ${feature(found.features[i], behaviour.unit)}`).join(", ");
      const picture = element("span", { className: "picture" });
      if (found.pose) picture.append(element("img", { src: `/api/v1${base}/trials/${found.number}/artifacts/pose.png`, alt: `Pose of trial ${found.number}`, loading: "lazy" }));
      else picture.append("no picture");
      const card = element(
        "a", { className: "strategy", href: `${base}/trials/${found.number}`, dataset: { number: found.number } }, picture,
        element("span", { className: "words" }, element("strong", { textContent: `${index + 1} · ${where}` }), element("span", { textContent: `value ${number(found.value)}` }),
          element("span", { textContent: `trial ${found.number}${found.members > 1 ? `, and ${found.members - 1} like it` : ""}` })),
      );
      card.onmouseenter = card.onfocus = () => this.light(found.number);
      card.onmouseleave = card.onblur = () => this.light(-1);
      return card;
    }));
  }
}

facts();
const ready = Promise.all([views[page.view](), trials.load()]).then(([view, position]) => {
  pace();
  view.draw({ history: true });
  document.body.dataset.ready = "yes";
  return [view, position];
});
setInterval(() => { if (study.state === "running") pace(); }, 2000);

ready.then(([view, position]) => new Live({
  position: { cursor: position.cursor, history: position.history },
  study: study.name,
  onFrame(frame) {
    if (frame.type === "study") {
      study = { ...study, ...frame.study };
      facts();
      pace();
    } else if (frame.type === "deleted") {
      banner(`The study ${study.name} was deleted. What you see is what was known of it.`);
      document.getElementById("actions").replaceChildren();
    } else if (frame.type === "events") {
      const before = trials.history().length;
      trials.apply(frame.trials);
      view.draw({ history: trials.history().length !== before });
      view.onEvents?.(frame);
    }
  },
  async onReset() {
    let fresh;
    try {
      fresh = await api(base);
    } catch (error) {
      if (error.status === 404) banner(`The study ${study.name} does not exist any more (or the database is another one). What you see is what was known of it.`);
      throw error;
    }
    study = fresh;
    facts();
    const at = await trials.load();
    await view.reload?.();
    pace();
    view.draw({ history: true });
    return at;
  },
})).catch((error) => banner(error.message));
