// A line of a few pixels: how the best value rose.
import { number } from "./format.js";
import { svg } from "./svg.js";

const [WIDTH, HEIGHT] = [92, 26];

export function drawSpark(at, values) {
  const signature = values.join();
  if (at.dataset.drawn === signature) return;
  at.dataset.drawn = signature;
  if (values.length < 2) { at.replaceChildren(); return; }
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const x = (index) => 2 + (index / (values.length - 1)) * (WIDTH - 8);
  const y = (value) => HEIGHT - 4 - (high === low ? 0.5 : (value - low) / (high - low)) * (HEIGHT - 8);
  const path = values.map((value, index) => (index ? `H${x(index).toFixed(1)}V${y(value).toFixed(1)}` : `M${x(0)} ${y(value).toFixed(1)}`)).join("");
  at.replaceChildren(svg(
    "svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, width: WIDTH, height: HEIGHT, role: "img", class: "spark", "aria-label": `best value from ${number(values[0])} to ${number(values.at(-1))}` },
    svg("path", { d: path }), svg("circle", { cx: x(values.length - 1), cy: y(values.at(-1)), r: 2.4 }),
  ));
}
