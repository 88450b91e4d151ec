"""Episodes for pages: what robot, network and chip did in each control step.

Control steps become JSON that scripts in reports/assets draw: arrays packed as text, the shapes and
poses of a scene or else a film of the environment's pictures, curves of the step infos, spikes,
membranes and costs. An episode of a comparison is played once more and recorded whole; `run
--watch` (spikedeploy.live) sends its steps while they are taken.
"""

import json
import math
import zlib
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spikedeploy import envs
from spikedeploy.comparison.comparison import Comparison
from spikedeploy.console import say
from spikedeploy.envs.kart.track import RADIUS
from spikedeploy.envs.rollout import EpisodeRecorder, Rollout
from spikedeploy.evaluation_setup import DEFAULT, Setup
from spikedeploy.policies.nir import NirController
from spikedeploy.policies.registry import Candidate, Controller, Entry, check_fit, open_policy
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.metrics.energy import energy, energy_table
from spikedeploy.video import Pace, shrink, webp

Floats = NDArray[np.float64]

_MOST_BYTES = 2_600_000  # of all episodes: a page of 3 MB opens at once and can be sent
_MOST_BITS = 4_000_000  # of a raster: larger ones are left out, by name
_MOST_MEMBRANES = 300_000  # numbers of a layer's membranes, likewise
_MOST_PICTURES = 150  # of a film
_MOST_FILM = 700_000  # [bytes] of it: two episodes of a page have one each
_WIDTH = 320  # [px] of its pictures


# the episodes of a comparison


def record_comparison(
    comparison: Comparison, main: int, options: Mapping[str, Any], table: str
) -> list[dict[str, Any]]:
    """The first episode of a row and its worst one, beside those of its references.

    main: index of the row, which is the last of each episode's players
    options: options of the environment
    table: energy table
    """
    row = comparison.rows[main]
    entries = [*reversed(row.entry.references), row.entry]
    first, worst = comparison.seeds[0], comparison.seeds[int(np.argmin(row.returns))]
    seeds = {first: "first episode"} | ({worst: "worst episode"} if worst != first else {})
    env = _env_to_show(comparison.env, options)
    episodes = [_episode(env, entries, seed, title, table) for seed, title in seeds.items()]
    env.close()
    while len(episodes) > 1 and len(json.dumps(episodes)) > _MOST_BYTES:
        episodes.pop()
    return episodes


def _episode(
    env: Any,  # noqa: ANN401
    entries: Sequence[Entry],
    seed: int,
    title: str,
    table: str,
) -> dict[str, Any]:
    played = [
        record(env, e.candidate, e.chip, e.label, seed, table, e is entries[-1], e.setup)
        for e in entries
    ]
    last = played[-1]
    twin, distance = next((each for each in played[:-1] if each.network is not None), None), None
    if twin is not None:
        # (S,) root mean square of the difference of their observations, until one ends
        steps = min(last.played.steps, twin.played.steps)
        apart = last.played.observation[:steps] - twin.played.observation[:steps]
        distance = pack(np.sqrt(np.mean(apart.reshape(steps, -1) ** 2, axis=1)))
    return {
        "title": title,
        "seed": seed,
        "period": last.period,
        "scene": last.shapes,
        "players": [_player(each, each is last) for each in played],
        "distance": distance,
        "twin": twin is not None,
        "first_spike": None if twin is None else first_difference(last, twin),
    }


def _player(each: "RecordedEpisode", has_network: bool) -> dict[str, Any]:
    """JSON of a player; spikes and membranes of the last one alone."""
    played = each.played
    return {
        "label": each.label,
        "kind": each.kind,
        "steps": played.steps,
        "total": played.total,
        "success": played.success,
        "ended": "terminal state" if played.terminated else "time limit",
        "every": each.every,
        **series_json(
            each.poses,
            played.reward,
            played.action,
            info_curves(played.info),
            network_json(each.network) if each.network and has_network else None,
        ),
    }


