// Other trials' motions beside this one, in step: all pass the bar at the same moment, all are seen from the same side.
import { HalmaReplay } from "./replay.js";
import { element } from "./plain.js";

const MOST = 3;

export function besides(form, motions, { study, trial }) {
  const first = motions.querySelector("halma-replay");
  const said = document.getElementById("beside-said");
  const input = form.querySelector("input");
  const others = new Map();

  function follow() {
    for (const { replay } of others.values()) {
      if (!replay.stage || !first.stage) continue;
      replay.seek((replay.crossing ?? 0) + first.time - (first.crossing ?? 0));
    }
  }

  function look() {
    for (const { replay } of others.values()) if (replay.stage && first.stage) replay.stage.lookLike(first.stage);
  }

  function remember() {
    const query = new URLSearchParams(location.search);
    if (others.size) query.set("beside", [...others.keys()].join());
    else query.delete("beside");
    history.replaceState(null, "", query.size ? `?${query}` : location.pathname);
    motions.classList.toggle("many", others.size > 0);
  }

  function remove(number) {
    others.get(number)?.figure.remove();
    others.delete(number);
    remember();
  }

  function add(number) {
    said.hidden = true;
    const problem = number === trial ? "That is this trial." : others.has(number) ? `Trial ${number} is there already.` : others.size >= MOST ? `At most ${MOST} others fit beside it.` : null;
    if (problem) return complain(problem);
    const files = `/api/v1/studies/${encodeURIComponent(study)}/trials/${number}/artifacts`;
    const replay = new HalmaReplay();
    replay.setAttribute("led", "");
    replay.setAttribute("src", `${files}/replay.bin`);
    const caption = element(
      "figcaption", {}, element("a", { href: `/studies/${encodeURIComponent(study)}/trials/${number}`, textContent: `Trial ${number}` }),
      element("button", { type: "button", className: "quiet", textContent: "Remove", onclick: () => remove(number) }),
    );
    const figure = element("figure", { dataset: { beside: number } }, replay, caption);
    others.set(number, { replay, figure });
    replay.addEventListener("ready", () => { look(); follow(); });
    replay.addEventListener("failed", (event) => { remove(number); complain(`Trial ${number}: ${event.detail}`); });
    motions.append(figure);
    remember();
  }

  function complain(problem) {
    said.textContent = problem;
    said.hidden = false;
  }

  form.onsubmit = (event) => {
    event.preventDefault();
    add(Number(input.value));
    input.value = "";
  };
  first.addEventListener("seek", follow);
  const begin = () => {
    first.stage.controls.addEventListener("change", look);
    for (const number of (new URLSearchParams(location.search).get("beside") ?? "").split(",")) if (/^\d+$/.test(number)) add(Number(number));
  };
  if (first.dataset.state === "ready") begin();
  else first.addEventListener("ready", begin, { once: true });
}
