// Curves, rasters and maps over the same time axis.

const SERIES = ["--chip", "--ann", "--snn", "--control"];  // colours of the page, of several curves of a player

// What is drawn of an episode, from the top down. The last player is the one the page is about.
function stripsOf(episode, period) {
  const main = episode.players.at(-1), found = [];
  const network = main.network;
  for (const layer of network ? network.layers : [])
    found.push(new RasterStrip(layer.name === "input" ? "input spikes" : `spikes of ${layer.name}`, layer));
  for (const layer of network ? network.layers : [])
    if (layer.membranes) found.push(new MapStrip(`membranes of ${layer.name}`, layer.membranes, "units of state"));
  const { actions } = main;
  const word = episode.scene && episode.scene.kind === "maps" ? "output" : "action";
  const label = actions && actions.width > 1 ? `${actions.width} ${word}s` : word;
  if (actions) found.push(actions.width > 4 ? new MapStrip(label, actions, "") : new LinesStrip(label, columns(main, actions), ""));
  if (network && network.sops) found.push(new LinesStrip("synaptic operations", [one(main, network.sops)], "SOPs"));
  if (network && network.energy) found.push(new LinesStrip("energy of a control step", [one(main, network.energy, 1e12)], "pJ"));
  main.tracks.forEach(({ title, unit, wanted }, place) => {
    const lines = wanted ? [one(null, wanted)] : [];
    for (const player of episode.players) if (player.tracks[place]) lines.push(one(player, player.tracks[place].values));
    found.push(new LinesStrip(title, lines, unit));
  });
  if (main.reward) found.push(new LinesStrip("reward", episode.players.map((p) => one(p, p.reward)), ""));
  if (episode.distance) found.push(new LinesStrip("chip apart from float, RMS of observations", [one(main, episode.distance)], ""));
  return found;
}

const one = (player, series, factor = 1) => ({ player, at: (step) => factor * series.at(step), get rows() { return series.rows; } });
const columns = (player, series) => [...Array(series.width).keys()].map(
  (column) => ({ player, at: (step) => series.at(step, column), get rows() { return series.rows; } }));

class LinesStrip {
  constructor(title, lines, unit) {
    Object.assign(this, { title, lines, unit, height: 64 });
    const values = lines.flatMap(({ at, rows }) => [...Array(rows).keys()].map(at)).sort((a, b) => a - b);
    // a few outliers must not flatten the rest: they are drawn at the edge, and the caption says how far they go
    const share = (q) => values[Math.min(values.length - 1, Math.floor(q * values.length))];
    [this.low, this.high] = [share(0.002), share(0.998)];
    [this.least, this.most] = [values[0], values.at(-1)];
    this.range = `${short(this.low)} to ${short(this.high)}`;
    if (this.least < this.low || this.most > this.high) {
      const all = `${short(this.least)} to ${short(this.most)}`;
      if (all !== this.range) this.range += `, a few beyond: ${all}`;
    }
    if (this.high - this.low < 1e-12) [this.low, this.high] = [Math.min(0, this.low), Math.max(1, this.high)];
    this.alone = lines.every(({ player }) => player === lines[0].player);
    // numbers of the curves in their colours, from 0
    this.legend = this.alone && lines.length > 1 ? lines.map((_, place) => SERIES[place % SERIES.length]) : [];
  }

  value(step) {
    const values = this.lines.map(({ at, rows }) => (step < rows ? short(at(Math.min(step, rows - 1))) : "–"));
    return values.slice(this.alone ? 0 : -1).join(", ") + (this.unit && ` ${this.unit}`);
  }

  draw(context, width, height, from, to, paint) {
    const y = (value) => height - 4 - (height - 8) * (Math.min(this.high, Math.max(this.low, value)) - this.low) / (this.high - this.low);
    if (this.low < 0 && this.high > 0) {
      context.fillStyle = paint.line;
      context.fillRect(0, y(0), width, 1);
    }
    this.lines.forEach((line, place) => {
      const last = Math.min(line.rows - 1, Math.ceil(to)), first = Math.max(0, Math.floor(from));
      const skip = Math.max(1, Math.floor((last - first) / (2 * width)));
      context.strokeStyle = this.alone ? paint.series[place % paint.series.length] : line.player ? paint.of(line.player) : paint.soft;
      context.lineWidth = 1.3;
      context.beginPath();
      for (let step = first; step <= last; step += skip) {
        const x = (step - from) / (to - from) * width;
        if (step === first) context.moveTo(x, y(line.at(step))); else context.lineTo(x, y(line.at(step)));
      }
      context.stroke();
    });
  }
}

class RasterStrip {
  constructor(title, layer) {
    const { neurons } = layer.spikes;
    const size = neurons === 1 ? "1 neuron" : `${neurons.toLocaleString("en")} neurons`;
    Object.assign(this, { title: `${title} (${size}, ${layer.count.toLocaleString("en")} spikes)`, layer });
    this.height = Math.min(150, Math.max(40, 8 * Math.min(neurons, 16)));
  }

