"""The convention: the choices of discretisation that NIR leaves open and on which spikes depend."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast, get_args

from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.metadata import Record, Tree

Reset = Literal["zero", "subtract", "zero-delayed", "subtract-delayed", "subtract-ahead", "none"]
Integrator = Literal["euler", "exponential"]
State = Literal["reset", "kept"]
Spikes = Literal["above", "reached", "many"]
Floor = Literal["none", "zero", "threshold"]
Clock = Literal["gated", "pipelined", "free"]
CLOCKS: tuple[Clock, ...] = get_args(Clock)


@dataclass(frozen=True)
class Convention:
    """How a NIR graph, which is defined in continuous time, is simulated in timesteps.

    dt: [s] duration of one timestep.
    reset: after a spike the membrane is set to v_reset ("zero"; exporters write v_reset = 0), or
        threshold - v_reset is subtracted from it ("subtract"), both in the next timestep
        ("zero-delayed", "subtract-delayed"); "subtract-ahead" and "none" are snnTorch's too
        (runtime.float_model has the equations).
    integrator: decay factors are 1 - dt/tau ("euler") or exp(-dt/tau) ("exponential").
    delay: [timesteps] of an Affine, Linear or convolution: y[t] = W x[t - delay] + b. Recurrent
        connections take one timestep in any case.
    state: currents and membranes start from 0 in each inference ("reset"), or are kept ("kept").
    source: where the convention comes from; no part of equality.
    spikes: of a neuron in one timestep: one if membrane > threshold ("above"), one if membrane >=
        threshold ("reached"), or floor((membrane - v_reset) / (threshold - v_reset)) of them, all
        subtracted ("many").
    floor: lower bound of a spiking neuron's membrane: "none", 0 ("zero"), or minus its threshold
        ("threshold").
    clock: when layers update. "gated": all layers in each timestep, one after the other, so that
        spikes arrive in the timestep in which they are emitted; a chip then updates each layer
        once, when its spikes have arrived, and holds it meanwhile. "pipelined": all layers at once,
        and every connection onto neurons, the input's included, takes one timestep.
        A chip whose cores all advance in each of its timesteps may also run a gated network "free"
        (runtime.compiler), which is no property of a network.
    """

    dt: float
    reset: Reset = "zero"
    integrator: Integrator = "euler"
    delay: int = 0
    state: State = "reset"
    source: str = field(default="stated", compare=False)
    spikes: Spikes = "above"
    floor: Floor = "none"
    clock: Literal["gated", "pipelined"] = "gated"

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
        _one_of("clock", self.clock, CLOCKS[:2])
        if self.delay and self.clock == "pipelined":
            raise ConventionError(
                "clock 'pipelined' and delay 1 contradict each other: connections onto neurons "
                "take a timestep by the clock already. Choose delay 0, or clock 'gated'."
            )
        if self.spikes == "many" and self.reset != "subtract":
            raise ConventionError(
                f"reset {self.reset!r} and spikes 'many' contradict each other: several spikes of "
                "a timestep must be subtracted. Choose reset 'subtract', or spikes 'above'."
            )

    def describe(self) -> str:
        """One line for reports: every choice, and where it comes from."""
        optional = {**self._optional(), "clock": self.clock}
        more = "".join(f", {name}={value}" for name, value in optional.items())
        return (
            f"dt={self.dt:g} s, reset={self.reset}, integrator={self.integrator}, "
            f"delay={self.delay}, state={self.state}{more} ({self.source})"
        )

    def with_options(self, options: Mapping[str, Any]) -> "Convention":
        """The same convention except for these options; `source` names them."""
        if not options:
            return self
        names = ", ".join(sorted(options))
        return replace(self, **options, source=f"{names} given, otherwise {self.source}")

    def to_record(self) -> Tree:
        """The fields as the file stores them."""
        return {
            "dt": self.dt,
            "reset": self.reset,
            "integrator": self.integrator,
            "delay": self.delay,
            "state": self.state,
            "source": self.source,
            **self._optional(),
        }

    def _optional(self) -> Tree:
        """Fields that are stored only where they differ from the default: older files lack them."""
        fields: Tree = {}
        if self.spikes != "above":
            fields["spikes"] = self.spikes
        if self.floor != "none":
            fields["floor"] = self.floor
        if self.clock != "gated":
            fields["clock"] = self.clock
        return fields

    @classmethod
    def from_record(cls, record: Record) -> "Convention":
        """The convention stored in a file; impossible ones raise ConventionError."""
        names = "dt", "reset", "integrator", "delay", "clock", "state", "source", "spikes", "floor"
        record.only(*names)
        clock = record.text("clock") if "clock" in record else "gated"
        return cls(
            dt=record.number("dt"),
            reset=cast("Reset", record.text("reset")),
            integrator=cast("Integrator", record.text("integrator")),
            delay=record.integer("delay"),
            state=cast("State", record.text("state")),
            source=record.text("source"),
            spikes=cast("Spikes", record.text("spikes") if "spikes" in record else "above"),
            floor=cast("Floor", record.text("floor") if "floor" in record else "none"),
            clock=cast("Literal['gated', 'pipelined']", clock),
        )


def _one_of(name: str, found: object, allowed: tuple[object, ...]) -> None:
    if found not in allowed:
        choices = ", ".join(repr(choice) for choice in allowed)
        raise ConventionError(f"{name} {found!r} is unknown. Choose one of {choices}.")
