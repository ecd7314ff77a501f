// What every page does: the theme button, and times in the reader's own zone.
import { moment } from "./format.js";

export function isDark() {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

export function onTheme(redraw) {
  addEventListener("halma-theme", redraw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}

export function localTimes(root = document) {
  for (const time of root.querySelectorAll("time[datetime]")) {
    if (time.dateTime && time.dataset.shown !== time.dateTime) {
      time.dataset.shown = time.dateTime;
      time.textContent = moment(time.dateTime);
      time.title = time.dateTime;
    }
  }
}

export function data() {
  return JSON.parse(document.getElementById("data").textContent);
}

export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "dataset") Object.assign(made.dataset, value);
    else if (name.includes("-") || name === "role") made.setAttribute(name, value);
    else made[name] = value;
  }
  made.append(...children);
  return made;
}

export function setText(id, text) {
  const at = document.getElementById(id);
  if (at && at.textContent !== text) at.textContent = text;
}

document.getElementById("theme")?.addEventListener("click", () => {
  const next = isDark() ? "light" : "dark";
  document.documentElement.dataset.theme = next;
  localStorage.setItem("halma-theme", next);
  dispatchEvent(new Event("halma-theme"));
});
localTimes();
