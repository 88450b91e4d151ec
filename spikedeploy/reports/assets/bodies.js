// Bodies of MuJoCo in perspective on a 2D canvas: capsules and spheres as thick strokes, boxes by
// their faces, sorted by depth. Ghosts of other policies are drawn translucent.

const LIGHT = [-0.45, 0.35, 0.82];

function rotated([w, x, y, z], [a, b, c]) {
  const s = 2 * (y * c - z * b), t = 2 * (z * a - x * c), u = 2 * (x * b - y * a);
  return [a + w * s + y * u - z * t, b + w * t + z * s - x * u, c + w * u + x * t - y * s];
}

function times([w, x, y, z], [a, b, c, d]) {
  return [w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
          w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a];
}

const plus = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

// position and quaternion of each body of a player at a control step, between two poses
function bodiesAt(player, step) {
  const { poses, every } = player;
  const place = Math.min(step / every, poses.rows - 1);
  const before = Math.floor(place), after = Math.min(before + 1, poses.rows - 1), share = place - before;
  const found = [];
  for (let body = 0; body < poses.shape[1]; body++) {
    const mix = [];
    const sign = [3, 4, 5, 6].reduce((sum, k) => sum + poses.at(before, 7 * body + k) * poses.at(after, 7 * body + k), 0) < 0 ? -1 : 1;
    for (let k = 0; k < 7; k++) {
      const one = poses.at(before, 7 * body + k), other = poses.at(after, 7 * body + k) * (k > 2 ? sign : 1);
      mix.push(one + share * (other - one));
    }
    const length = Math.hypot(mix[3], mix[4], mix[5], mix[6]) || 1;
    found.push({ position: mix.slice(0, 3), quaternion: mix.slice(3).map((q) => q / length) });
  }
  return found;
}

class BodiesView {
  constructor(episode) {
    this.episode = episode;
    this.yaw = -0.95; this.pitch = 0.42; this.zoom = 1;
    const first = bodiesAt(episode.players.at(-1), 0).map((body) => body.position);
    const root = first[0];
    this.radius = Math.max(0.1, ...first.map((p) => Math.hypot(p[0] - root[0], p[1] - root[1], p[2] - root[2])))
      + Math.max(...episode.scene.geoms.map((geom) => geom.size[0]));
    this.spacing = 2 ** Math.round(Math.log2(this.radius / 1.5));
  }

  turn(dx, dy) {
    this.yaw -= dx / 160;
    this.pitch = Math.min(1.45, Math.max(0.05, this.pitch + dy / 160));
  }

  draw(context, width, height, step, paint) {
    const { episode } = this;
    const main = bodiesAt(episode.players.at(-1), step);
    this.own = shares(paint.players.at(-1));
    this._aim(main[0].position, width, height);
    context.fillStyle = paint.sky;
    context.fillRect(0, 0, width, height);
    if (episode.scene.ground) this._ground(context, paint);
    episode.players.forEach((player, place) => this._trail(context, player, step, paint.players[place]));
    const things = [];
    episode.players.forEach((player, place) => {
      const solid = place === episode.players.length - 1;
      const bodies = solid ? main : bodiesAt(player, step);
      this._things(bodies, solid ? null : paint.players[place], things);
    });
    if (episode.scene.ground) for (const thing of things) if (!thing.ghost) this._shadow(context, thing, paint);
    things.sort((a, b) => b.depth - a.depth);
    for (const thing of things) thing.draw(context);
    context.globalAlpha = 1;
  }

  _aim(target, width, height) {
    const far = 3.5 * this.radius / this.zoom * Math.max(1, 0.8 * height / width + 0.35);
    const level = Math.cos(this.pitch);
    this.back = [-level * Math.cos(this.yaw), -level * Math.sin(this.yaw), Math.sin(this.pitch)];
    this.eye = plus(target, this.back.map((x) => x * far));
    this.right = [-Math.sin(this.yaw), Math.cos(this.yaw), 0].map((x) => -x);
    const b = this.back, r = this.right;
    this.up = [b[1] * r[2] - b[2] * r[1], b[2] * r[0] - b[0] * r[2], b[0] * r[1] - b[1] * r[0]];
    this.target = target;
    this.focal = 0.95 * Math.min(width * 1.25, height * 1.6);
    this.middle = [width / 2, height * 0.55];
  }

  _see(point) {
    const from = [point[0] - this.eye[0], point[1] - this.eye[1], point[2] - this.eye[2]];
    const depth = -dot(from, this.back);
    const scale = this.focal / Math.max(depth, 0.05);
    return { x: this.middle[0] + scale * dot(from, this.right), y: this.middle[1] - scale * dot(from, this.up), depth, scale };
  }

  _height(x, y) {
    const { ground } = this.episode.scene, { heights } = this.episode;
    if (!heights) return ground.height;
    const [rows, columns] = heights.shape;
    const column = Math.round((x / ground.half[0] + 1) / 2 * (columns - 1));
    const row = Math.round((y / ground.half[1] + 1) / 2 * (rows - 1));
    return heights.at(Math.min(rows - 1, Math.max(0, row)), Math.min(columns - 1, Math.max(0, column)));
  }

  _ground(context, paint) {
    const step = this.spacing, reach = 9;
    const [i, j] = this.target.slice(0, 2).map((x) => Math.round(x / step));
    context.strokeStyle = paint.grid;
    context.lineWidth = 1;
    for (let a = -reach; a <= reach; a++)
      for (const along of [0, 1]) {
        for (let b = -2 * reach; b < 2 * reach; b++) {
          const ends = [b, b + 1].map((c) => {
            const x = (i + (along ? c / 2 : a)) * step, y = (j + (along ? a : c / 2)) * step;
            return this._see([x, y, this._height(x, y)]);
          });
          if (ends[0].depth < 0.1 || ends[1].depth < 0.1) continue;
          context.globalAlpha = Math.max(0, 1 - Math.hypot(a, b / 2) / reach);
          context.beginPath();
          context.moveTo(ends[0].x, ends[0].y);
          context.lineTo(ends[1].x, ends[1].y);
          context.stroke();
        }
      }
    context.globalAlpha = 1;
  }

