// Pictures of the input and of every layer, side by side: the neurons that spiked in a span.

class MapsView {
  constructor(episode) {
    this.episode = episode;
    this.zoom = 1;
    this.tiles = episode.scene.maps.map((map) => {
      const [channels, rows, columns] = map.shape, isInput = map === episode.scene.maps[0];
      // both polarities of the input in one tile, channels of a layer in a grid of tiles
      const shown = isInput ? 1 : channels;
      const across = Math.max(1, Math.min(shown, Math.ceil(Math.sqrt(shown * rows / columns))));
      const down = Math.ceil(shown / across), gap = shown > 1 ? 1 : 0;
      return { ...map, isInput, across, down, gap, wide: across * (columns + gap) - gap, high: down * (rows + gap) - gap };
    });
  }

  turn() {}

  // tiles in rows, each as large as fits; heads above them
  _place(width, height) {
    const head = 16, space = 12;
    const attempt = (side) => {
      let x = 0, y = 0, tall = 0;
      const places = [];
      for (const tile of this.tiles) {
        const scale = Math.min(side / tile.high, 2.2 * side / tile.wide, width / tile.wide, 24);
        const wide = tile.wide * scale, high = tile.high * scale, taken = Math.max(wide, 92);
        if (x && x + taken > width) { x = 0; y += tall + space; tall = 0; }
        places.push({ tile, scale, x, y: y + head, wide, high });
        x += taken + space;
        tall = Math.max(tall, high + head);
      }
      return { places, bottom: y + tall };
    };
    let low = 8, high = Math.max(width, height);
    for (let k = 0; k < 20; k++) {
      const middle = (low + high) / 2;
      if (attempt(middle).bottom <= height) low = middle; else high = middle;
    }
    return attempt(low).places;
  }

  draw(context, width, height, step, paint) {
    context.fillStyle = paint.sky;
    context.fillRect(0, 0, width, height);
    context.save();
    context.translate(10, 8);
    const picture = Math.floor(step / this.episode.scene.every);
    context.font = "12px system-ui, sans-serif";
    for (const { tile, scale, x, y, wide, high } of this._place(width - 20, height - 16)) {
      context.fillStyle = paint.soft;
      context.fillText(`${tile.name} ${tile.size}`, x, y - 5, Math.max(wide, 92));
      context.imageSmoothingEnabled = false;
      context.drawImage(this._sheet(tile, picture, paint), x, y, wide, high);
      context.strokeStyle = paint.line;
      context.strokeRect(x - 0.5, y - 0.5, wide + 1, high + 1);
    }
    context.restore();
  }

  _sheet(tile, picture, paint) {
    const [channels, rows, columns] = tile.shape, { across, gap, wide, high, spikes } = tile;
    const sheet = new OffscreenCanvas(wide, high), context = sheet.getContext("2d");
    context.fillStyle = paint.line;  // between the channels
    context.fillRect(0, 0, wide, high);
    context.fillStyle = paint.card;
    for (let k = 0; k < (tile.isInput ? 1 : channels); k++)
      context.fillRect((k % across) * (columns + gap), Math.floor(k / across) * (rows + gap), columns, rows);
    const first = firstFrom(spikes.times, picture), last = firstFrom(spikes.times, picture + 1);
    for (let k = first; k < last; k++) {
      const neuron = spikes.indices[k], channel = Math.floor(neuron / (rows * columns));
      const place = tile.isInput ? 0 : channel, x = neuron % columns, y = Math.floor(neuron / columns) % rows;
      context.fillStyle = !tile.isInput ? paint.spike : channels === 1 || channel !== Number(this.episode.scene.on_first) ? paint.series[0] : paint.series[1];
      context.fillRect((place % across) * (columns + gap) + x, Math.floor(place / across) * (rows + gap) + y, 1, 1);
    }
    return sheet;
  }
}
