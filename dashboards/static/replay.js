// <halma-replay src="…/replay.bin" poster="…/pose.png">: a recorded motion in 3-D.
// Space plays and pauses, arrows step frame by frame, Home and End go to the ends, B to the bar; drag to look around.
import { isDark, onTheme } from "./plain.js";
import { fetchReplay, overTheBar, read } from "./replayfile.js";

const sheet = new CSSStyleSheet();
sheet.replaceSync(`
  :host { display: block; position: relative; container-type: inline-size; }
  .view { position: relative; height: calc(100% - 38px); background: linear-gradient(#dfe5ea, #f4f5f5); color: #1c2126; border-radius: 4px; overflow: hidden; }
  :host([dark]) .view { background: linear-gradient(#1d242b, #2a3138); color: #e7e4df; }
  canvas { width: 100%; height: 100%; display: block; touch-action: none; }
  canvas:focus-visible, button:focus-visible, input:focus-visible, select:focus-visible { outline: 2px solid var(--focus); outline-offset: -2px; }
  img { width: 100%; height: 100%; object-fit: contain; display: block; }
  .said { position: absolute; left: 0; right: 0; bottom: 0; margin: 0; padding: 6px 12px; background: rgb(255 255 255 / 0.85); color: #1c2126; }
  :host([dark]) .said { background: rgb(20 23 26 / 0.85); color: #e7e4df; }
  .figures { position: absolute; left: 10px; top: 8px; margin: 0; font-size: 12px; font-variant-numeric: tabular-nums; pointer-events: none; text-shadow: 0 0 3px #fff; white-space: pre-line; }
  :host([dark]) .figures { text-shadow: 0 0 3px #000; }
  .bar { display: flex; gap: 8px; align-items: center; height: 38px; padding-top: 6px; }
  input[type=range] { flex: 1; min-width: 60px; accent-color: var(--accent); }
  button, select { font: inherit; color: var(--ink); background: var(--sheet); border: 1px solid var(--line); border-radius: 4px; padding: 2px 9px; cursor: pointer; }
  button[aria-pressed=true] { background: var(--hover); font-weight: 550; }
  .clock { min-width: 4.2em; text-align: right; font-variant-numeric: tabular-nums; }
  :host([led]) .bar { display: none; }
  :host([led]) .view { height: 100%; }
  @container (max-width: 420px) { .home, .bar-button { display: none; } .bar { gap: 5px; } input[type=range] { min-width: 30px; } button, select { padding: 2px 6px; } .clock { min-width: 3.4em; } }
`);

const FRAME = /* html */ `
  <div class="view"><canvas tabindex="0" role="img"></canvas><p class="figures"></p></div>
  <div class="bar">
    <button class="play" type="button">Play</button>
    <input type="range" min="0" value="0" step="any" aria-label="Time in seconds">
    <span class="clock"></span>
    <select aria-label="Speed"><option value="0.1">0.1×</option><option value="0.25">0.25×</option><option value="0.5" selected>0.5×</option><option value="1">1×</option></select>
    <button class="bar-button" type="button" title="The moment over the bar (B)">Bar</button>
    <button class="follow" type="button" aria-pressed="true" title="The camera goes with the athlete">Follow</button>
    <button class="home" type="button" title="The first view again">View</button>
  </div>`;

export class HalmaReplay extends HTMLElement {
  static observedAttributes = ["src"];
  #wanted = 0;

  constructor() {
    super();
    const root = this.attachShadow({ mode: "open" });
    root.adoptedStyleSheets = [sheet];
    root.innerHTML = FRAME;
    const part = (query) => root.querySelector(query);
    [this.view, this.canvas, this.figures, this.button, this.range, this.clock, this.speed, this.followButton] =
      [".view", "canvas", ".figures", ".play", "input", ".clock", "select", ".follow"].map(part);
    this.playing = false;
    this.drawn = 0;
    this.button.onclick = () => (this.playing ? this.pause() : this.play());
    this.range.oninput = () => { this.pause(); this.seek(Number(this.range.value)); };
    part(".bar-button").onclick = () => this.toTheBar();
    part(".home").onclick = () => { this.stage?.home(); this.stage?.draw(); };
    this.followButton.onclick = () => { this.stage.follow = !this.stage.follow; this.followButton.setAttribute("aria-pressed", String(this.stage.follow)); };
    this.canvas.onkeydown = (event) => this.#key(event);
  }

  // Show a recording that is already here, instead of the one at `src`.
  show(buffer) {
    this.given = buffer;
    if (this.isConnected) this.#load();
  }

  connectedCallback() {
    this.#dress();
    this.#load();
    this.wired ??= onTheme(() => this.#dress()) ?? true;
  }

  // The scene follows the page: a bright window in a dark page blinds.
  #dress() {
    this.toggleAttribute("dark", isDark());
    this.stage?.dress(isDark());
  }

