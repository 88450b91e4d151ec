// The page of `run --watch`: an episode that grows while it is drawn.

const BACK = 30;  // [s] that can be looked back
const MOST = 1_500_000;  // numbers of a layer's membranes that are kept
const LIVE_SPANS = [["10 s", 10], ["5 s", 5], ["1 s", 1]];
const LAG = 0.25;  // [s] that the picture may stay behind, to move evenly

// a series that grows at its end: {rows, width, shape, values, at} as unpack.js makes them
class Growing {
  constructor({ width, shape }, most) {
    Object.assign(this, { width, shape, rows: 0, values: new Float32Array(width * most) });
  }

  at(row, column = 0) { return this.values[row * this.width + column]; }

  grow({ values }, missing) {
    const { width } = this;
    for (let k = 0; k < missing && this.rows; k++, this.rows++)  // lost on the way: as the last one
      this.values.copyWithin(this.rows * width, (this.rows - 1) * width, this.rows * width);
    this.values.set(values, this.rows * width);
    this.rows += values.length / width;
  }

  drop(rows) {
    this.values.copyWithin(0, rows * this.width, this.rows * this.width);
    this.rows -= rows;
  }
}

class GrowingSpikes {
  constructor({ neurons }, timesteps) { Object.assign(this, { neurons, timesteps, times: [], indices: [] }); }

  grow({ times, indices }, row) {
    for (let k = 0; k < times.length; k++) {
      this.times.push(times[k] + row * this.timesteps);
      this.indices.push(indices[k]);
    }
  }

  drop(rows) {
    const first = firstFrom(this.times, rows * this.timesteps);
    this.times = this.times.slice(first).map((time) => time - rows * this.timesteps);
    this.indices = this.indices.slice(first);
  }
}

class Live extends Instrument {
  constructor() {
    super([]);
    this.span = 10; this.playing = true; this.told = Promise.resolve();
    this.drawn = this.listed = this.rest = this.behind = 0;
    const events = new EventSource("/events");
    // unpacked side by side, and taken one after the other
    const on = (kind, react, unpacked = () => null) => events.addEventListener(kind, ({ data }) => {
      const told = JSON.parse(data), more = unpacked(told);
      this.behind++;
      this.told = this.told.then(async () => react(told, await more)).finally(() => { this.behind--; });
    });
    on("begin", (begun) => this._begin(begun));
    on("steps", (batch, found) => this._steps(batch, found), unpackPlayer);
    on("over", (outcome) => this._over(outcome));
    on("end", () => this._state("ended", "ended"));
    events.addEventListener("end", () => events.close());
    events.onerror = () => { if (events.readyState !== EventSource.CLOSED) this._state("lost", "connection lost"); };
    requestAnimationFrame((now) => this._frame(now));
  }

  _begin(begun) {
    Object.assign(this, { begun, growing: null, lost: 0 });  // the last episode is shown until then
    $("title").textContent = `${begun.label} in ${begun.env}`;
    document.title = `${begun.label} – spikedeploy`;
    $("episode").textContent = `episode ${begun.episode}, seed ${begun.seed}, ${begun.rate.toLocaleString("en", { maximumFractionDigits: 1 })} control steps per second`;
    $("outcome").textContent = "";
    this._state("live", "live");
  }

  async _steps(batch, found) {
    if (!this.growing) await this._first(found, batch.first);
    const episode = this.growing;
    const missing = batch.first - episode.origin - episode.steps;
    this.lost += missing;
    if (missing + batch.steps + episode.steps > 2 * this.most) this._drop(episode.steps - Math.max(1, Math.min(episode.steps, this.most)));
    if (missing > this.most / 2) {  // too much to go on: the picture begins anew
      this.growing = null;
      return this._steps(batch, found);
    }
    const row = episode.steps + missing;
    for (const [own, more] of pairs(episode.players[0], found)) own.grow(more, missing);
    this.layers.forEach((layer, k) => {
      layer.spikes.grow(found.network.layers[k].spikes, row);
      layer.count += found.network.layers[k].count;
    });
    episode.steps = row + batch.steps;
    episode.players[0].total = batch.total;
    if (this.episode !== episode) this._show(episode);
    $("time").max = episode.steps - 1;
    this._figures(batch);
  }

  // room for what comes, and nothing in it yet
  async _first(found, origin) {
    const period = this.begun.period || UNKNOWN;
    const layers = found.network ? found.network.layers : [];
    const widest = Math.max(1, ...layers.map(({ membranes }) => (membranes ? membranes.width : 1)));
    this.most = Math.max(100, Math.round(Math.min(BACK / period, MOST / widest)));
    const room = (series) => series && new Growing(series, 2 * this.most + 2000);
    this.layers = layers.map((layer) => ({
      ...layer, count: 0, spikes: new GrowingSpikes(layer.spikes, layer.timesteps), membranes: room(layer.membranes),
    }));
    const { scene } = this.begun;
    this.growing = {
      ...this.begun, origin, steps: 0, distance: null, first_spike: null,
      heights: scene && scene.ground && (await numbers(scene.ground.heights)),
      players: [{
        ...found, label: this.begun.label, kind: this.begun.kind, every: 1, total: 0, poses: room(found.poses), reward: room(found.reward), actions: room(found.actions),
        tracks: found.tracks.map((track) => ({ ...track, values: room(track.values), wanted: room(track.wanted) })),
        network: found.network && { ...found.network, layers: this.layers, sops: room(found.network.sops), energy: room(found.network.energy) },
      }],
    };
  }

