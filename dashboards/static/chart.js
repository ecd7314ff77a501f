// Plotly in the page's own colours: loaded when the first chart is wanted, redrawn when the theme changes.
import { isDark, onTheme } from "./plain.js";

let loading = null;

export function plotly() {
  loading ??= new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = new URL("./vendor/plotly.js", import.meta.url);
    script.onload = () => resolve(window.Plotly);
    script.onerror = () => reject(new Error("Charts are not installed: run python -m dashboards.vendor"));
    document.head.append(script);
  });
  return loading;
}

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

export const SYMBOLS = {
  complete: "circle", infeasible: "diamond-open", diverged: "asterisk-open", failed: "x-thin-open", cancelled: "line-ew-open",
  running: "circle-open", queued: "circle-open-dot",
};

// Okabe and Ito's palette, in an order whose neighbours differ in lightness too.
const SERIES = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
// The same hues on a dark ground, where the first three would sink.
const SERIES_DARK = ["#56b4e9", "#f2854a", "#2fc49a", "#e29cc4", "#f0c24f", "#8fb8ff"];
export const KINDS = SERIES.length;

export function series(index) { return (isDark() ? SERIES_DARK : SERIES)[index % KINDS]; }

// An axis that counts: no tick between two whole numbers.
export function counted(values) {
  const span = Math.max(...values) - Math.min(...values);
  return { tickformat: "d", ...(span <= 10 ? { dtick: 1 } : {}) };
}

function axis(title, more = {}) {
  return {
    title: { text: title, standoff: 8, font: { size: 12, color: colour("soft") } },
    gridcolor: colour("line"), zeroline: false, linecolor: colour("line"), tickcolor: colour("line"),
    tickfont: { size: 11, color: colour("soft") }, ticks: "outside", ticklen: 4, automargin: true, ...more,
  };
}

function layout({ x, y, legend = false, margin = {}, ...more }) {
  const font = getComputedStyle(document.body).fontFamily;
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { family: font, size: 12, color: colour("ink") },
    margin: { l: 48, r: 12, t: legend ? 30 : 8, b: 40, ...margin }, xaxis: axis(x.title, x.more), yaxis: axis(y.title, y.more),
    hovermode: "closest", showlegend: legend, legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0, font: { size: 11 } },
    hoverlabel: { bgcolor: colour("sheet"), bordercolor: colour("line"), font: { family: font, size: 12, color: colour("ink") } },
    dragmode: "zoom", uirevision: "stay", ...more,
  };
}

// A chart that is drawn again and again: `describe()` gives {traces, x, y, ...} from what is known now.
export class Chart {
  #queued = false;
  #drawing = false;

  constructor(at, describe, { name = "chart", onClick = null, onHover = null } = {}) {
    this.at = at;
    this.describe = describe;
    this.name = name;
    this.onClick = onClick;
    this.onHover = onHover;
    onTheme(() => this.draw());
    new ResizeObserver(() => { if (window.Plotly && at.data) window.Plotly.Plots.resize(at); }).observe(at);
  }

  // Many changes in one frame draw once; one that comes while drawing draws once more. The frame is painted first:
  // what is new in words is on the screen before a chart of thousands of marks is drawn again.
  draw() {
    if (this.#queued) return;
    this.#queued = true;
    requestAnimationFrame(() => setTimeout(() => this.#now(), 0));
  }

  async #now() {
    if (this.#drawing) { setTimeout(() => this.#now(), 50); return; }
    this.#queued = false;
    const { traces, empty, always, ...rest } = this.describe();
    if (!traces.length) {
      if (window.Plotly && this.at.data) window.Plotly.purge(this.at);
      this.at.textContent = "";
      this.at.append(Object.assign(document.createElement("p"), { className: "empty", textContent: empty ?? "Nothing to show yet." }));
      return;
    }
    this.#drawing = true;
    try {
      const Plotly = await plotly();
      const first = !this.at.data;
      if (first) this.at.textContent = "";
      // On a phone the legend would cover the chart; the table below names the shapes.
      const legend = rest.legend && (always || this.at.clientWidth > 480);
      await Plotly.react(this.at, traces, layout({ ...rest, legend }), {
        displayModeBar: false, responsive: false, doubleClick: "reset", toImageButtonOptions: { format: "svg" },
      });
      if (first) {
        if (this.onClick) this.at.on("plotly_click", (event) => this.onClick(event.points[0]));
        if (this.onHover) {
          this.at.on("plotly_hover", (event) => this.onHover(event.points[0]));
          this.at.on("plotly_unhover", () => this.onHover(null));
        }
        this.at.dataset.drawn = "yes";
      }
    } catch (error) {
      this.at.textContent = "";
      this.at.append(Object.assign(document.createElement("p"), { className: "empty", textContent: error.message }));
    } finally {
      this.#drawing = false;
    }
  }

  async save(format) {
    const Plotly = await plotly();
    const box = this.at.getBoundingClientRect();
    await Plotly.downloadImage(this.at, { format, filename: this.name, width: box.width, height: box.height, scale: format === "png" ? 2 : 1 });
  }
}
