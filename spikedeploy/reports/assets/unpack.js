// Arrays that recordings/packed.py wrote.

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// {rows, width, at(row, column)} of numbers that were packed as differences along the rows
async function numbers(packed) {
  if (!packed) return null;
  const [rows, ...others] = packed.shape;
  const width = others.reduce((a, b) => a * b, 1);
  const bytes = await inflate(packed.data);
  const changes = new Int16Array(bytes.buffer, bytes.byteOffset, bytes.byteLength >> 1);
  const values = new Float32Array(rows * width);
  const level = new Int16Array(width);
  for (let row = 0, k = 0; row < rows; row++)
    for (let column = 0; column < width; column++, k++) {
      level[column] += changes[k];  // wraps around as the differences did
      values[k] = packed.low + packed.step * level[column];
    }
  return { rows, width, shape: packed.shape, values, at: (row, column = 0) => values[row * width + column] };
}

// {rows, neurons, times, indices}: the spikes of a raster in the order of time
async function spikes(packed) {
  const [rows, neurons] = packed.shape;
  const bits = await inflate(packed.data);
  const stride = Math.ceil(neurons / 8);
  const times = [], indices = [];
  for (let row = 0; row < rows; row++)
    for (let byte = 0; byte < stride; byte++)
      for (let rest = bits[row * stride + byte], bit = 0; rest; rest >>= 1, bit++)
        if (rest & 1) { times.push(row); indices.push(8 * byte + bit); }
  return { rows, neurons, times: Int32Array.from(times), indices: Int32Array.from(indices) };
}

// the first place in sorted `values` that is not below `wanted`
function firstFrom(values, wanted) {
  let low = 0, high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] < wanted) low = middle + 1; else high = middle;
  }
  return low;
}

async function unpackPlayer(player) {
  const found = { ...player };
  for (const name of ["poses", "reward", "actions"]) found[name] = await numbers(player[name]);
  found.tracks = [];
  for (const track of player.tracks)
    found.tracks.push({ ...track, values: await numbers(track.values), wanted: await numbers(track.wanted) });
  if (player.network) {
    const { layers, left_out, sops, energy } = player.network;
    found.network = { left_out, sops: await numbers(sops), energy: await numbers(energy), layers: [] };
    for (const layer of layers)
      found.network.layers.push({
        ...layer, spikes: await spikes(layer.spikes), membranes: await numbers(layer.membranes),
      });
  }
  return found;
}

async function unpackEpisode(episode) {
  const players = [];
  for (const player of episode.players) players.push(await unpackPlayer(player));
  const scene = episode.scene;
  const heights = scene && scene.ground && (await numbers(scene.ground.heights));
  for (const map of (scene && scene.maps) || []) map.spikes = map.spikes.data ? await spikes(map.spikes) : map.spikes;
  const film = scene && scene.pictures && (await Promise.all(scene.pictures.map(pictureOf)));
  return { ...episode, players, heights, film, distance: await numbers(episode.distance),
           steps: Math.max(...players.map((player) => player.steps)) };
}
