// Pause, resume, cancel, extend: each asks first, then shows the service's answer or its reason.
import { element } from "./plain.js";
import { post } from "./live.js";

const ACTIONS = {
  pause: {
    label: "Pause", yes: "Pause", states: ["queued", "running"],
    text: "Running trials stop at their next checkpoint and continue from there later.",
  },
  resume: { label: "Resume", yes: "Resume", states: ["paused", "cancelled"], text: "Interrupted trials continue from their checkpoints." },
  extend: {
    label: "Extend", yes: "Extend", states: ["queued", "running", "paused", "complete"], number: true,
    text: "The search goes on from everything it has found so far.",
  },
  cancel: {
    label: "Cancel", yes: "Cancel the study", states: ["queued", "running", "paused"],
    text: "Running trials are stopped. What was found stays, and the study can be resumed.",
  },
};

export function actionsFor(study) {
  return Object.entries(ACTIONS)
    .filter(([name, action]) => action.states.includes(study.state) && !(name === "pause" && study.wanted === "pause"))
    .map(([name]) => name);
}

export function buttons(study, names = actionsFor(study)) {
  return names.map((name) => element("button", {
    type: "button", textContent: ACTIONS[name].label, onclick: () => confirm(name, study), dataset: { action: name },
  }));
}

// A study whose budget is counted in samples is given more of those.
function budgetOf(study) {
  return study.target_trials || !study.target_cost
    ? { name: "trials", label: "More trials", value: 10, step: 1 }
    : { name: "cost", label: "More samples", value: Math.round(study.target_cost / 2), step: "any" };
}

async function confirm(name, { name: study, ...rest }) {
  const action = ACTIONS[name];
  const budget = budgetOf(rest);
  const dialog = document.getElementById("confirm");
  const [title, text, field, problem, yes] = ["title", "text", "number", "problem", "yes"].map((part) => document.getElementById(`confirm-${part}`));
  title.textContent = `${action.label} ${study}?`;
  text.textContent = action.text;
  field.hidden = !action.number;
  const input = field.querySelector("input");
  field.querySelector("span").textContent = budget.label;
  Object.assign(input, { step: budget.step, value: budget.value });
  problem.hidden = true;
  yes.textContent = action.yes;
  yes.onclick = async (event) => {
    event.preventDefault();
    yes.disabled = true;
    const body = action.number ? { [budget.name]: Number(input.value) } : {};
    try {
      await post(`/studies/${encodeURIComponent(study)}/${name}`, body);
      dialog.close();
    } catch (error) {
      problem.textContent = error.message;
      problem.hidden = false;
    } finally {
      yes.disabled = false;
    }
  };
  dialog.showModal();
}

// A new study file like this one, to be changed before it is submitted.
export function clone(study) {
  return [element("a", { className: "button", href: `/submit?study=${encodeURIComponent(study.name)}`, textContent: "Clone", title: "A new study file like this one", dataset: { action: "clone" } })];
}
