// Other trials' motions, or a reference clip, beside this one, in step: all pass the bar at the same moment, all are seen from the same side.
import { LARGEST_CLIP, clipReplay } from "./clip.js";
import { HalmaReplay } from "./replay.js";
import { element } from "./plain.js";

const MOST = 3;

export function besides(form, motions, { study, trial }) {
  const first = motions.querySelector("halma-replay");
  const said = document.getElementById("beside-said");
  const input = form.querySelector("input[type=number]");
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
    const trials = [...others.keys()].filter((key) => typeof key === "number");
    if (trials.length) query.set("beside", trials.join());
    else query.delete("beside");
    history.replaceState(null, "", query.size ? `?${query}` : location.pathname);
    motions.classList.toggle("many", others.size > 0);
  }

  function remove(key) {
    others.get(key)?.figure.remove();
    others.delete(key);
    remember();
  }

  function full() {
    if (others.size >= MOST) complain(`At most ${MOST} others fit beside it.`);
    return others.size >= MOST;
  }

  // One more motion under its caption; `key` is a trial's number or a clip's name.
  function stand(key, title, fill) {
    const replay = new HalmaReplay();
    replay.setAttribute("led", "");
    fill(replay);
    const caption = element("figcaption", {}, title, element("button", { type: "button", className: "quiet", textContent: "Remove", onclick: () => remove(key) }));
    const figure = element("figure", { dataset: { beside: key } }, replay, caption);
    others.set(key, { replay, figure });
    replay.addEventListener("ready", () => { look(); follow(); });
    replay.addEventListener("failed", (event) => { remove(key); complain(`${title.textContent}: ${event.detail}`); });
    motions.append(figure);
    remember();
  }

  function add(number) {
    said.hidden = true;
    if (number === trial) { complain("That is this trial."); return; }
    if (others.has(number)) { complain(`Trial ${number} is there already.`); return; }
    if (full()) return;
    const address = `/studies/${encodeURIComponent(study)}/trials/${number}`;
    stand(number, element("a", { href: address, textContent: `Trial ${number}` }), (replay) => replay.setAttribute("src", `/api/v1${address}/artifacts/replay.bin`));
  }

  async function addClip(file) {
    said.hidden = true;
    if (others.has(file.name)) { complain(`${file.name} is there already.`); return; }
    if (full()) return;
    if (file.size > LARGEST_CLIP) { complain(`${file.name}: expected at most ${Math.round(LARGEST_CLIP / 1000)} kB, found ${Math.round(file.size / 1000)} kB.`); return; }
    try {
      const buffer = await clipReplay(file, first.replay?.header.bar ?? 0);
      stand(file.name, element("span", { textContent: file.name }), (replay) => replay.show(buffer));
    } catch (error) {
      complain(`${file.name}: ${error.message}`);
    }
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
  const clip = form.querySelector("input[type=file]");
  clip.onchange = async () => {
    if (clip.files[0]) await addClip(clip.files[0]);
    clip.value = "";
  };
  first.addEventListener("seek", follow);
  const begin = () => {
    first.stage.controls.addEventListener("change", look);
    for (const number of (new URLSearchParams(location.search).get("beside") ?? "").split(",")) if (/^\d+$/.test(number)) add(Number(number));
  };
  if (first.dataset.state === "ready") begin();
  else first.addEventListener("ready", begin, { once: true });
}
