"""One episode of a policy, with everything that a page draws of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.rollout import EpisodeRecorder, Rollout
from spikedeploy.policies.nir import NirController
from spikedeploy.policies.registry import Candidate, Player, check_fit, open_policy
from spikedeploy.recordings.scenes import Floats, scene_of
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger, Rows
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.metrics.energy import energy, energy_table

_FPS = 25  # poses a second, nearest possible; between them the page interpolates
_PERIOD = 1 / 30  # [s] of a control step where an environment does not say


@dataclass(frozen=True)
class NetworkTrace:
    """A spiking network in S inferences of T timesteps.

    rasters    "input" and every spiking layer -> spikes (S, T, N); graded ones as they are
    membranes  layer -> (S, N) after the last timestep [state units]; empty in float
    sops       (S,) synaptic operations; None where they cannot be counted
    energy     (S,) [J] of operations and neuron updates by the table; likewise
    """

    rasters: Mapping[str, NDArray[Any]]
    membranes: Mapping[str, Floats]
    sops: Floats | None
    energy: Floats | None


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode of S control steps.

    label    of the policy, as in tables
    kind     of the candidate
    played   observations, actions, rewards
    shapes   of the scene; None where the environment shows nothing that can be drawn
    poses    (F, N, 7) or (F, 1, 3), see scenes, every `every` control steps
    period   of a control step [s]; None where it is not known
    network  of a policy that spikes
    """

    label: str
    kind: str
    played: Rollout
    shapes: Mapping[str, Any] | None
    poses: Floats
    every: int
    period: float | None
    network: NetworkTrace | None


def record(
    env: Any,  # noqa: ANN401
    candidate: Candidate,
    chip: str | None,
    label: str,
    seed: int,
    table: str,
) -> RecordedEpisode:
    """Play an episode in an environment.

    chip   or "float"; None for what does not spike
    table  of the energy
    """
    player = traced(candidate, chip, env, "each")
    tracer = _Tracer(player) if isinstance(player, NirController) else None
    period = getattr(env.unwrapped, "CONTROL_DT", None)
    every = max(1, round(1 / (_FPS * (period or _PERIOD))))
    episode, scene = EpisodeRecorder(env, seed), scene_of(env)
    player.reset(seed)
    shapes = scene.shapes() if scene else None
    poses = [scene.pose()] if scene else []
    while not episode.over:
        episode.step(player.act(episode.observation))
        if tracer:
            tracer.keep()
        if scene and (episode.steps % every == 0 or episode.over):
            poses.append(scene.pose())
    network = tracer.trace(table) if tracer else None
    found = np.stack(poses) if poses else np.zeros((0, 0, 0))
    return RecordedEpisode(
        label, candidate.kind, episode.rollout(), shapes, found, every, period, network
    )


def traced(
    candidate: Candidate,
    chip: str | None,
    env: Any,  # noqa: ANN401
    rows: Rows,
    sampled: bool = False,
) -> Player:
    """The player of a candidate; where it spikes, its network keeps those of the last step.

    rows  of its ledger
    """
    if candidate.format != ".nir":
        return open_policy(candidate, chip, env, sampled)
    check_fit(candidate, env)
    return NirController.open(candidate, chip, env, sampled, trace=True, rows=rows)


def spikes_of(player: NirController) -> dict[str, NDArray[Any]]:
    """Spikes (T, N) of the last inference, as a NetworkTrace names them."""
    spikes = {"input": player.controller.encoded, **player.controller.network.spikes}
    return {name: each[0].reshape(len(each[0]), -1) for name, each in spikes.items()}


def membranes_of(player: NirController) -> dict[str, Floats]:
    """Membranes (N,) after the last inference, likewise; empty in float."""
    if player.chip is None:
        return {}
    seen = player.controller.network.recordings
    last = {each.name: seen[each.name].membrane for each in player.program.spiking}
    return {name: np.array(each[0, -1], np.float64) for name, each in last.items()}


def ledger_of(player: NirController) -> Ledger | None:
    """Counts so far; None of a graph that no chip can hold, which runs in float, uncounted."""
    try:
        return player.controller.ledger
    except RuleError:
        return None


class _Tracer:
    """What a network did in each control step."""

    def __init__(self, player: NirController) -> None:
        self._player = player
        self._rasters: dict[str, list[NDArray[Any]]] = {}
        self._membranes: dict[str, list[Floats]] = {}

    def keep(self) -> None:
        """Keep the last inference."""
        for name, raster in spikes_of(self._player).items():
            self._rasters.setdefault(name, []).append(raster)
        for name, last in membranes_of(self._player).items():
            self._membranes.setdefault(name, []).append(last)

    def trace(self, table: str) -> NetworkTrace:
        """Everything that was kept."""
        ledger = ledger_of(self._player)
        sops, joules = (None, None) if ledger is None else costs_of_each(ledger, table)
        return NetworkTrace(
            {name: np.stack(rows) for name, rows in self._rasters.items()},
            {name: np.stack(rows) for name, rows in self._membranes.items()},
            sops,
            joules,
        )


def costs_of_each(ledger: Ledger, table: str) -> tuple[Floats, Floats]:
    """Synaptic operations (S,) and energy (S,) [J] of each inference of a ledger."""
    prices = energy_table(table)
    rows = (replace(ledger, counts=row[None], inferences=1) for row in ledger.counts)
    sops = ledger.counts[:, :, EVENTS.index("sop")].sum(axis=1).astype(np.float64)
    return sops, np.array([energy(row, prices) for row in rows])
