"""A spiking policy that drives, and what its network did in the last control steps."""

import time
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.play.spike_panel import WINDOW
from spikedeploy.play.spike_recorder import Floats, InferenceTrace
from spikedeploy.policies.costs import priced_by
from spikedeploy.policies.nir import NirController
from spikedeploy.policies.registry import Player
from spikedeploy.recordings.episode import costs_of_each, ledger_of, spikes_of
from spikedeploy.reports.columns import quoted_among

MEAN = 30  # control steps of which costs are the mean


class DrivingNetwork(Player):
    """A Player whose network can be looked at.

    table    of the energy
    seconds  time of the last action [s]
    """

    def __init__(self, player: NirController) -> None:
        self._player = player
        self.table = quoted_among(priced_by(player.chip))
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self._player.reset(seed)
        self._seen: deque[tuple[dict[str, NDArray[Any]], Floats]] = deque(maxlen=WINDOW)
        self._costs: deque[tuple[float, float]] = deque(maxlen=MEAN)
        self._before, self.seconds = ledger_of(self._player), 0.0

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action, timed."""
        begin = time.perf_counter()
        action = self._player.act(observation)
        self.seconds = time.perf_counter() - begin
        self._keep()
        return action

    def replay(self, observations: Floats) -> NDArray[Any]:
        """Actions for the observations of an episode."""
        return self._player.replay(observations)

    @property
    def trace(self) -> InferenceTrace | None:
        """The last control steps; None before the first."""
        if not self._seen:
            return None
        spikes, scores = zip(*self._seen, strict=True)
        return InferenceTrace(
            {name: np.stack([each[name] for each in spikes]) for name in spikes[0]},
            np.stack(scores),
        )

    @property
    def sops(self) -> float | None:
        """Synaptic operations of a control step, mean of the last ones; None if not counted."""
        return _mean(sops for sops, _ in self._costs)

    @property
    def joules(self) -> float | None:
        """Energy of a control step [J], likewise."""
        return _mean(joules for _, joules in self._costs)

    def _keep(self) -> None:
        controller, spikes = self._player.controller, spikes_of(self._player)
        shown = {name: (each != 0).astype(np.uint8) for name, each in spikes.items()}
        self._seen.append((shown, controller.codec.scores(controller.output)[0]))
        before, self._before = self._before, ledger_of(self._player)
        if before is not None and self._before is not None:
            sops, joules = costs_of_each(self._before.since(before), self.table)
            self._costs.append((float(sops[0]), float(joules[0])))


def _mean(values: Iterable[float]) -> float | None:
    found = list(values)
    return sum(found) / len(found) if found else None
