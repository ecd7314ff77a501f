// A study, live: its facts, and whichever view of it is open.
import { actionsFor, buttons, clone } from "./actions.js";
import { amount, duration, number, stateText } from "./format.js";
import { Live, api, banner, whenSeen } from "./live.js";
import { Pace } from "./pace.js";
import { data, isDark, setText } from "./plain.js";
import { drawProgress, progressWords, runningWords } from "./progress.js";
import { saveButtons } from "./svg.js";
import { Trials } from "./trials.js";

const page = data();
let study = page.study;
const base = `/studies/${encodeURIComponent(study.name)}`;
const behaviour = study.spec.behaviour ?? null;
const units = study.spec.units ?? {};
const pace = new Pace(base);
const trials = new Trials(study.name);
// Charts need all trials, as columns; a table loads the rows that are seen.
const CHARTS = new Set(["overview", "search", "quality"]);
const trialsLoaded = CHARTS.has(page.view) ? trials.load() : Promise.resolve(page);

function facts() {
  const state = document.getElementById("study-state");
  state.dataset.state = study.state;
  setText("study-state", stateText(study.state));
  const waits = { pause: "running", cancel: "running" }[study.wanted] === study.state;
  setText("study-reason", waits ? `${study.wanted === "pause" ? "pausing" : "cancelling"}: trials come to their next checkpoint` : study.reason);
  setText("fact-trials", progressWords(study));
  // In the heading, where there is room: beside the number it would now and then take a second line and move the page.
  setText("fact-running", runningWords(study));
  drawProgress(document.getElementById("progress"), study);
  setText("fact-best", `${number(study.best_value)}${page.value.unit && study.best_value !== null ? ` ${page.value.unit}` : ""}`);
  setText("fact-samples", amount(study.cost.samples));
  setText("fact-seconds", duration(study.cost.seconds));
  setText("fact-search", `${study.strategy} on ${study.task}`);
  const names = actionsFor(study);
  const at = document.getElementById("actions");
  if (at.dataset.names !== names.join()) {
    at.dataset.names = names.join();
    at.replaceChildren(...buttons(study, names), ...clone(study));
  }
}

// Stages in the order in which they follow each other; that of a JSON object may be lost in a database.
function stageNames(stages) {
  const names = ["search"];
  for (let ready = true; ready;) {
    ready = Object.keys(stages).sort().find((name) => !names.includes(name) && stages[name].after.every((each) => names.includes(each)));
    if (ready) names.push(ready);
  }
  return names;
}

function drawStages() {
  if (!document.getElementById("fact-stages")) return;
  setText("fact-stages", stageNames(study.spec.stages).map((name) => {
    const own = trials.all().filter((trial) => trial.stage === name);
    const running = own.filter((trial) => trial.state === "running").length;
    return `${name} ${own.filter((trial) => trial.position !== null).length}${running ? ` (${running} running)` : ""}`;
  }).join(", "));
}

function drawPace() {
  const [rate, left] = pace.words(study);
  setText("fact-rate", rate);
  setText("fact-left", left);
}

// How many distinct strategies there are; the strategies' own view counts them itself.
let counting = 0;
function countDistinct(wait = 0) {
  if (!behaviour || page.view === "overview") return;
  counting ||= setTimeout(() => whenSeen(async () => {
    counting = 0;
    try {
      const { pulses: [one] } = await api(`/pulse?study=${encodeURIComponent(study.name)}`);
      if (one) setText("fact-distinct", number(one.distinct));
    } catch { /* the line at the top says that the service doesn't answer */ }
  }), wait);
}

const context = { base, study: study.name, trials, behaviour, units, space: study.spec.space ?? {}, task: study.task, value: page.value, hasDifficulty: Boolean(study.spec.has_difficulty), staged: Boolean(Object.keys(study.spec.stages ?? {}).length) };
// Before a trial has completed nobody can say what a study's value is called: the first ones tell.
function learnValue(newcomers) {
  const complete = newcomers.filter((trial) => trial.state === "complete" && trial.value !== null);
  if (!complete.length || page.value.name !== "value" || study.best_value !== null) return;
  const name = Object.keys(page.value.units).find((one) => complete.every((trial) => trial.details[one] === trial.value));
  if (!name) return;
  const unit = page.value.units[name];
  Object.assign(page.value, { name, unit, title: unit ? `${name} (${unit})` : name });
}

const panelOf = (id) => document.getElementById(id).closest(".panel");

// The best value against what it cost, with buttons for what the cost is counted in.
async function valueChart(by) {
  const { ValueChart } = await import("./valuechart.js");
  const chart = new ValueChart(document.getElementById("value-chart"), { ...context, by });
  const buttons = document.querySelectorAll("[data-x]");
  const press = () => { for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset.x === chart.by)); };
  for (const button of buttons) button.onclick = () => { chart.by = button.dataset.x; press(); chart.draw(); };
  press();
  saveButtons(panelOf("value-chart"), `${study.name}-value`, () => chart.chart);
  return chart;
}