  _drop(rows) {
    if (rows <= 0) return;
    const episode = this.growing;
    for (const [own] of pairs(episode.players[0], episode.players[0])) own.drop(rows);
    for (const { spikes } of this.layers) spikes.drop(rows);
    episode.steps -= rows;
    episode.origin += rows;
    this.step = Math.max(0, this.step - rows);
    this.marked = -1;
  }

  _show(episode) {
    this._take(episode);
    const left = (episode.players[0].network || {}).left_out || [];
    $("left-out").textContent = left.length ? `Not shown, as they are large: ${left.join(", ")}.` : "";
    $("play").textContent = this.playing ? "Pause" : "Follow";
    this.step = episode.steps - 1;
    this.marked = -1;
    this.paint();
    document.documentElement.dataset.ready = String(episode.episode);
  }

  _figures(batch) {
    const { episode } = this, [player] = episode.players, { network } = player;
    const recent = (series) => {
      const rows = Math.max(1, Math.min(series.rows, Math.round(1 / this.period)));
      let sum = 0;
      for (let row = series.rows - rows; row < series.rows; row++) sum += series.at(row);
      return sum / rows;
    };
    $("return").textContent = short(batch.total);
    if (network && network.sops) $("operations").textContent = `${short(recent(network.sops))} SOPs`;
    if (network && network.energy) {
      $("energy").textContent = `${short(1e9 * recent(network.energy))} nJ`;
      $("table").textContent = `mean of the last second, by ${episode.table}`;
    }
    const limit = episode.deadline, use = recent(player.tracks[0].values);
    $("policy").textContent = `${short(use / 100 * limit * 1e3)} ms`;
    $("deadline").textContent = `${short(use)}% of ${short(limit * 1e3)} ms; ${batch.missed.toLocaleString("en")} missed`
      + (batch.skipped ? `, ${batch.skipped.toLocaleString("en")} periods skipped` : "");
    $("lost").textContent = this.lost ? `${this.lost.toLocaleString("en")} control steps came too late to be shown.` : "";
  }

  _over({ total, success, why }) {
    $("outcome").textContent = `${why}${success === null ? "" : success ? ", success" : ", no success"}`;
    if (this.growing) this.growing.players[0].total = total;
    $("return").textContent = short(total);
  }

  _state(name, text) {
    if (document.documentElement.dataset.state === "ended") return;
    document.documentElement.dataset.state = name;
    $("state").textContent = text;
  }

  // the scene at every picture, what is below it ten times a second
  _frame(now) {
    requestAnimationFrame((then) => this._frame(then));
    const { episode } = this, before = this.before || now;
    if (!episode || !this.playing || now < this.rest) return;
    const last = episode.steps - 1;
    this.before = now;
    if (this.step === last && this.marked === last) return;
    const next = this.step + (now - before) / 1000 / this.period * 1.02;
    this.step = Math.min(last, Math.max(next, last - LAG / this.period));
    this.drawScene();
    if (now > this.drawn) {
      if (now - this.listed > 1000) this._measure(now);
      this.drawStrips();
      this.mark();
      this.marked = this.step;
      this.drawn = now + Math.max(100, 4 * (performance.now() - now));
    }
    // half of the time is for what comes in, and more where it waits
    this.rest = 2 * performance.now() - now + (this.behind > 9 ? 500 : 0);
  }

  // new ranges of the axes, and counts
  _measure(now) {
    this.listed = now;
    stripsOf(this.episode, this.period).forEach((strip, k) => {
      this.strips[k].strip = strip;
      this.strips[k].row.querySelector("span").textContent = strip.title;
      this.strips[k].row.querySelector("small").textContent = strip.range || "";
    });
    this._who();
  }

  toggle(on = !this.playing) {
    this.playing = on;
    $("play").textContent = on ? "Pause" : "Follow";
    if (on && this.episode) this.step = Math.max(0, this.episode.steps - 2);
  }

  seek(step) { if (this.episode) super.seek(step); }

  mark() {
    super.mark();
    const step = Math.floor(this.step) + this.episode.origin;
    const seconds = this.episode.period ? `${(step * this.period).toFixed(2)} s, ` : "";
    $("now").textContent = `${seconds}control step ${step.toLocaleString("en")}`;
  }

  _window() {
    if (!this.playing) return super._window();
    const { steps } = this.episode, length = Math.min(steps, this.span / this.period);
    const from = Math.max(0, this.step + 1 - length);
    return [from, from + length];
  }

  _wire() {
    $("play").onclick = () => this.toggle();
    $("time").oninput = (event) => { this.toggle(false); this.seek(Number(event.target.value)); };
    this._wireSpans(LIVE_SPANS, 10);
    this._wireStage();
  }
}

// the series of a player beside those of another that are built alike
function pairs(one, other) {
  const found = [[one.poses, other.poses], [one.reward, other.reward], [one.actions, other.actions]];
  one.tracks.forEach((track, k) => found.push([track.values, other.tracks[k].values], [track.wanted, other.tracks[k].wanted]));
  if (one.network) {
    found.push([one.network.sops, other.network.sops], [one.network.energy, other.network.energy]);
    one.network.layers.forEach((layer, k) => found.push([layer.membranes, other.network.layers[k].membranes]));
  }
  return found.filter(([own]) => own);
}

new Live();
