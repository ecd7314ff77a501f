// The study file as it was asked for: to the clipboard, or to a file.
import { keep } from "./svg.js";

export function fileButtons(at, name) {
  const copy = document.getElementById("copy-file");
  copy.hidden = !navigator.clipboard;
  copy.onclick = async () => {
    await navigator.clipboard.writeText(at.textContent);
    copy.textContent = "Copied";
    setTimeout(() => { copy.textContent = "Copy"; }, 1500);
  };
  document.getElementById("download-file").onclick = () => keep(new Blob([at.textContent], { type: "text/yaml" }), `${name}.yaml`);
}