const views = {
  async overview() {
    const [chart, { BehaviourChart }, { TrialTable }, { Strategies }] = await Promise.all([valueChart("trial"), import("./behaviour.js"), import("./table.js"), import("./strategies.js")]);
    const light = (number) => {
      space?.light(number);
      table.light(number);
      for (const card of document.querySelectorAll(".strategy")) card.classList.toggle("lit", Number(card.dataset.number) === number);
    };
    let space = null;
    if (behaviour) {
      space = new BehaviourChart(document.getElementById("behaviour"), { ...context, onHover: light, onHint: (text) => setText("behaviour-hint", text) });
      saveButtons(panelOf("behaviour"), `${study.name}-behaviours`, () => document.querySelector("#behaviour > svg"));
    }
    const table = new TrialTable(document.getElementById("table"), context, { onHover: light });
    table.rows.ask({});
    const strategies = behaviour ? new Strategies({ ...context, light }) : null;
    const show = (found) => { space.strategies = found; space.draw(); };
    return {
      draw(changes) {
        chart.draw();
        space?.draw();
        if (changes.all) strategies?.refresh(show);
      },
      onEvents(frame) {
        table.rows.apply(frame);
        strategies?.onTrials(frame.trials, show);
      },
      reload: () => table.rows.reset(),
    };
  },
  async search() {
    const [{ SliceView }, { Why }, { Fidelity }] = await Promise.all([import("./slice.js"), import("./why.js"), import("./fidelity.js")]);
    const [slice, why, fidelity] = [new SliceView({ ...context, dark: isDark }), new Why(context), new Fidelity(context)];
    await trialsLoaded;
    await why.load();
    for (const [id, name, target] of [
      ["map", "surrogate-mean", () => slice.mean], ["unsure", "surrogate-uncertainty", () => slice.deviation], ["why", "proposals", () => why.chart],
      ["ladder", "ladder", () => fidelity.ladder], ["costs", "cost-by-difficulty", () => fidelity.costs], ["lineage", "lineage", () => document.querySelector("#lineage > svg")],
    ]) saveButtons(panelOf(id), `${study.name}-${name}`, target);
    return {
      draw(changes) { slice.draw(changes); why.draw(); fidelity.draw(); },
      onEvents: (frame) => { why.add(frame.trials); why.draw(); },
      reload: () => why.load(),
    };
  },
  async quality() {
    const [chart, { Quality }] = await Promise.all([valueChart("samples"), import("./quality.js")]);
    const quality = new Quality(context);
    for (const [id, name, target] of [
      ["importance", "importances", () => document.querySelector("#importance > svg")], ["lines", "parameters", () => document.querySelector("#lines > svg")], ["overlay", "curves", () => quality.overlay.chart],
    ]) saveButtons(panelOf(id), `${study.name}-${name}`, target);
    return { draw(changes) { chart.draw(); quality.draw(changes); } };
  },
  async trials() {
    const [{ TrialTable }, { filters }] = await Promise.all([import("./table.js"), import("./filters.js")]);
    const table = new TrialTable(document.getElementById("table"), context);
    const bar = filters(document.getElementById("filters"), table, `/api/v1${base}/trials.csv`);
    return { draw() { bar.draw(study); }, onStudy: () => bar.draw(study), onEvents: (frame) => table.rows.apply(frame), reload: () => table.rows.reset() };
  },
  async events() {
    const { Events } = await import("./events.js");
    const events = new Events(document.getElementById("events"), document.getElementById("filters"), base);
    await events.load();
    return { draw() {}, onEvents: (frame) => events.add(frame), reload: () => events.load() };
  },
  async file() {
    const { fileButtons } = await import("./studyfile.js");
    fileButtons(document.getElementById("file"), study.name);
    return { draw() {} };
  },
};

facts();
const ready = Promise.all([views[page.view](), trialsLoaded, study.state === "running" ? pace.load() : null]).then(([view, position]) => {
  drawPace();
  drawStages();
  countDistinct();
  view.draw({ history: true, all: true });
  document.body.dataset.ready = "yes";
  return [view, position];
});
setInterval(() => { if (study.state === "running") drawPace(); }, 2000);

ready.then(([view, position]) => new Live({
  position: { cursor: position.cursor, history: position.history },
  study: study.name,
  onFrame(frame) {
    if (frame.type === "study") {
      study = { ...study, ...frame.study };
      facts();
      drawPace();
      view.onStudy?.();
    } else if (frame.type === "deleted") {
      banner(`The study ${study.name} was deleted. What you see is what was known of it.`);
      document.getElementById("actions").replaceChildren();
    } else if (frame.type === "events") {
      pace.add(frame.trials);
      learnValue(frame.trials);
      if (frame.trials.some((trial) => trial.position !== null)) countDistinct(10_000 * (1 + Math.random()));
      if (CHARTS.has(page.view)) {
        const before = trials.history().length;
        trials.apply(frame.trials);
        drawStages();
        view.draw({ history: trials.history().length !== before });
      }
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
    // The position first: what happens while the rest is loaded is told again, never missed.
    const at = CHARTS.has(page.view) ? await trials.load() : await api("/server");
    await Promise.all([view.reload?.(), pace.load()]);
    drawPace();
    drawStages();
    countDistinct();
    view.draw({ history: true, all: true });
    view.onStudy?.();
    return at;
  },
})).catch((error) => banner(error.message));