  attributeChangedCallback(name, before, now) { if (this.isConnected && before !== now) this.#load(); }

  disconnectedCallback() {
    this.pause();
    this.observer?.disconnect();
    this.stage?.dispose();
    this.stage = null;
  }

  get duration() { return this.replay ? (this.replay.frames - 1) * this.replay.step : 0; }

  get time() { return this.stage?.time ?? 0; }

  async #load() {
    const turn = ++this.#wanted;
    const src = this.getAttribute("src");
    this.dataset.state = "loading";
    try {
      const [replay, { Stage }] = await Promise.all([this.given ? read(this.given) : fetchReplay(src), import("./stage.js")]);
      if (turn !== this.#wanted || !this.isConnected) return;
      this.stage?.dispose();
      this.replay = replay;
      this.stage = new Stage(this.canvas, replay, { dark: isDark(), onDraw: () => { this.drawn++; } });
    } catch (error) {
      if (turn === this.#wanted) this.#fail(error);
      return;
    }
    const jumps = this.replay.header.bar > 0;
    this.crossing = jumps ? overTheBar(this.replay) : null;
    this.shadowRoot.querySelector(".bar-button").hidden = !jumps;
    this.range.max = this.duration;
    this.observer = new ResizeObserver(() => this.stage?.resize(this.view.clientWidth || 1, this.view.clientHeight || 1));
    this.observer.observe(this.view);
    this.stage.resize(this.view.clientWidth || 1, this.view.clientHeight || 1);
    this.untouched = true;
    // The moment that tells the motions apart; playing begins at the beginning.
    this.seek(this.crossing ?? 0);
    this.stage.home();
    this.stage.draw();
    this.dataset.state = "ready";
    this.dispatchEvent(new Event("ready"));
  }

  #fail(error) {
    this.dataset.state = "failed";
    this.dispatchEvent(new CustomEvent("failed", { detail: error.message }));
    const poster = this.getAttribute("poster");
    const said = Object.assign(document.createElement("p"), { className: "said", textContent: `${error.message} ${poster ? "This is the moment over the bar." : ""}` });
    this.view.replaceChildren(...(poster ? [Object.assign(document.createElement("img"), { src: poster, alt: "The athlete over the bar" })] : []), said);
    this.shadowRoot.querySelector(".bar").style.display = "none";
  }

  seek(time) {
    if (!this.stage) return;
    const at = Math.max(0, Math.min(time, this.duration));
    this.stage.seek(at);
    this.range.value = at;
    this.clock.textContent = `${at.toFixed(2)} s`;
    const height = this.stage.com(at).y;
    const { bar } = this.replay.header;
    const beside = bar > 0 ? ` (bar ${bar.toFixed(2)} m)` : `, ${this.stage.com(at).x.toFixed(1)} m along`;
    this.figures.textContent = `centre of mass ${height.toFixed(2)} m${beside}${this.stage.force > 0.02 ? `\npush ${this.stage.force.toFixed(1)} × body weight` : ""}`;
    this.canvas.setAttribute("aria-label", `The motion at ${at.toFixed(2)} seconds; centre of mass at ${height.toFixed(2)} metres`);
    this.dispatchEvent(new Event("seek"));
  }

  toTheBar() {
    this.pause();
    this.untouched = false;
    this.seek(this.crossing ?? 0);
  }

  play() {
    if (!this.stage || this.playing) return;
    if (this.untouched || this.time >= this.duration) this.seek(0);
    this.untouched = false;
    this.playing = true;
    this.button.textContent = "Pause";
    let last = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      const next = this.time + ((now - last) / 1000) * Number(this.speed.value);
      last = now;
      this.seek(next);
      if (next >= this.duration) this.pause();
      else this.frame = requestAnimationFrame(tick);
    };
    this.frame = requestAnimationFrame(tick);
  }

  pause() {
    this.playing = false;
    this.button.textContent = "Play";
    cancelAnimationFrame(this.frame);
  }

  #key(event) {
    const step = this.replay?.step ?? 0;
    const act = {
      " ": () => (this.playing ? this.pause() : this.play()),
      ArrowRight: () => { this.pause(); this.untouched = false; this.seek(this.time + step); },
      ArrowLeft: () => { this.pause(); this.untouched = false; this.seek(this.time - step); },
      Home: () => { this.pause(); this.seek(0); },
      End: () => { this.pause(); this.untouched = false; this.seek(this.duration); },
      b: () => this.toTheBar(),
    }[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }
}

customElements.get("halma-replay") ?? customElements.define("halma-replay", HalmaReplay);
