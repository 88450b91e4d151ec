"""Xylo's neurons: the registers that hold them, and one timestep.

They add up event by event, saturate at each, and decay by shifts. `update` is the specification.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer, LayerState, Network, Numbers, StepResult
from spikedeploy.runtime.chips.registers import Register, shift_decay
from spikedeploy.runtime.errors import ChipError

Read = Literal["output", "any"]


@dataclass(frozen=True)
class XyloRegisters:
    """The registers of Xylo's cores: leaky integrators that spike several times in a timestep.

    weight_bits: of a weight, with the sign.
    shift_max: weights may be shifted left by so much.
    dash_max: a state x loses x >> dash in each timestep, and at least 1; largest dash.
    currents: synaptic currents of a neuron, each with weights and a dash of its own.
    state: every current, membrane and threshold.
    leak: what decay adds to a membrane, before it is added.
    events_max: input events of a channel in a timestep; more are lost.
    spikes_max: spikes of a neuron in a timestep.
    output_spikes_max: spikes of an output neuron in a timestep.
    read: neurons whose spikes the host receives: those of the "output" population, or "any", hidden
        ones too, as a simulator lets one.
    """

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


def update(
    registers: XyloRegisters,
    network: Network,
    layer: Layer,
    presynaptic: Sequence[Numbers],
    state: LayerState,
) -> StepResult:
    """Advance a layer by one timestep, in which these spikes (B, M) of its synapses arrive."""
    current, lost = _arrived(registers, network, layer, presynaptic, state.current)
    # I = I - dec(I)      V = V + (sum I - dec(V) + bias)      each sum as its register holds it
    current = current - shift_decay(current, layer.current_decay)
    # the lowest membrane with a dash of 0 leaks what does not fit: it stays where it is (xylosim)
    leak = registers.leak.fit(-shift_decay(state.membrane, layer.membrane_decay))
    change, low = registers.state.fit_counted(current.sum(axis=1) + leak)
    change, turned = registers.state.fit_counted(change + layer.voltage_bias)
    membrane, high = registers.state.fit_counted(state.membrane + change)
    is_output = layer.name == network.output and network.output_apart
    most = registers.output_spikes_max if is_output else registers.spikes_max
    spikes = np.zeros(membrane.shape, np.int64)
    if layer.spiking:
        spikes, membrane = _spikes(layer, membrane, most)
    active = (state.membrane != 0) | current.any(axis=1) | (layer.voltage_bias != 0)
    state.current, state.membrane = current, membrane
    return StepResult(spikes, active, lost + low + turned + high)


def _arrived(
    registers: XyloRegisters,
    network: Network,
    layer: Layer,
    presynaptic: Sequence[Numbers],
    current: Numbers,
) -> tuple[Numbers, NDArray[np.int64]]:
    """The currents (B, K, N) after the events, axon by axon, and how many additions saturated."""
    current, lost = current.copy(), np.zeros((len(current), layer.size), np.int64)
    for synapses, counts in zip(layer.synapses, presynaptic, strict=True):
        weight, fed = synapses.weight.astype(np.int64), synapses.current
        events = counts.astype(np.int64)
        if synapses.source == network.input:
            events = events.clip(max=registers.events_max)
        if (np.abs(current[:, fed]) + events @ np.abs(weight)).max() <= registers.state.limit:
            # no partial sum can saturate, and so their order does not matter
            current[:, fed] += events @ weight
            continue
        for index, axon in np.argwhere(events):
            added = _added(registers, current[index, fed], weight[axon], int(events[index, axon]))
            current[index, fed], over = added
            lost[index] += over
    return current, lost


def _added(
    registers: XyloRegisters, current: Numbers, weight: Numbers, count: int
) -> tuple[Numbers, Numbers]:
    """Currents (N,) after so many events of one axon, and how many additions saturated."""
    if registers.state.overflow != "saturate" or registers.state.between:
        lost = np.zeros_like(current)
        for _ in range(count):
            current, over = registers.state.fit_counted(current + weight)
            lost = lost + over
        return current, lost
    low, high = -registers.state.limit - 1, registers.state.limit
    # additions of one weight saturate for good, so their order does not matter
    room = np.where(weight > 0, high - current, current - low)
    fitting = np.where(weight == 0, count, room // np.maximum(np.abs(weight), 1))
    return registers.state.fit(current + count * weight), (count - fitting).clip(min=0)


def _spikes(layer: Layer, membrane: Numbers, most: int) -> tuple[Numbers, Numbers]:
    """Spikes (B, N) of the membranes, and what they leave of them; at most so many of a neuron."""
    budget = np.full(membrane.shape, most)
    if not layer.aliases:
        return _fired(membrane, layer.threshold, budget)
    membrane, spikes = membrane.copy(), 0 * budget
    for n, others in enumerate(layer.aliases):
        # spikes that were counted for a neuron before its turn use up its budget
        left = budget[:, n] - spikes[:, n]
        own, membrane[:, n] = _fired(membrane[:, n], layer.threshold[n], left)
        spikes[:, n] += own
        for other in others:
            spikes[:, other] = np.minimum(spikes[:, other] + spikes[:, n], most)
    return spikes, membrane


def _fired(membrane: Numbers, threshold: Numbers, budget: Numbers) -> tuple[Numbers, Numbers]:
    """Spikes while there is a threshold to take off the membrane, and what is left of it."""
    spikes = 0 * budget
    for _ in range(budget.max()):
        fires = (membrane >= threshold) & (spikes < budget)
        if not fires.any():
            break
        spikes, membrane = spikes + fires, membrane - threshold * fires
    return spikes, membrane