def series_json(
    poses: Floats | None,
    reward: ArrayLike,
    action: NDArray[Any],
    curves: Sequence[Mapping[str, Any]],
    network: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """JSON of what grows with S control steps: rewards (S,), actions (S, …), poses, curves."""
    return {
        "poses": None if poses is None else pack(poses),
        "reward": pack(reward),
        "actions": pack(action.reshape(len(action), -1)),
        "tracks": curves,
        "network": network,
    }


def first_difference(one: "RecordedEpisode", other: "RecordedEpisode") -> dict[str, Any] | None:
    """The first spike of a layer that only one of two networks has; None where there is none.

    Both start alike, so until then they observe the same.
    """
    if one.network is None or other.network is None:
        return None
    found = []
    for name, raster in one.network.rasters.items():
        twin = other.network.rasters.get(name, raster)
        steps = min(len(raster), len(twin))
        differs = np.argwhere((raster[:steps] != 0) != (twin[:steps] != 0))
        if len(differs):
            step, timestep, neuron = differs[0].tolist()
            found.append({"step": step, "timestep": timestep, "layer": name, "neuron": neuron})
    return min(found, key=lambda first: (first["step"], first["timestep"]), default=None)


# one episode


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode of S control steps.

    label: label of the policy, as in tables
    kind: kind of the candidate
    played: observations, actions, rewards
    shapes: shapes of the scene, or a film; None where the environment shows nothing
    poses: (F, N, 7) or (F, 1, 3), see Scene, every `every` control steps; None without a scene
    period: time of a control step [s]; None where it is not known
    network: network of a policy that spikes
    """

    label: str
    kind: str
    played: Rollout
    shapes: Mapping[str, Any] | None
    poses: Floats | None
    every: int
    period: float | None
    network: "NetworkTrace | None"


def record(
    env: Any,  # noqa: ANN401
    candidate: Candidate,
    chip: str | None,
    label: str,
    seed: int,
    table: str,
    filmed: bool = False,
    setup: Setup = DEFAULT,
) -> RecordedEpisode:
    """Play an episode in an environment.

    chip: or "float"; None for what does not spike
    table: energy table
    filmed: take pictures of an environment that no scene is known of
    """
    player = open_with_traces(candidate, chip, env, setup)
    period = getattr(env.unwrapped, "CONTROL_DT", None)
    every = Pace.for_period(period).every
    episode, scene = EpisodeRecorder(env, seed), scene_of(env)
    film = _Film(env, every) if filmed and scene is None else None
    player.reset(seed)
    tracer, steps = StepTracer(player, scene), []
    first = [scene.pose()] if scene else []
    if film:
        film.add(0)
    while not episode.over:
        episode.step(player.act(episode.observation))
        steps.append(tracer.take(episode))
        if film:
            film.add(episode.steps)
    kept = (*steps[every - 1 : -1 : every], steps[-1])
    due = [step.pose for step in kept if step.pose is not None]
    return RecordedEpisode(
        label,
        candidate.kind,
        episode.rollout(),
        film.shapes() if film else scene.shapes if scene else None,
        np.stack([*first, *due]) if scene else None,
        every,
        period,
        trace_network(steps, table),
    )


def _env_to_show(name: str, options: Mapping[str, Any]) -> Any:  # noqa: ANN401
    """The environment; one that renders where it can and no scene of it is known."""
    env: Any = envs.make(name, **options)
    if scene_of(env) is not None or "rgb_array" not in env.metadata.get("render_modes", ()):
        return env
    try:
        shown = envs.make(name, **options, render_mode="rgb_array")
    except Exception as error:  # other people's code: the page lacks a film, and nothing else
        _say_no_film(error)
        return env
    env.close()
    return shown


def _say_no_film(error: Exception) -> None:
    said = " ".join(f"{type(error).__name__}: {error}".split())
    say(f"the page has no film of the environment ({said})")


def open_with_traces(
    candidate: Candidate,
    chip: str | None,
    env: Any,  # noqa: ANN401
    setup: Setup = DEFAULT,
) -> Controller:
    """The controller of a candidate; where it spikes, its network keeps those of the last step."""
    if candidate.format != ".nir":
        return open_policy(candidate, chip, env, setup)
    check_fit(candidate, env)
    return NirController.open(candidate, chip, env, setup, trace=True)


# networks


@dataclass(frozen=True)
class NetworkTrace:
    """A spiking network in S inferences of T timesteps.

    rasters: "input" and every spiking layer -> spikes (S, T, N); graded ones as they are
    membranes: layer -> (S, N) after the last timestep [state units]; empty in float
    sops: (S,) synaptic operations; None where they cannot be counted
    energy: (S,) [J] of operations and neuron updates by the table; likewise
    """

    rasters: Mapping[str, NDArray[Any]]
    membranes: Mapping[str, Floats]
    sops: Floats | None
    energy: Floats | None


@dataclass(frozen=True)
class Step:
    """A control step that was taken.

    action: (act,) or ()
    reward: reward of the step
    info: numbers of the environment
    pose: pose of the scene after it; None without one
    spikes: of a policy that spikes: "input" and every spiking layer -> (T, N); graded ones as they
        are
    membranes: layer -> (N,) after the last timestep [state units]; empty in float
    ledger: ledger of this inference; None where it cannot be counted
    """

    action: NDArray[Any]
    reward: float
    info: Mapping[str, float]
    pose: Floats | None = None
    spikes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    membranes: Mapping[str, Floats] = field(default_factory=dict)
    ledger: Ledger | None = None


class StepTracer:
    """Takes the control steps of a traced player, of one episode.

    scene: scene of the environment; None without one
    """

    def __init__(self, player: Controller, scene: "Scene | None") -> None:
        self._network = player if isinstance(player, NirController) else None
        self._scene, self._counted = scene, self._ledger()

    def take(self, recorder: EpisodeRecorder) -> Step:
        """The latest control step of an episode."""
        before, self._counted = self._counted, self._ledger()
        return Step(
            recorder.action,
            recorder.reward,
            recorder.numbers,
            self._scene.pose() if self._scene else None,
            *(_last_inference(self._network) if self._network else ({}, {})),
            self._counted.since(before) if before and self._counted else None,
        )

    def _ledger(self) -> Ledger | None:
        """Counts so far; None of a graph that no chip can hold, which runs in float, uncounted."""
        try:
            return self._network.controller.ledger if self._network else None
        except RuleError:
            return None


def _last_inference(
    player: NirController,
) -> tuple[dict[str, NDArray[Any]], dict[str, Floats]]:
    """Spikes and membranes of the last inference of a traced player."""
    controller = player.controller
    spikes = {"input": controller.encoded, **controller.network.spikes}
    flat = {name: each[0].reshape(len(each[0]), -1) for name, each in spikes.items()}
    if player.chip is None:
        return flat, {}
    seen = controller.network.recordings
    names = [each.name for each in player.program.spiking]
    return flat, {n: np.array(seen[n].membrane[0, -1], np.float64) for n in names}


def trace_network(steps: Sequence[Step], table: str) -> NetworkTrace | None:
    """The network in consecutive control steps; None of a policy that does not spike.

    table: energy table
    """
    each = [step for step in steps if step.spikes]
    if not each:
        return None
    ledgers = [step.ledger for step in steps if step.ledger]
    sops, joules = _costs_of_each(ledgers, table) if ledgers else (None, None)
    return NetworkTrace(
        {name: np.stack([one.spikes[name] for one in each]) for name in each[0].spikes},
        {name: np.stack([one.membranes[name] for one in each]) for name in each[0].membranes},
        sops,
        joules,
    )


def _costs_of_each(ledgers: Sequence[Ledger], table: str) -> tuple[Floats, Floats]:
    """Synaptic operations (S,) and energy (S,) [J] of inferences, each with its ledger."""
    prices, sop = energy_table(table), EVENTS.index("sop")
    sops = np.array([each.counts[:, :, sop].sum() for each in ledgers], np.float64)
    return sops, np.array([energy(replace(each, inferences=1), prices) for each in ledgers])


def network_json(trace: NetworkTrace, most_neurons: float = math.inf) -> dict[str, Any]:
    """Spikes, membranes, operations and energy; what is too large is left out, by name.

    most_neurons: most neurons of a layer whose spikes are shown, twice as many as of one with
        membranes
    """
    layers, left_out = [], []
    for name, raster in trace.rasters.items():
        steps, timesteps, neurons = raster.shape
        if raster.size > _MOST_BITS or neurons > most_neurons:
            left_out.append(f"{name}: {neurons:,} neurons")
            continue
        membranes = trace.membranes.get(name)
        if membranes is None or membranes.size > _MOST_MEMBRANES or 2 * neurons > most_neurons:
            membranes = None
        layers.append(
            {
                "name": name,
                "timesteps": timesteps,
                "spikes": pack_bits(raster.reshape(steps * timesteps, neurons)),
                "count": int(np.count_nonzero(raster)),
                "membranes": None if membranes is None else pack(membranes),
            }
        )
    return {
        "layers": layers,
        "left_out": left_out,
        "sops": None if trace.sops is None else pack(trace.sops),
        "energy": None if trace.energy is None else pack(trace.energy),
    }


# curves of the step infos


# what an info of ours has -> the numbers that are drawn, and their units
_CURVES = {
    "slip": {"speed": "m/s", "heading": "rad", "lateral": "m", "slip": "m/s"},
    "gates": {"speed": "px/s", "progress": "of the track"},
}
_MOST_CURVES = 4  # of other people's environments


def info_curves(info: Mapping[str, Floats]) -> list[dict[str, Any]]:
    """Return curves of step infos: `title`, `unit`, `values` (S,) and `wanted` (S,) or None."""
    if "command_turn" in info:
        turn = info["command_turn"] - info["turn_error"]
        return [
            curve("speed", "m/s", info["speed"], info["command_speed"]),
            curve("turn rate", "rad/s", turn, info["command_turn"]),
        ]
    units = next((units for name, units in _CURVES.items() if name in info), None)
    if units is None:  # the first numbers of somebody else's infos that change
        changing = [name for name, values in info.items() if np.ptp(np.nan_to_num(values)) > 0]
        units = dict.fromkeys(changing[:_MOST_CURVES], "")
    return [curve(name, unit, info[name]) for name, unit in units.items() if name in info]


def curve(title: str, unit: str, values: Floats, wanted: Floats | None = None) -> dict[str, Any]:
    """A curve, and the one that it should follow."""
    return {
        "title": title if wanted is None else f"{title}, commanded in grey",
        "unit": unit,
        "values": pack(values),
        "wanted": None if wanted is None else pack(wanted),
    }


# scenes


# mujoco.mjtGeom that the page draws
_KINDS = {0: "plane", 1: "ground", 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder",
          6: "box"}  # fmt: skip
_GROUND = ("plane", "ground")
_COARSE = 0.1  # [m] spacing of the heights that are kept of rough ground
_DECOR = 2  # MuJoCo's visualiser hides geoms of higher groups


@dataclass(frozen=True)
class Scene:
    """Drawable parts of an environment.

    shapes: fixed parts of an episode, as JSON: `kind` and the shapes
    pose: returns the moving parts: (N, 7) positions and quaternions of bodies or (1, 3) x [px],
        y [px] and heading [rad] of a kart
    """

    shapes: Mapping[str, Any]
    pose: Callable[[], Floats]


def scene_of(env: Any) -> Scene | None:  # noqa: ANN401
    """The scene of an episode's environment; None of one that shows nothing that we know."""
    inner = env.unwrapped
    # of environments that wrap other people's
    inner = getattr(inner, "inner", inner).unwrapped
    body = getattr(inner, "robot", inner)  # of our hexapods; gymnasium's hold both themselves
    data: Any = getattr(body, "data", None)
    if hasattr(body, "model") and hasattr(data, "xquat"):
        # without the world, which is the first body
        return Scene(
            _body_shapes(body.model),
            lambda: np.concatenate([data.xpos[1:], data.xquat[1:]], axis=1),
        )
    if hasattr(inner, "track") and hasattr(inner, "pose"):
        # walls and gates [px]; y points down
        lines = {name: _round(getattr(inner.track, name), 1) for name in ("walls", "gates")}
        shapes = {"kind": "track", **lines, "radius": RADIUS}
        return Scene(shapes, lambda: np.array([inner.pose]))
    return None


def _body_shapes(model: Any) -> dict[str, Any]:  # noqa: ANN401
    """Geoms of a MuJoCo model in the frames of their bodies, and the heights of the ground."""
    colours = _colours(model)
    kinds = [_KINDS.get(int(kind), "") for kind in model.geom_type]
    seen = (colours[:, 3] > 0) & (model.geom_group <= _DECOR)
    shown = [g for g, kind in enumerate(kinds) if kind and seen[g]]
    return {
        "kind": "bodies",
        "geoms": [
            {
                "kind": kinds[g],
                "body": int(model.geom_bodyid[g]) - 1,
                "size": _round(model.geom_size[g]),
                "position": _round(model.geom_pos[g]),
                "quaternion": _round(model.geom_quat[g]),
                "colour": _round(colours[g, :3]),
            }
            for g in shown
            if kinds[g] not in _GROUND and model.geom_bodyid[g] > 0
        ],
        "ground": _ground(model, next((g for g in shown if kinds[g] in _GROUND), None)),
    }


def _colours(model: Any) -> Floats:  # noqa: ANN401
    """(G, 4) of the geoms: their own, or those of their materials."""
    colours = np.array(model.geom_rgba, np.float64)
    of = np.asarray(model.geom_matid)
    is_default = (of >= 0) & np.isclose(colours, [0.5, 0.5, 0.5, 1]).all(axis=1)
    colours[is_default] = model.mat_rgba[of[is_default]]
    return colours


def _ground(model: Any, geom: int | None) -> dict[str, Any] | None:  # noqa: ANN401
    """Height of a plane, or heights (rows along y, columns along x) of rough ground."""
    if geom is None:
        return None
    height, field = float(model.geom_pos[geom, 2]), int(model.geom_dataid[geom])
    if field < 0:
        return {"height": height}
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    x, y, top, _ = (float(each) for each in model.hfield_size[field])
    start = int(model.hfield_adr[field])
    heights = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    every = max(1, round(_COARSE * (columns - 1) / (2 * x)))
    kept = pack(height + top * heights[::every, ::every])
    return {"height": height, "half": [x, y], "heights": kept}


class _Film:
    """Pictures of an environment while an episode is played, `every` control steps."""

    def __init__(self, env: Any, every: int) -> None:  # noqa: ANN401
        self._env, self._every = env, every
        self._pictures: list[bytes] = []

    def add(self, step: int) -> None:
        """Take a picture, if one is due; of a long episode every other one is dropped again."""
        if step % self._every or (step and not self._pictures):
            return
        try:
            frame = self._env.render()
            if not _is_picture(frame):
                return
            self._pictures.append(webp(shrink(frame, _WIDTH)))
        except NotImplementedError:  # of gymnasium, where the environment defines no render
            return
        except Exception as error:  # other people's code
            _say_no_film(error)
            self._pictures = []
            return
        while len(self._pictures) > 1 and self._is_large():
            self._pictures, self._every = self._pictures[::2], 2 * self._every

    def _is_large(self) -> bool:
        return len(self._pictures) > _MOST_PICTURES or sum(map(len, self._pictures)) > _MOST_FILM

    def shapes(self) -> dict[str, Any] | None:
        """The pictures as text; None without any."""
        if not self._pictures:
            return None
        pictures = [b64encode(each).decode() for each in self._pictures]
        return {"kind": "film", "every": self._every, "pictures": pictures}


def _is_picture(frame: object) -> bool:
    """True of an array (H, W, 3) of uint8."""
    if not isinstance(frame, np.ndarray) or frame.dtype != np.uint8:
        return False
    return frame.ndim == 3 and frame.shape[2] == 3


def _round(values: Any, digits: int = 4) -> Any:  # noqa: ANN401
    return np.round(np.asarray(values, np.float64), digits).tolist()


# arrays as text


_LEVELS = 32_000  # of an array between its lowest and highest value


def pack(values: ArrayLike) -> dict[str, Any]:
    """Numbers (S, …) with 32,000 levels between lowest and highest, as differences along S.

    `shape`, `low` and `step` undo it: value = low + step * cumulative sum, NaN becomes 0.
    """
    array = np.nan_to_num(np.asarray(values, np.float64))
    low, high = (float(array.min()), float(array.max())) if array.size else (0.0, 0.0)
    step = (high - low) / _LEVELS or 1.0
    levels = np.rint((array - low) / step).astype(np.int16)
    changes = np.diff(levels, axis=0, prepend=np.zeros_like(levels[:1]))
    return {"shape": list(array.shape), "low": low, "step": step, "data": _as_text(changes)}


def pack_bits(spikes: NDArray[Any]) -> dict[str, Any]:
    """Spikes (R, N), each row from the lowest bit on: `shape` and `data`."""
    rows = spikes.reshape(len(spikes), -1) != 0
    bits = np.packbits(rows, axis=1, bitorder="little")
    return {"shape": list(rows.shape), "data": _as_text(bits)}


def _as_text(array: NDArray[Any]) -> str:
    """Little-endian, compressed, in base64."""
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return b64encode(zlib.compress(little.tobytes(), 9)).decode()
