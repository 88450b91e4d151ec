"""The arithmetic of chips that add up event by event, saturate at each, and decay by shifts."""

from dataclasses import dataclass

from runtime.fixed import Register


@dataclass(frozen=True)
class EventPoint:
    """The integers of Xylo's cores: leaky integrators that spike several times in a timestep.

    weight_bits: of a weight, with the sign.
    shift_max: weights may be shifted left by so much.
    dash_max: a state x loses x >> dash in each timestep, and at least 1; largest dash.
    currents: synaptic currents of a neuron, each with weights and a dash of its own.
    state: every current, membrane and threshold.
    events_max: input events of a channel in a timestep; more are lost.
    spikes_max: spikes of a neuron in a timestep.
    output_spikes_max: spikes of an output neuron in a timestep.
    """

    weight_bits: int
    shift_max: int
    dash_max: int
    currents: int
    state: Register
    events_max: int
    spikes_max: int
    output_spikes_max: int

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]: its currents and its membrane."""
        return (self.state.bits,) * (self.currents + 1)
