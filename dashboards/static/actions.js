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
    label: "Extend", yes: "Extend", states: ["queued", "running", "paused", "complete"], number: "More trials",
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
    type: "button", textContent: ACTIONS[name].label, onclick: () => confirm(name, study.name), dataset: { action: name },
  }));
}

async function confirm(name, study) {
  const action = ACTIONS[name];
  const dialog = document.getElementById("confirm");
  const [title, text, field, problem, yes] = ["title", "text", "number", "problem", "yes"].map((part) => document.getElementById(`confirm-${part}`));
  title.textContent = `${action.label} ${study}?`;
  text.textContent = action.text;
  field.hidden = !action.number;
  field.querySelector("span").textContent = action.number ?? "";
  problem.hidden = true;
  yes.textContent = action.yes;
  yes.onclick = async (event) => {
    event.preventDefault();
    yes.disabled = true;
    const body = action.number ? { trials: Number(field.querySelector("input").value) } : {};
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
