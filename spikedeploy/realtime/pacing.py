"""A fixed rate: how it is given, and how the loop waits for its next period."""

import gc
import math
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

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

    rate      control steps per second [Hz]
    deadline  [s] of a control step; it may be longer than the period
    duration  [s] after which no further episode begins; None for as many episodes as were asked for
    """

    rate: float
    deadline: float
    duration: float | None = None

    @property
    def period(self) -> float:
        """Time of a control step [s]."""
        return 1 / self.rate


def pacing(rate: float | None, deadline: str | None, lasting: str | None) -> Pacing | None:
    """What `--rate`, `--deadline` and `--duration` ask for; None without a rate."""
    if rate is None:
        for option, given in (("--deadline", deadline), ("--duration", lasting)):
            if given is not None:
                raise ConfigError(f"{option} goes with --rate, which paces the loop by the clock.")
        return None
    return paced(rate, deadline, lasting)


def paced(rate: float, deadline: str | None, lasting: str | None) -> Pacing:
    """A rate [Hz] with what the other options ask for."""
    if not (math.isfinite(rate) and _LOWEST <= rate <= _HIGHEST):
        raise ConfigError(f"--rate {rate:g}: it must be from {_LOWEST:g} to {_HIGHEST:,.0f} Hz.")
    return Pacing(
        rate,
        1 / rate if deadline is None else duration("--deadline", deadline),
        None if lasting is None else duration("--duration", lasting),
    )


class Metronome:
    """Periods of a fixed length, from the first that is waited for.

    due      when the current period began [s], on the clock of time.perf_counter
    skipped  periods that had passed before they were waited for
    """

    def __init__(self, period: float) -> None:
        self.due, self.skipped = 0.0, 0
        self._period = period

    def start(self) -> None:
        """Begin anew: the next period begins now."""
        self.due = time.perf_counter() - self._period

    def wait(self) -> float:
        """When the wait ended: at the next period; those that have passed whole are skipped.

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