  _trail(context, player, step, colour) {
    if (!this.episode.scene.ground) return;
    const last = Math.min(Math.floor(step / player.every), player.poses.rows - 1);
    context.strokeStyle = colour;
    context.globalAlpha = 0.55;
    context.lineWidth = 2;
    context.beginPath();
    for (let row = Math.max(0, last - 250), begun = false; row <= last; row += 2) {
      const x = player.poses.at(row, 0), y = player.poses.at(row, 1);
      const seen = this._see([x, y, this._height(x, y)]);
      if (seen.depth < 0.1) { begun = false; continue; }
      if (begun) context.lineTo(seen.x, seen.y); else context.moveTo(seen.x, seen.y);
      begun = true;
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  _things(bodies, ghost, things) {
    for (const geom of this.episode.scene.geoms) {
      const body = bodies[geom.body];
      const position = plus(body.position, rotated(body.quaternion, geom.position));
      const turned = times(body.quaternion, geom.quaternion);
      const make = geom.kind === "box" ? this._box : this._rod;
      make.call(this, geom, position, turned, ghost, things);
    }
  }

  _rod(geom, position, turned, ghost, things) {
    const round = geom.kind === "sphere" || geom.kind === "ellipsoid";
    const half = round ? 0 : geom.size[1];
    const radius = geom.kind === "ellipsoid" ? (geom.size[0] + geom.size[1] + geom.size[2]) / 3 : geom.size[0];
    const axis = rotated(turned, [0, 0, half]);
    const ends = [plus(position, axis), plus(position, axis.map((x) => -x))];
    const [a, b] = ends.map((end) => this._see(end));
    if (a.depth < 0.1 || b.depth < 0.1) return;
    const flat = geom.kind === "cylinder", width = radius * (a.scale + b.scale);
    const stroke = (context, shift, share, colour) => {
      context.strokeStyle = colour;
      context.lineWidth = width * share;
      context.lineCap = flat ? "butt" : "round";
      context.beginPath();
      context.moveTo(a.x + shift * width, a.y - shift * width);
      context.lineTo(b.x + shift * width + 0.01, b.y - shift * width);
      context.stroke();
    };
    things.push({
      depth: (a.depth + b.depth) / 2 - radius, ghost, ends, radius,
      draw: (context) => {
        context.globalAlpha = ghost ? 0.28 : 1;
        stroke(context, 0, 1, ghost || shade(this._colour(geom), 0.72));
        if (!ghost) stroke(context, 0.1, 0.55, shade(this._colour(geom), 1.05));
      },
    });
  }

  _box(geom, position, turned, ghost, things) {
    const axes = [0, 1, 2].map((k) => rotated(turned, [0, 1, 2].map((n) => (n === k ? geom.size[k] : 0))));
    for (let k = 0; k < 3; k++)
      for (const sign of [1, -1]) {
        const normal = axes[k].map((x) => (x * sign) / (geom.size[k] || 1));
        const centre = plus(position, axes[k].map((x) => x * sign));
        const towards = [this.eye[0] - centre[0], this.eye[1] - centre[1], this.eye[2] - centre[2]];
        if (dot(normal, towards) <= 0) continue;
        const [u, v] = [axes[(k + 1) % 3], axes[(k + 2) % 3]];
        const corners = [[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([p, q]) =>
          this._see([0, 1, 2].map((n) => centre[n] + p * u[n] + q * v[n])));
        if (corners.some((corner) => corner.depth < 0.1)) continue;
        const colour = ghost || shade(this._colour(geom), 0.62 + 0.5 * Math.max(0, dot(normal, LIGHT)));
        things.push({
          depth: this._see(centre).depth, ghost, ends: [centre], radius: Math.min(...geom.size),
          draw: (context) => {
            context.globalAlpha = ghost ? 0.22 : 1;
            context.fillStyle = context.strokeStyle = colour;
            context.lineWidth = 1;
            context.beginPath();
            corners.forEach((corner, n) => (n ? context.lineTo(corner.x, corner.y) : context.moveTo(corner.x, corner.y)));
            context.closePath();
            context.fill();
            if (!ghost) context.stroke();
          },
        });
      }
  }

  // that of the policy in the list, where the model has any colour: darker where the model is darker
  _colour({ colour }) {
    const most = Math.max(...colour);
    return most - Math.min(...colour) < 0.1 ? colour : this.own.map((share) => share * (0.6 + 0.4 * most));
  }

  _shadow(context, thing, paint) {
    const on = thing.ends.map((end) => {
      const height = this._height(end[0], end[1]), above = Math.max(0, end[2] - height);
      return this._see([end[0] + 0.4 * above, end[1] - 0.3 * above, height]);
    });
    context.strokeStyle = paint.shadow;  // opaque: overlaps must not add up
    context.lineCap = "round";
    context.lineWidth = 1.5 * thing.radius * on[0].scale;
    context.beginPath();
    context.moveTo(on[0].x, on[0].y);
    context.lineTo((on[1] || on[0]).x + 0.01, (on[1] || on[0]).y);
    context.stroke();
  }
}

// red, green and blue of #rrggbb
function shares(hex) {
  return [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);
}

function shade(colour, light) {
  return `rgb(${colour.map((share) => Math.round(255 * Math.min(1, 0.06 + share * light))).join(" ")})`;
}
