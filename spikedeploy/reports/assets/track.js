// A track from above, with karts and where they drove.

class TrackView {
  constructor(episode) {
    this.episode = episode;
    const points = [...episode.scene.walls, ...episode.scene.gates].flat();
    const xs = points.map((p) => p[0]), ys = points.map((p) => p[1]);
    this.box = [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
    this.zoom = 1;
  }

  turn() {}

  draw(context, width, height, step, paint) {
    const [left, top, right, bottom] = this.box, { scene, players } = this.episode;
    const scale = Math.min((width - 32) / (right - left), (height - 32) / (bottom - top));
    context.fillStyle = paint.sky;
    context.fillRect(0, 0, width, height);
    context.save();
    context.translate(width / 2, height / 2);
    context.scale(scale, scale);
    context.translate(-(left + right) / 2, -(top + bottom) / 2);
    context.lineCap = "round";
    this._segments(context, scene.gates, paint.grid, 3);
    this._segments(context, scene.walls, paint.ink, 7);
    players.forEach((player, place) => this._trail(context, player, step, paint.players[place]));
    players.forEach((player, place) => this._kart(context, player, step, paint.players[place], scene.radius));
    context.restore();
  }

  _segments(context, segments, colour, width) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    for (const [[a, b], [c, d]] of segments) { context.moveTo(a, b); context.lineTo(c, d); }
    context.stroke();
  }

  _at(player, step) {
    const { poses, every } = player;
    const place = Math.min(step / every, poses.rows - 1);
    const before = Math.floor(place), after = Math.min(before + 1, poses.rows - 1);
    return [0, 1, 2].map((k) => poses.at(before, k) + (place - before) * (poses.at(after, k) - poses.at(before, k)));
  }

  _trail(context, player, step, colour) {
    const last = Math.min(Math.floor(step / player.every), player.poses.rows - 1);
    context.strokeStyle = colour;
    context.globalAlpha = 0.5;
    context.lineWidth = 5;
    context.beginPath();
    for (let row = 0; row <= last; row++) {
      const point = [player.poses.at(row, 0), player.poses.at(row, 1)];
      if (row) context.lineTo(...point); else context.moveTo(...point);
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  _kart(context, player, step, colour, radius) {
    const [x, y, heading] = this._at(player, step);
    const last = player === this.episode.players.at(-1);
    context.save();
    context.translate(x, y);
    context.rotate(heading);
    context.globalAlpha = last ? 1 : 0.5;
    context.fillStyle = colour;
    context.beginPath();
    context.roundRect(-radius, -0.68 * radius, 2 * radius, 1.36 * radius, 0.45 * radius);
    context.fill();
    context.fillStyle = "#fffc";
    context.fillRect(0.35 * radius, -0.42 * radius, 0.3 * radius, 0.84 * radius);
    context.restore();
  }
}
