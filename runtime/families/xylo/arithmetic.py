"""The arithmetic of chips that add up event by event, saturate at each, and decay by shifts."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.errors import ChipError

Read = Literal["output", "any"]


@dataclass(frozen=True)
class XyloArithmetic:
    """The integers of Xylo's cores: leaky integrators that spike several times in a timestep.

    weight_bits: of a weight, with the sign.
    shift_max: weights may be shifted left by so much.
    dash_max: a state x loses x >> dash in each timestep, and at least 1; largest dash.
    currents: synaptic currents of a neuron, each with weights and a dash of its own.
    state: every current, membrane and threshold.
    leak: what decay adds to a membrane, on its way there.
    events_max: input events of a channel in a timestep; more are lost.
    spikes_max: spikes of a neuron in a timestep.
    output_spikes_max: spikes of an output neuron in a timestep.
    read: neurons whose spikes the host hears: those of the "output" population, or "any", hidden
        ones too, as a simulator lets one.
    """

    # the interpreter alone
    backends: ClassVar[Mapping[str, str]] = {}

    weight_bits: int
    shift_max: int
    dash_max: int
    currents: int
    state: Register
    leak: Register
    events_max: int
    spikes_max: int
    output_spikes_max: int
    read: Read = "output"

    def __post_init__(self) -> None:
        if self.read not in get_args(Read):
            choices = " or ".join(map(repr, get_args(Read)))
            raise ChipError(f"read {self.read!r} is unknown. Choose {choices}.")

    @property
    def weight_max(self) -> int:
        """Largest weight of either sign that quantising makes."""
        return int((1 << (self.weight_bits - 1)) - 1)

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]: its currents and its membrane."""
        return (self.state.bits,) * (self.currents + 1)
