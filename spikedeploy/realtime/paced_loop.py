"""Episodes at a fixed rate, and how long each control step took.

A control step begins with its period. The loop wakes, the policy acts on the latest observation,
and the environment takes its step. Times of a step:

late        from the beginning of the period until the loop woke: the jitter
policy      from an observation to its action, by the wall clock: the runtime's own work
policy_cpu  CPU time of the loop's thread in it: less than `policy` where it waited for a core
step        from the beginning of the period until the environment had stepped
"""

import gc
import itertools
import math
import re
import time
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.rollout import EpisodeRecorder, Rollout, rollout
from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies.registry import Candidate, Controller, Env, open_policy
from spikedeploy.runtime.errors import ConfigError

_UNITS = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0}
_LOWEST, _HIGHEST = 0.01, 10_000.0  # [Hz]
_LONGEST = 86_400.0  # [s]
# before the period: sleeping is late by less than this on Linux, and the rest is waited in a loop
_SPIN = 0.0003  # [s]


def duration(option: str, text: str) -> float:
    """Seconds of a text such as "20ms"."""
    found = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*([a-zµ]+)\s*", text)
    if found is None or found[2] not in _UNITS:
        raise ConfigError(
            f"{option} {text[:40]!r} is no time: write a number and its unit, "
            f"{', '.join(_UNITS)}, as in 20ms."
        )
    seconds = float(found[1]) * _UNITS[found[2]]
    if not 0 < seconds <= _LONGEST:
        raise ConfigError(f"{option} {text[:40]}: it must be above 0, and at most a day.")
    return seconds


@dataclass(frozen=True)
class Pacing:
    """A rate to keep.

    rate: control steps per second [Hz]
    deadline: [s] of a control step; it may be longer than the period
    duration: [s] after which no further episode begins; None for as many episodes as were asked for
    """

    rate: float
    deadline: float
    duration: float | None = None

    @property
    def period(self) -> float:
        """Time of a control step [s]."""
        return 1 / self.rate


def pacing(rate: float | None, deadline: str | None, lasting: str | None) -> Pacing | None:
    """Pacing by `--rate` [Hz], `--deadline` and `--duration`; None without a rate."""
    if rate is None:
        for option, given in (("--deadline", deadline), ("--duration", lasting)):
            if given is not None:
                raise ConfigError(f"{option} goes with --rate, which paces the loop by the clock.")
        return None
    if not (math.isfinite(rate) and _LOWEST <= rate <= _HIGHEST):
        raise ConfigError(f"--rate {rate:g}: it must be from {_LOWEST:g} to {_HIGHEST:,.0f} Hz.")
    return Pacing(
        rate,
        1 / rate if deadline is None else duration("--deadline", deadline),
        None if lasting is None else duration("--duration", lasting),
    )


class Metronome:
    """Periods of a fixed length, from the first that is waited for.

    due: when the current period began [s], on the clock of time.perf_counter
    skipped: periods that had passed before they were waited for
    """

    def __init__(self, period: float) -> None:
        self.due, self.skipped = 0.0, 0
        self._period = period

    def start(self) -> None:
        """Begin anew: the next period begins now."""
        self.due = time.perf_counter() - self._period

    def wait(self) -> float:
        """Wait for the next period and return its time; those that have passed whole are skipped.

        They are not caught up with, as the sensor readings of a robot are gone, too.
        """
        self.due += self._period
        if (late := time.perf_counter() - self.due) > self._period:
            missed = int(late / self._period)
            self.skipped += missed
            self.due += missed * self._period
        if (left := self.due - time.perf_counter() - _SPIN) > 0:
            time.sleep(left)
        while (now := time.perf_counter()) < self.due:
            pass
        return now


@contextmanager
def without_collections() -> Iterator[None]:
    """No garbage collection within the block; what is there before is left out of later ones."""
    enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if enabled:
            gc.enable()


TIMES = ("late", "policy", "policy_cpu", "step")


@dataclass(frozen=True)
class RealTime:
    """Measurements of a paced loop.

    pacing: rate, deadline and duration of the loop
    seconds: it took, pauses between episodes left out
    times: name of TIMES -> [s] of each control step
    skipped: periods that passed while a step was not done
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
        found = np.percentile(self.times[name], (50, 95, 99, 100)).tolist()
        return dict(zip(("p50", "p95", "p99", "max"), found, strict=True))

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
    """Plays episodes at a rate; the times of all of them are kept.

    It stands between a rollout and its policy: `act` waits for the period.
    """

    def __init__(self, pacing: Pacing) -> None:
        self._pace(pacing)
        self._times = {name: array("d") for name in TIMES}
        self._seconds = 0.0

    def open(self, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Controller:
        """The policy that it plays; arguments as of registry.open_policy."""
        return open_policy(candidate, chip, env, setup)

    def seeds(self, given: Sequence[int]) -> Iterator[int]:
        """The seeds to play: those given, or from the first on for as long as was asked."""
        if self._pacing.duration is None:
            yield from given
            return
        for seed in itertools.count(given[0]):
            if self._seconds >= self._pacing.duration:
                return
            yield seed

    def rollout(self, env: Env, controller: Controller, seed: int) -> Rollout:
        """One episode, a control step in each period."""
        self._controller = controller
        with without_collections():
            return rollout(env, self, seed, self._on_step)

    def reset(self, seed: int) -> None:
        """Reset the policy."""
        self._seed = seed
        self._controller.reset(seed)

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The policy's action in the next period."""
        self._woke, self._computed = self._metronome.wait(), time.thread_time()
        action = self._controller.act(observation)
        self._acted, self._computed = time.perf_counter(), time.thread_time() - self._computed
        return action

    def measured(self) -> RealTime:
        """The times so far."""
        times = {name: np.array(values) for name, values in self._times.items()}
        return RealTime(self._pacing, self._seconds, times, self._metronome.skipped)

    def _pace(self, pacing: Pacing) -> None:
        self._pacing, self._metronome = pacing, Metronome(pacing.period)

    def _on_step(self, recorder: EpisodeRecorder) -> None:
        """Begin an episode, or take the times of a control step."""
        if not recorder.steps:
            if not self._seconds:  # the first inference takes its memory, and may compile
                self._controller.act(recorder.observation)
                self._controller.reset(self._seed)
            self._metronome.start()
            self._began = time.perf_counter()
            return
        stepped, due = time.perf_counter(), self._metronome.due
        times = (self._woke - due, self._acted - self._woke, self._computed, stepped - due)
        for name, value in zip(TIMES, times, strict=True):
            self._times[name].append(value)
        if recorder.over:
            self._seconds += stepped - self._began
