// One time cursor through the drawing of the robot and everything below it.

const $ = (id) => document.getElementById(id);
const SPANS = [["all", Infinity], ["5 s", 5], ["1 s", 1]];
const UNKNOWN = 1 / 30;  // [s] of a control step where an environment does not say

class Instrument {
  constructor(episodes) {
    this.episodes = episodes;
    this.speed = 1; this.span = Infinity; this.playing = false;
    this.poster = Number($("instrument").dataset.poster) || 0;  // share of an episode at which it opens
    this._wire();
  }

  async open(number) {
    this.number = number;
    this._take(await unpackEpisode(this.episodes[number]));
    this.step = this.poster * (this.episode.steps - 1);
    this.posed = this.poster > 0;
    this._jumps();
    this.paint();
    document.documentElement.dataset.ready = String(number);
  }

  _take(episode) {
    this.episode = episode;
    this.period = this.episode.period || UNKNOWN;
    const kind = this.episode.scene && this.episode.scene.kind;
    const View = { bodies: BodiesView, track: TrackView, maps: MapsView, film: FilmView }[kind];
    this.view = View ? new View(this.episode) : null;
    this.word = kind === "maps" ? "span" : "control step";
    $("stage").hidden = !this.view;
    this._invite();
    this.step = 0;
    $("time").max = this.episode.steps - 1;
    this._list();
  }

  // colours of the page as they are now, light or dark
  paint() {
    const style = getComputedStyle(document.documentElement), of = (name) => style.getPropertyValue(name).trim();
    const kinds = { ann: of("--ann"), snn: of("--snn"), control: of("--control") };
    const last = this.episode.players.at(-1);
    const colour = (player) => (player === last && player.network ? of("--chip") : kinds[player.kind] || of("--control"));
    this.colours = {
      sky: of("--stage"), grid: of("--grid"), ink: of("--ink"), line: of("--line"), spike: of("--ink"), soft: of("--soft"), card: of("--card"), shadow: of("--shadow"),
      players: this.episode.players.map(colour), of: colour,
      series: SERIES.map(of),
      positive: [213, 94, 0], negative: [0, 114, 178],
    };
    this._who();
    this.drawStrips();
    this.drawScene();
    this.mark();
  }

  _who() {
    $("who").replaceChildren(...this.episode.players.map((player) => {
      const item = document.createElement("li");
      item.style.setProperty("--dot", this.colours.of(player));
      const total = player.total === null ? "" : `: ${player.total.toLocaleString("en", { maximumFractionDigits: 1 })}`;
      item.textContent = player.label + total;
      return item;
    }));
  }

  seek(step) {
    this.posed = false;
    this.step = Math.min(this.episode.steps - 1, Math.max(0, step));
    const [from] = this._window();
    if (this.span !== Infinity && from !== this.from) this.drawStrips();
    this.drawScene();
    this.mark();
  }

