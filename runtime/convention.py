"""The convention: the choices of discretisation that NIR leaves open and on which spikes depend."""

import math
import numbers
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

from spikedeploy.runtime import choices
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.metadata import OPTIONAL, StoredRecord

Reset = choices.Reset
Integrator = choices.Integrator
State = choices.State
SpikeCondition = choices.SpikeCondition
Floor = choices.Floor
Clock = choices.Clock
CLOCKS: tuple[Clock, ...] = get_args(Clock)


def check_timestep(dt: object) -> None:
    """Raise ConventionError where a dt is no duration [s]."""
    seconds = float(dt) if isinstance(dt, numbers.Real) else math.nan
    if not (math.isfinite(seconds) and seconds > 0):
        raise ConventionError(
            f"dt must be a finite number of seconds above 0, found {dt!r}. "
            "Give the timestep that the network was trained with."
        )


@dataclass(frozen=True)
class Convention(StoredRecord):
    """The discretisation of a NIR graph, which is defined in continuous time.

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
        threshold ("reached"), or floor((membrane - v_reset) / (threshold - v_reset)) of them, after
        which all are subtracted, or the membrane is reset to v_reset ("many").
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
    spikes: SpikeCondition = field(default="above", metadata=OPTIONAL)
    floor: Floor = field(default="none", metadata=OPTIONAL)
    clock: Literal["gated", "pipelined"] = field(default="gated", metadata=OPTIONAL)

    def __post_init__(self) -> None:
        check_timestep(self.dt)
        super().__post_init__()
        if self.delay not in (0, 1):
            raise self.unknown("delay", self.delay, (0, 1))
        if self.delay and self.clock == "pipelined":
            raise ConventionError(
                "clock 'pipelined' and delay 1 contradict each other: connections onto neurons "
                "take a timestep by the clock already. Choose delay 0, or clock 'gated'."
            )
        if self.spikes == "many" and self.reset not in ("subtract", "zero"):
            raise ConventionError(
                f"reset {self.reset!r} and spikes 'many' contradict each other: after several "
                "spikes of a timestep a membrane is reset at once. Choose reset 'subtract' or "
                "'zero', or spikes 'above'."
            )

    def unknown(self, name: str, found: object, known: tuple[object, ...]) -> Exception:
        """Return the error for a value that an option does not have."""
        choices = ", ".join(map(repr, known))
        return ConventionError(f"{name} {found!r} is unknown. Choose one of {choices}.")

    def describe(self) -> str:
        """Describe every choice and its source in one line, for reports."""
        stored = {**self.to_record(), "clock": self.clock}
        optional = (name for name in ("spikes", "floor", "clock") if name in stored)
        more = "".join(f", {name}={stored[name]}" for name in optional)
        return (
            f"dt={self.dt:g} s, reset={self.reset}, integrator={self.integrator}, "
            f"delay={self.delay}, state={self.state}{more} ({self.source})"
        )

    def with_options(self, options: Mapping[str, Any]) -> "Convention":
        """Return the convention with these options replaced; `source` names them."""
        if not options:
            return self
        names = ", ".join(sorted(options))
        return replace(self, **options, source=f"{names} given, otherwise {self.source}")
