"""What a spiking policy does, spike by spike, while it sees what a driver saw."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.ghosts import Ghost
from spikedeploy.policies.policies import Candidate
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.codec.xorshift import Xorshift
from spikedeploy.runtime.emulator.network import chip_called, running
from spikedeploy.runtime.errors import ConfigError

Floats = NDArray[np.float64]
RADIUS = 19.2  # of a kart [px]


@dataclass(frozen=True)
class InferenceTrace:
    """S inferences of T timesteps each.

    rasters  "input" and every spiking layer -> (S, T, N) uint8
    scores   (S, act) mean readout, before an action is made of it
    """

    rasters: Mapping[str, NDArray[np.uint8]]
    scores: Floats


class SpikeRecorder:
    """A spiking policy that can be watched.

    name  for people
    """

    def __init__(self, candidate: Candidate, chip: str) -> None:
        if candidate.format != ".nir":
            raise ConfigError(
                f"{candidate.path} shows no spikes: give a .nir file, which `export` writes"
            )
        self.name = f"{candidate.name} on {chip}"
        artifact = load(candidate.path)
        if artifact.codec is None:
            raise ConfigError(f"{candidate.path} has no codec, so observations become no spikes")
        self._codec = artifact.codec
        self._network = running(artifact, chip_called(chip), "none", trace=True)

    def think(self, observations: Floats, seed: int) -> InferenceTrace:
        """One inference for each observation (S, obs), in their order."""
        self._network.reset()
        rng = Xorshift(max(seed, 0), self._codec.encoder.width)
        rasters: dict[str, list[NDArray[np.uint8]]] = {}
        scores = []
        for observation in observations:
            spikes = self._codec.encode(observation[None], rng)
            scores.append(self._codec.scores(self._network.infer(spikes))[0])
            for name, raster in {"input": spikes, **self._network.spikes}.items():
                rasters.setdefault(name, []).append(raster[0])
        return InferenceTrace(
            {name: np.stack(rows) for name, rows in rasters.items()}, np.stack(scores)
        )


def seen_by(ghost: Ghost, world: Any) -> Floats:  # noqa: ANN401
    """What a world would have shown a ghost at each of its poses (S + 1, obs)."""
    pose = ghost.pose.astype(np.float64)
    turn = _turn(pose[:, 2]) / world.CONTROL_DT
    if "forward" in world.ACTIONS:  # what it is told, it does and shows a step before it moves
        turn = np.append(turn[1:], 0.0)
    velocity = ghost.speed[:, None] * _direction(pose, not world.TURNS)
    gates = gates_passed(pose[:, :2], world.track.gates)
    return np.stack(
        [
            world.observe_at(*pose[k], velocity[k], float(turn[k]), int(gates[k]))
            for k in range(len(pose))
        ]
    )


def gates_passed(path: Floats, gates: Floats) -> NDArray[np.int64]:
    """Gates that a kart has touched in their order at each point of its path (S + 1,)."""
    passed = np.zeros(len(path), np.int64)
    start = 0
    for number, (a, b) in enumerate(gates, 1):
        touches = np.flatnonzero(_distance(path[start:], a, b) <= RADIUS)
        if not len(touches):
            break
        start += int(touches[0])
        passed[start:] = number
    return passed


def _distance(points: Floats, a: Floats, b: Floats) -> Floats:
    """Of points (n, 2) from a segment (n,)."""
    along = b - a
    share = np.clip((points - a) @ along / (along @ along), 0.0, 1.0)
    found: Floats = np.hypot(*(points - a - share[:, None] * along).T)
    return found


def _turn(heading: Floats) -> Floats:
    """By how much the heading changed in the step before (S + 1,) [rad]."""
    change = np.diff(heading, prepend=heading[:1])
    found: Floats = (change + np.pi) % (2 * np.pi) - np.pi
    return found


def _direction(pose: Floats, pushed: bool) -> Floats:
    """Where a kart went (S + 1, 2): along its heading, or along its path if it has none."""
    if not pushed:
        return np.stack((np.cos(pose[:, 2]), np.sin(pose[:, 2])), axis=1)
    moved = np.diff(pose[:, :2], axis=0, prepend=pose[:1, :2])
    found: Floats = moved / np.maximum(np.hypot(*moved.T), 1e-9)[:, None]
    return found