  value(step) {
    const { spikes, timesteps } = this.layer;
    const count = firstFrom(spikes.times, (step + 1) * timesteps) - firstFrom(spikes.times, step * timesteps);
    return `${count} spike${count === 1 ? "" : "s"}`;
  }

  draw(context, width, height, from, to, paint) {
    const { spikes, timesteps } = this.layer;
    const first = firstFrom(spikes.times, from * timesteps), last = firstFrom(spikes.times, to * timesteps);
    if (last - first > 20000) return this._density(context, width, height, from, to, paint, first, last);
    const tall = Math.max(1.2, height / spikes.neurons - 0.5);
    const wide = Math.max(1.2, width / ((to - from) * timesteps) - 0.5);
    context.fillStyle = paint.spike;
    context.globalAlpha = 0.9;
    for (let k = first; k < last; k++) {
      const x = (spikes.times[k] / timesteps - from) / (to - from) * width;
      context.fillRect(x, spikes.indices[k] / spikes.neurons * height, wide, tall);
    }
    context.globalAlpha = 1;
  }

  // too many to be drawn one by one: the share of neurons and timesteps of a pixel with a spike
  _density(context, width, height, from, to, paint, first, last) {
    const { spikes, timesteps } = this.layer;
    const columns = Math.max(1, Math.min(Math.round(width), Math.ceil((to - from) * timesteps)));
    const rows = Math.max(1, Math.min(Math.round(height), spikes.neurons));
    const counts = new Uint32Array(columns * rows);
    for (let k = first; k < last; k++) {
      const x = Math.floor((spikes.times[k] / timesteps - from) / (to - from) * columns);
      counts[Math.floor(spikes.indices[k] / spikes.neurons * rows) * columns + Math.min(columns - 1, Math.max(0, x))]++;
    }
    const most = Math.max(1, (to - from) * timesteps / columns) * (spikes.neurons / rows);
    const picture = new ImageData(columns, rows);
    counts.forEach((count, k) => { picture.data[4 * k + 3] = 255 * Math.min(1, (count / most) ** 0.6); });
    const sheet = new OffscreenCanvas(columns, rows), over = sheet.getContext("2d");
    over.putImageData(picture, 0, 0);
    over.globalCompositeOperation = "source-in";
    over.fillStyle = paint.spike;
    over.fillRect(0, 0, columns, rows);
    context.imageSmoothingEnabled = false;
    context.drawImage(sheet, 0, 0, width, height);
  }
}

class MapStrip {
  constructor(title, series, unit) {
    Object.assign(this, { title, series, unit, height: Math.min(120, Math.max(36, 7 * Math.min(series.width, 18))) });
    let most = 0;
    for (const value of series.values) most = Math.max(most, Math.abs(value));
    this.most = most || 1;
  }

  value(step) {
    const row = Math.min(step, this.series.rows - 1);
    const values = [...Array(this.series.width).keys()].map((column) => this.series.at(row, column));
    return `${short(Math.min(...values))} to ${short(Math.max(...values))}${this.unit && ` ${this.unit}`}`;
  }

  draw(context, width, height, from, to, paint) {
    const { series } = this, places = Math.max(1, Math.min(Math.round(width), Math.ceil(to - from)));
    const picture = new ImageData(places, series.width);
    for (let x = 0; x < places; x++) {
      const row = Math.min(series.rows - 1, Math.max(0, Math.floor(from + (x + 0.5) / places * (to - from))));
      for (let column = 0; column < series.width; column++) {
        const share = series.at(row, column) / this.most, k = 4 * (column * places + x);
        const colour = share < 0 ? paint.negative : paint.positive;
        picture.data.set([...colour, Math.round(255 * Math.min(1, Math.abs(share) ** 0.6))], k);
      }
    }
    const sheet = new OffscreenCanvas(places, series.width);
    sheet.getContext("2d").putImageData(picture, 0, 0);
    context.imageSmoothingEnabled = false;
    context.drawImage(sheet, 0, 0, width, height);
  }
}

function short(value) {
  const size = Math.abs(value);
  if (size >= 1000 || Math.abs(value - Math.round(value)) < 1e-4) return Math.round(value).toLocaleString("en");
  return value.toFixed(size >= 100 || value === 0 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3);
}

// seconds, or control steps where their time is not known, at round numbers
function drawAxis(context, width, height, from, to, period, paint) {
  const unit = period || 1, length = (to - from) * unit;
  const rough = length / Math.max(2, width / 110), size = 10 ** Math.floor(Math.log10(rough));
  const every = [1, 2, 5, 10].map((n) => n * size).find((n) => n >= rough);
  context.fillStyle = paint.soft;
  context.font = "11px system-ui, sans-serif";
  for (let at = Math.ceil(from * unit / every) * every; at <= to * unit; at += every) {
    const x = (at / unit - from) / (to - from) * width;
    const text = `${Number(at.toFixed(3))}${period ? " s" : ""}`;
    context.fillRect(x, 0, 1, 4);
    const wide = context.measureText(text).width;
    context.fillText(text, Math.min(width - wide, Math.max(0, x - wide / 2)), height - 3);
  }
}
