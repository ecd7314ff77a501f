// Pictures that we draw ourselves, and every picture as a file.
const SVG = "http://www.w3.org/2000/svg";

export function svg(tag, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) if (value !== null && value !== undefined) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

export function keep(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

// A drawing as it stands on the page: its size, font and paper go with it, so that it looks the same elsewhere.
function standalone(drawing) {
  const box = drawing.getBoundingClientRect();
  const style = getComputedStyle(document.body);
  const copy = drawing.cloneNode(true);
  copy.setAttribute("xmlns", SVG);
  copy.setAttribute("width", Math.round(box.width));
  copy.setAttribute("height", Math.round(box.height));
  copy.setAttribute("font-family", style.fontFamily);
  const paper = getComputedStyle(document.documentElement).getPropertyValue("--sheet").trim();
  copy.prepend(svg("rect", { x: "-100%", y: "-100%", width: "300%", height: "300%", fill: paper }));
  return { text: new XMLSerializer().serializeToString(copy), width: box.width, height: box.height };
}

export async function saveDrawing(drawing, format, name) {
  const { text, width, height } = standalone(drawing);
  const blob = new Blob([text], { type: "image/svg+xml" });
  if (format === "svg") { keep(blob, `${name}.svg`); return; }
  const image = new Image();
  image.src = URL.createObjectURL(blob);
  await image.decode();
  const canvas = Object.assign(document.createElement("canvas"), { width: 2 * width, height: 2 * height });
  canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
  URL.revokeObjectURL(image.src);
  keep(await new Promise((resolve) => canvas.toBlob(resolve, "image/png")), `${name}.png`);
}

// Two quiet buttons in a panel's head. `target()` is a Chart, an svg element, or null while there is nothing to save.
export function saveButtons(panel, name, target) {
  panel.querySelector(".panel-head").append(saveGroup(name, target));
}

// The same for a small picture: seen when it is pointed at, or when the keyboard comes to it.
export function saveSmall(box, name, target) {
  const group = saveGroup(name, target);
  group.classList.add("small");
  box.append(group);
}

function saveGroup(name, target) {
  const group = Object.assign(document.createElement("span"), { className: "save" });
  group.setAttribute("role", "group");
  group.setAttribute("aria-label", `Save the picture ${name}`);
  for (const format of ["svg", "png"]) {
    const button = Object.assign(document.createElement("button"), { type: "button", className: "quiet", textContent: format.toUpperCase(), title: `Save as ${format.toUpperCase()}` });
    button.dataset.save = format;
    button.onclick = () => {
      const found = target();
      if (found instanceof SVGElement) saveDrawing(found, format, name);
      else found?.save(format);
    };
    group.append(button);
  }
  return group;
}