  toggle(on = !this.playing) {
    if (on && (this.posed || this.step >= this.episode.steps - 1)) this.step = 0;
    this.playing = on;
    $("play").textContent = on ? "Pause" : "Play";
    this._invite();
    if (!on) return;
    let before = performance.now();
    const frame = (now) => {
      if (!this.playing) return;
      this.seek(this.step + (now - before) / 1000 / this.period * this.speed);
      before = now;
      if (this.step >= this.episode.steps - 1) this.toggle(false); else requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  // the large button in the picture of what does not move; it would cover a layer of maps
  _invite() {
    if ($("start")) $("start").hidden = this.playing || !this.view || this.word === "span";
  }

  drawScene() {
    if (!this.view) return;
    const [context, width, height] = canvas($("stage"));
    this.view.draw(context, width, height, this.step, this.colours);
  }

  drawStrips() {
    const [from, to] = this._window(), { origin = 0 } = this.episode;  // steps before the first that is kept
    this.from = from;
    for (const { strip, sheet } of this.strips) {
      const [context, width, height] = canvas(sheet);
      context.clearRect(0, 0, width, height);
      strip.draw(context, width, height, from, to, this.colours);
    }
    for (const sheet of document.querySelectorAll(".axis canvas")) {
      const [context, width, height] = canvas(sheet);
      context.clearRect(0, 0, width, height);
      drawAxis(context, width, height, from + origin, to + origin, this.episode.period, this.colours);
    }
  }

  // the cursor and the numbers under it
  mark() {
    const step = Math.floor(this.step), [from, to] = this._window();
    const place = `${100 * (this.step - from) / (to - from)}%`;
    for (const { strip, value, cursor } of this.strips) {
      cursor.style.left = place;
      value.textContent = strip.value(step);
    }
    $("time").value = step;
    const seconds = this.episode.period ? `${(step * this.period).toFixed(2)} s, ` : "";
    $("now").textContent = `${seconds}${this.word} ${step.toLocaleString("en")} of ${this.episode.steps.toLocaleString("en")}`;
  }

  _window() {
    const { steps } = this.episode, length = Math.min(steps, this.span / this.period);
    const from = Math.min(steps - length, Math.max(0, this.step - length / 2));
    return [from, from + length];
  }

  _list() {
    this.strips = stripsOf(this.episode, this.period).map((strip) => {
      const row = document.createElement("div");
      row.className = "strip";
      row.innerHTML = '<div class="name"><span></span><span class="keys"></span><small></small><output></output></div><div class="plot"><canvas></canvas><i></i></div>';
      row.querySelector("span").textContent = strip.title;
      row.querySelector("small").textContent = strip.range || "";
      row.querySelector(".keys").append(...(strip.legend || []).map((colour, place) => {
        const key = document.createElement("b");
        key.style.color = `var(${colour})`;
        key.textContent = `${place} `;
        return key;
      }));
      const sheet = row.querySelector("canvas"), plot = row.querySelector(".plot");
      plot.style.height = `${strip.height}px`;
      sheet.setAttribute("role", "img");
      sheet.setAttribute("aria-label", `${strip.title} over time`);
      const follow = (event) => {
        const box = plot.getBoundingClientRect(), [from, to] = this._window();
        this.seek(from + (event.clientX - box.left) / box.width * (to - from));
      };
      plot.addEventListener("pointerdown", (event) => { this.toggle(false); plot.setPointerCapture(event.pointerId); follow(event); });
      plot.addEventListener("pointermove", (event) => { if (event.buttons) follow(event); });
      return { strip, sheet, row, value: row.querySelector("output"), cursor: row.querySelector("i") };
    });
    const axes = [0, 1].map(() => {
      const axis = document.createElement("div");
      axis.className = "axis";
      axis.append(document.createElement("canvas"));
      axis.setAttribute("aria-hidden", "true");
      return axis;
    });
    $("strips").replaceChildren(axes[0], ...this.strips.map(({ row }) => row), axes[1]);
    const main = this.episode.players.at(-1), left = (main.network && main.network.left_out) || [];
    $("left-out").textContent = left.length ? `Not drawn, for the size of this file: ${left.join(", ")}.` : "";
  }

  _jumps() {
    const found = this.episode.first_spike;
    const { twin } = this.episode;
    $("first").hidden = !found;
    $("first").onclick = () => { this.toggle(false); this.seek(found.step); };
    $("first-said").textContent = found
      ? `First spike that float and chip do not share: control step ${found.step}, ${found.layer}, neuron ${found.neuron}.`
      : twin ? "Every spike of this episode is the same in float and on the chip." : "";
    document.querySelectorAll("#episodes button").forEach((button, number) =>
      button.setAttribute("aria-pressed", String(number === this.number)));
  }

  _wire() {
    $("play").onclick = $("start").onclick = () => this.toggle();
    $("time").oninput = (event) => { this.toggle(false); this.seek(Number(event.target.value)); };
    $("speed").onchange = (event) => { this.speed = Number(event.target.value); };
    $("episodes").hidden = this.episodes.length < 2 && this.episodes.some(({ seed }) => seed === null);
    $("episodes").replaceChildren(...this.episodes.map(({ title, seed }, number) => {
      const button = document.createElement("button");
      button.textContent = seed === null ? title : `${title} (seed ${seed})`;
      button.onclick = () => { this.toggle(false); this.open(number); };
      return button;
    }));
    this._wireSpans(SPANS, Infinity);
    this._wireStage();
  }

  _wireSpans(spans, chosen) {
    $("spans").replaceChildren(...spans.map(([name, seconds]) => {
      const button = document.createElement("button");
      button.textContent = name;
      button.setAttribute("aria-pressed", String(seconds === chosen));
      button.onclick = () => {
        this.span = seconds;
        for (const other of $("spans").children) other.setAttribute("aria-pressed", String(other === button));
        if (this.episode) { this.drawStrips(); this.mark(); }
      };
      return button;
    }));
  }

  _wireStage() {
    const stage = $("stage");
    stage.addEventListener("pointerdown", (event) => stage.setPointerCapture(event.pointerId));
    stage.addEventListener("pointermove", (event) => {
      if (!event.buttons || !this.view) return;
      this.view.turn(event.movementX, event.movementY);
      this.drawScene();
    });
    stage.addEventListener("wheel", (event) => {
      if (!event.ctrlKey || !this.view) return;  // a plain wheel scrolls the page
      event.preventDefault();
      this.view.zoom = Math.min(4, Math.max(0.4, this.view.zoom * 1.0015 ** -event.deltaY));
      this.drawScene();
    }, { passive: false });
    document.addEventListener("keydown", (event) => {
      if (event.target.closest("input, select, button, summary, a") || event.ctrlKey || event.metaKey || event.altKey) return;
      const steps = { ArrowRight: 1, ArrowLeft: -1, PageDown: 50, PageUp: -50 }[event.key];
      if (event.key === " ") this.toggle();
      else if (event.key === "Home" || event.key === "End") this.seek(event.key === "Home" ? 0 : Infinity);
      else if (steps) { this.toggle(false); this.seek(Math.floor(this.step) + steps); }
      else return;
      event.preventDefault();
    });
    addEventListener("resize", () => this.episode && this.paint());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.episode && this.paint());
    addEventListener("beforeprint", () => { if (this.episode) this.paint(); });
  }
}

// a canvas of the size that it is shown with, sharp on dense screens
function canvas(sheet) {
  const { clientWidth: width, clientHeight: height } = sheet, dense = devicePixelRatio || 1;
  if (sheet.width !== Math.round(width * dense) || sheet.height !== Math.round(height * dense)) {
    sheet.width = Math.round(width * dense);
    sheet.height = Math.round(height * dense);
  }
  const context = sheet.getContext("2d");
  context.setTransform(dense, 0, 0, dense, 0, 0);
  return [context, width, height];
}

const found = $("episodes-data");
if (found) {
  const episodes = JSON.parse(found.textContent), instrument = new Instrument(episodes);
  // report.html#episode=1&step=420 opens there
  const follow = async () => {
    const asked = new URLSearchParams(location.hash.slice(1)), number = Number(asked.get("episode")) || 0;
    instrument.toggle(false);
    await instrument.open(Math.min(number, episodes.length - 1));
    if (asked.has("step")) instrument.seek(Number(asked.get("step")) || 0);
  };
  addEventListener("hashchange", () => {
    if (location.hash.startsWith("#episode=")) follow().then(() => $("instrument").scrollIntoView());
  });
  follow();
}
