// A study file by paste or upload; what is wrong with it is shown at its line.
import { post } from "./live.js";
import { data, element } from "./plain.js";

const form = document.getElementById("submit");
const text = document.getElementById("text");
const lines = document.getElementById("lines");
const problems = document.getElementById("problems");
const DRAFT = "halma-draft";
let name = "study.yaml";

function number(wrong = new Set()) {
  const count = Math.max(text.value.split("\n").length, 24);
  text.rows = count;
  lines.replaceChildren(...Array.from({ length: count }, (_, i) => element("li", { textContent: i + 1, ...(wrong.has(i + 1) ? { dataset: { wrong: "" }, title: "see below" } : {}) })));
}

function goTo(line) {
  const start = text.value.split("\n").slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
  text.focus();
  text.setSelectionRange(start, start + (text.value.split("\n")[line - 1] ?? "").length);
  lines.children[line - 1]?.scrollIntoView({ block: "center" });
}

function show(error) {
  const found = error.problem?.problems?.length ? error.problem.problems : [{ line: null, field: "", message: error.message }];
  number(new Set(found.map((problem) => problem.line)));
  problems.replaceChildren(...found.map((problem) => element(
    "li", {},
    ...(problem.line ? [element("button", { type: "button", textContent: `line ${problem.line}`, onclick: () => goTo(problem.line) })] : []),
    ...(problem.field ? [element("code", { textContent: problem.field }), ": "] : []),
    problem.message,
  )));
}

if (form) {
  if (!text.value) text.value = sessionStorage.getItem(DRAFT) ?? "";
  number();
  text.oninput = () => { sessionStorage.setItem(DRAFT, text.value); problems.replaceChildren(); number(); };
  // Tab indents; Escape first, then Tab, leaves: so the keyboard isn't trapped.
  let leave = false;
  text.onkeydown = (event) => {
    if (event.key === "Escape") leave = true;
    else if (event.key === "Tab" && !leave && !event.shiftKey) { event.preventDefault(); text.setRangeText("  ", text.selectionStart, text.selectionEnd, "end"); number(); }
    else if (event.key !== "Tab") leave = false;
  };
  document.getElementById("upload").onchange = async (event) => {
    await open(event.target.files[0]);
    event.target.value = "";
  };
  async function open(file) {
    if (!file) return;
    if (file.size > 256 * 1024) { show(new Error(`${file.name}: expected a study file of at most 256 KiB, found ${Math.round(file.size / 1024)} KiB`)); return; }
    name = file.name;
    write(await file.text());
  }
  function write(content) {
    text.value = content;
    text.oninput();
    text.focus();
    text.setSelectionRange(0, 0);
    text.closest(".code").scrollTop = 0;
  }
  const examples = data();
  const example = document.getElementById("example");
  example.onchange = () => {
    const chosen = examples[Number(example.value)];
    if (example.value && (!text.value.trim() || confirm("Put the example in place of what is there?"))) { name = "study.yaml"; write(chosen.text); }
    example.value = "";
  };
  // A file dropped anywhere on the editor.
  const editor = document.getElementById("editor");
  for (const [event, over] of [["dragenter", true], ["dragover", true], ["dragleave", false], ["drop", false]]) {
    editor.addEventListener(event, (happened) => {
      if (!happened.dataTransfer?.types.includes("Files")) return;
      happened.preventDefault();
      editor.classList.toggle("over", over);
      if (event === "drop") open(happened.dataTransfer.files[0]);
    });
  }
  form.onsubmit = async (event) => {
    event.preventDefault();
    const send = document.getElementById("send");
    send.disabled = true;
    problems.replaceChildren();
    document.getElementById("sending").textContent = "Checking …";
    try {
      const study = await post("/studies", { text: text.value, name });
      sessionStorage.removeItem(DRAFT);
      location.assign(`/studies/${encodeURIComponent(study.name)}`);
    } catch (error) {
      show(error);
    } finally {
      send.disabled = false;
      document.getElementById("sending").textContent = "";
    }
  };
}
