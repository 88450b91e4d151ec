"""The convention: what NIR leaves open, and what makes spikes differ between tools."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast, get_args

from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.metadata import Record, Tree

Reset = Literal["zero", "subtract"]
Integrator = Literal["euler", "exponential"]
State = Literal["reset", "kept"]
Spikes = Literal["above", "reached", "many"]
Floor = Literal["none", "zero", "threshold"]


@dataclass(frozen=True)
class Convention:
    """How a NIR graph, which is continuous in time, is stepped.

    dt: [s] duration of one timestep.
    reset: after a spike the membrane goes to v_reset ("zero"; exporters write 0 there), or the
        distance from v_reset to the threshold is taken off it ("subtract").
    integrator: decays are 1 - dt/tau ("euler") or exp(-dt/tau) ("exponential").
    delay: [timesteps] from a spike, or a row of the input, through an Affine, Linear or
        convolution to what follows: y[t] = W x[t - delay] + b. Recurrent connections take one
        timestep in any case.
    state: currents and membranes start from 0 at each inference ("reset") or go on ("kept").
    source: who says so; no part of equality.
    spikes: in one timestep, one where the membrane is above its threshold ("above"), one where it
        is at it too ("reached"), or as many as the threshold goes into the membrane, all of which
        are subtracted ("many").
    floor: below which no membrane of a spiking neuron stays: none, 0, or minus the threshold.
    """

    dt: float
    reset: Reset = "zero"
    integrator: Integrator = "euler"
    delay: int = 0
    state: State = "reset"
    source: str = field(default="stated", compare=False)
    spikes: Spikes = "above"
    floor: Floor = "none"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.dt) and self.dt > 0):
            raise ConventionError(
                f"dt must be a finite number of seconds above 0, found {self.dt}. "
                "Give the timestep that the network was trained with."
            )
        _one_of("reset", self.reset, get_args(Reset))
        _one_of("integrator", self.integrator, get_args(Integrator))
        _one_of("delay", self.delay, (0, 1))
        _one_of("state", self.state, get_args(State))
        _one_of("spikes", self.spikes, get_args(Spikes))
        _one_of("floor", self.floor, get_args(Floor))
        if self.spikes == "many" and self.reset != "subtract":
            raise ConventionError(
                f"reset {self.reset!r} and spikes 'many' contradict each other: only what is "
                "subtracted can be so several times. Choose reset 'subtract', or spikes 'above'."
            )

    def describe(self) -> str:
        """One line that belongs in every report."""
        rare = "".join(f", {name}={value}" for name, value in self._rare().items())
        return (
            f"dt={self.dt:g} s, reset={self.reset}, integrator={self.integrator}, "
            f"delay={self.delay}, state={self.state}{rare} ({self.source})"
        )

    def given(self, options: Mapping[str, Any]) -> "Convention":
        """The same convention except for the given options."""
        if not options:
            return self
        names = ", ".join(sorted(options))
        return replace(self, **options, source=f"{names} given, otherwise {self.source}")

    def to_record(self) -> Tree:
        """What the file stores."""
        return {
            "dt": self.dt,
            "reset": self.reset,
            "integrator": self.integrator,
            "delay": self.delay,
            "state": self.state,
            "source": self.source,
            **self._rare(),
        }

    def _rare(self) -> Tree:
        """What few conventions have; files from before say nothing of it."""
        rare: Tree = {}
        if self.spikes != "above":
            rare["spikes"] = self.spikes
        if self.floor != "none":
            rare["floor"] = self.floor
        return rare

    @classmethod
    def from_record(cls, record: Record) -> "Convention":
        """The convention that a file states; checked like any other."""
        record.only("dt", "reset", "integrator", "delay", "state", "source", "spikes", "floor")
        return cls(
            dt=record.number("dt"),
            reset=cast("Reset", record.text("reset")),
            integrator=cast("Integrator", record.text("integrator")),
            delay=record.whole("delay"),
            state=cast("State", record.text("state")),
            source=record.text("source"),
            spikes=cast("Spikes", record.text("spikes") if "spikes" in record else "above"),
            floor=cast("Floor", record.text("floor") if "floor" in record else "none"),
        )


def _one_of(name: str, found: object, allowed: tuple[object, ...]) -> None:
    if found not in allowed:
        choices = ", ".join(repr(choice) for choice in allowed)
        raise ConventionError(f"{name} {found!r} is unknown. Choose one of {choices}.")
