"""The events of a window, counted by the kernels."""

from spikedeploy.runtime.families.cuba_numba.jit import jit
from spikedeploy.runtime.families.cuba_numba.layout import (
    BIAS_FAN_OUT,
    BIAS_SOP,
    FAN_OUT,
    FIRST_WIRE,
    IDLE,
    IS_OUTPUT,
    LAST_WIRE,
    LENGTHS,
    MESSAGE,
    NEURONS,
    RASTER,
    REMEMBERS,
    SIZE,
    SOP,
    SOURCE,
    SPIKE_IN,
    SPIKE_OUT,
    START,
    UPDATE,
    Array,
)


@jit
def count(
    constants: Array,
    memory: Array,
    counts: Array,
    b: int,
    timesteps: int,
    steps: int,
    step: int,
) -> None:
    """The events of the window, as runtime.emulator.ledger.count."""
    layers, wires, sources = constants.layers, constants.wires, constants.sources
    for layer in range(len(layers)):
        about, events = layers[layer], counts[b, layer]
        for wire in range(about[FIRST_WIRE], about[LAST_WIRE]):
            spikes, sops = _sent(constants, memory, b, wires[wire], timesteps)
            events[SPIKE_IN] += spikes
            events[SOP] += sops
        own = sources[layer + 1]
        at = own[LENGTHS] + own[REMEMBERS]
        events[SPIKE_OUT] = memory.lengths[b, at : at + timesteps].sum()
        always_on = 0 if 0 <= step < about[START] else timesteps
        events[BIAS_SOP] = always_on * about[BIAS_FAN_OUT]
        events[IDLE] = about[SIZE] * steps - events[UPDATE]
        events[MESSAGE] = events[SPIKE_IN] + always_on * (about[BIAS_FAN_OUT] > 0)
        if about[IS_OUTPUT]:
            events[MESSAGE] += events[SPIKE_OUT]


@jit
def _sent(constants: Array, memory: Array, b: int, wire: Array, timesteps: int) -> tuple[int, int]:
    """Spikes and synaptic operations of the rows that a source emitted in the window."""
    source = constants.sources[wire[SOURCE]]
    spikes, sops = 0, 0
    for row in range(timesteps):
        place = source[REMEMBERS] + row
        at = source[RASTER] + place * source[NEURONS]
        found = memory.lengths[b, source[LENGTHS] + place]
        spikes += found
        for axon in memory.lists[b, at : at + found]:
            sops += constants.fan_out[wire[FAN_OUT] + axon]
    return spikes, sops
