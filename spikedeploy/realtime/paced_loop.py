"""Episodes at a fixed rate, and how long each control step took.

A control step begins with its period. The loop wakes, the policy acts on the latest observation,
and the environment takes its step. Times of a step:

late        from the beginning of the period until the loop woke: the jitter
policy      from an observation to its action, by the wall clock: the runtime's own work
policy_cpu  what the loop's thread computed of it: less than `policy` where it waited for a core
step        from the beginning of the period until the environment had stepped
"""

import itertools
import time
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.rollout import EpisodeRecorder, Rollout
from spikedeploy.policies.interface import Candidate, Player
from spikedeploy.policies.registry import open_policy
from spikedeploy.realtime.pacing import Metronome, Pacing, without_collections

TIMES = ("late", "policy", "policy_cpu", "step")
_PERCENTILES = (50, 95, 99)


@dataclass(frozen=True)
class RealTime:
    """What a paced loop measured.

    pacing   that it had
    seconds  it took, pauses between episodes left out
    times    name of TIMES -> [s] of each control step
    skipped  periods that passed while a step was not done
    """

    pacing: Pacing
    seconds: float
    times: Mapping[str, NDArray[np.float64]]
    skipped: int

    def missed(self, name: str) -> int:
        """Control steps of which this took longer than the deadline."""
        return int(np.count_nonzero(self.times[name] > self.pacing.deadline))

    def percentiles(self, name: str) -> dict[str, float]:
        """The 50th, 95th and 99th percentile and the largest, as p50, p95, p99 and max [s]."""
        found = np.percentile(self.times[name], _PERCENTILES).tolist()
        named = {f"p{p}": value for p, value in zip(_PERCENTILES, found, strict=True)}
        return {**named, "max": float(self.times[name].max())}

    def as_json(self) -> dict[str, Any]:
        """All of it but the single steps; times in seconds."""
        return {
            "rate_hz": self.pacing.rate,
            "deadline_s": self.pacing.deadline,
            "steps": len(self.times["step"]),
            "seconds": self.seconds,
            "missed": {name: self.missed(name) for name in ("policy", "policy_cpu", "step")},
            "skipped_periods": self.skipped,
            "times_s": {name: self.percentiles(name) for name in TIMES},
        }


class PacedLoop:
    """Plays episodes at a rate; the times of all of them are kept."""

    def __init__(self, pacing: Pacing) -> None:
        self._pace(pacing)
        self._times = {name: array("d") for name in TIMES}
        self._seconds = 0.0

    def open(
        self,
        candidate: Candidate,
        chip: str | None,
        env: gymnasium.Env[Any, Any],
        sampled: bool,
    ) -> Player:
        """The policy that it plays; arguments as of registry.open_policy."""
        return open_policy(candidate, chip, env, sampled)

    def seeds(self, given: Sequence[int]) -> Iterable[int]:
        """The seeds to play: those given, or from the first on for as long as was asked."""
        return given if self._pacing.duration is None else self._seeds_from(given[0])

    def _seeds_from(self, first: int) -> Iterator[int]:
        for seed in itertools.count(first):
            if self._seconds >= (self._pacing.duration or 0.0):
                return
            yield seed

    def rollout(self, env: gymnasium.Env[Any, Any], player: Player, seed: int) -> Rollout:
        """One episode, a control step in each period."""
        recorder = EpisodeRecorder(env, seed)
        player.reset(seed)
        if not self._seconds:  # the first inference takes its memory, and may compile
            player.act(recorder.observation)
            player.reset(seed)
        self._begun(recorder, env, player, seed)
        with without_collections():
            self._metronome.start()
            begin = time.perf_counter()
            while not recorder.over:
                self._step(recorder, player)
            self._seconds += time.perf_counter() - begin
        return recorder.rollout()

    def measured(self) -> RealTime:
        """The times so far."""
        times = {name: np.array(values) for name, values in self._times.items()}
        return RealTime(self._pacing, self._seconds, times, self._metronome.skipped)

    # What a loop adds that shows its episodes.

    def _begun(
        self, recorder: EpisodeRecorder, env: gymnasium.Env[Any, Any], player: Player, seed: int
    ) -> None:
        """An episode begins."""

    def _stepped(self, recorder: EpisodeRecorder, player: Player, times: Sequence[float]) -> None:
        """A control step was taken; times as TIMES names them."""

    def _pace(self, pacing: Pacing) -> None:
        self._pacing, self._metronome = pacing, Metronome(pacing.period)

    def _step(self, recorder: EpisodeRecorder, player: Player) -> None:
        woke = self._metronome.wait()
        computed = time.thread_time()
        action = player.act(recorder.observation)
        acted, computed = time.perf_counter(), time.thread_time() - computed
        recorder.step(action)
        stepped, due = time.perf_counter(), self._metronome.due
        times = (woke - due, acted - woke, computed, stepped - due)
        for name, value in zip(TIMES, times, strict=True):
            self._times[name].append(value)
        self._stepped(recorder, player, times)
