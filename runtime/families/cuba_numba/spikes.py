"""Spikes in the kernels: listed once for each row, summed up as weights, and counted."""

from spikedeploy.runtime.families.cuba_numba.jit import jit
from spikedeploy.runtime.families.cuba_numba.layout import (
    BIAS_FAN_OUT,
    BIAS_SOP,
    FAN_OUT,
    FIRST_WIRE,
    HEAD,
    IDLE,
    IS_OUTPUT,
    LAG,
    LAST_WIRE,
    LENGTHS,
    MESSAGE,
    NEURONS,
    RASTER,
    READ,
    REMEMBERS,
    SIZE,
    SOP,
    SOURCE,
    SPIKE_IN,
    SPIKE_OUT,
    START,
    TAIL,
    UPDATE,
    WEIGHT,
    Array,
)


@jit
def zero_or_one(constants: Array, memory: Array, batch: int, timesteps: int) -> bool:
    """Whether all values of the input are 0 or 1."""
    source, all_ = constants.sources[0], 0
    first = source[RASTER] + source[REMEMBERS] * source[NEURONS]
    for b in range(batch):
        for value in memory.rasters[b, first : first + timesteps * source[NEURONS]]:
            all_ |= value
    return all_ <= 1


@jit
def list_spikes(constants: Array, memory: Array, b: int, source: int, row: int) -> None:
    """List the spikes of a source in a row of the window."""
    sources = constants.sources
    size, place = sources[source, NEURONS], sources[source, REMEMBERS] + row
    at = sources[source, RASTER] + place * size
    spikes, axons = memory.rasters[b, at : at + size], memory.lists[b, at : at + size]
    found = 0
    for n in range(size):
        # written whether it spiked or not, and overwritten if not: no jumps to guess
        axons[found] = n
        found += spikes[n]
    memory.lengths[b, sources[source, LENGTHS] + place] = found


@jit
def sum_weights(
    constants: Array,
    memory: Array,
    sums: Array,
    bias: Array,
    b: int,
    layer: int,
    row: int,
    timesteps: int,
) -> None:
    """Fill sums (N,) with those of the bias and of each axon that spiked."""
    about, wires, sources = constants.layers[layer], constants.wires, constants.sources
    size = about[SIZE]
    if about[HEAD] <= row < timesteps - about[TAIL]:
        for n in range(size):
            sums[n] = bias[n]
    else:
        for n in range(size):
            sums[n] = 0
    for wire in range(about[FIRST_WIRE], about[LAST_WIRE]):
        source = wires[wire, SOURCE]
        place = sources[source, REMEMBERS] + row - wires[wire, LAG]
        at = sources[source, RASTER] + place * sources[source, NEURONS]
        found = memory.lengths[b, sources[source, LENGTHS] + place]
        _add_rows(
            sums, constants.weights, wires[wire, WEIGHT], size, memory.lists[b, at : at + found]
        )


@jit
def _add_rows(sums: Array, weights: Array, start: int, size: int, axons: Array) -> None:
    """Add the weights of some axons, four at a time: each sum is fetched a quarter as often."""
    whole = len(axons) // 4 * 4
    for k in range(0, whole, 4):
        at = start + axons[k] * size
        one = weights[at : at + size]
        at = start + axons[k + 1] * size
        two = weights[at : at + size]
        at = start + axons[k + 2] * size
        three = weights[at : at + size]
        at = start + axons[k + 3] * size
        four = weights[at : at + size]
        for n in range(size):
            sums[n] += one[n] + two[n] + three[n] + four[n]
    for k in range(whole, len(axons)):
        at = start + axons[k] * size
        one = weights[at : at + size]
        for n in range(size):
            sums[n] += one[n]


@jit
def widen(wide: Array, sums: Array, size: int) -> None:
    """Bring the sums to int64."""
    for n in range(size):
        wide[n] = sums[n]


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
        heard = timesteps - about[HEAD] - about[TAIL]
        always_on = 0 if 0 <= step < about[START] else heard
        events[BIAS_SOP] = always_on * about[BIAS_FAN_OUT]
        events[IDLE] = about[SIZE] * steps - events[UPDATE]
        events[MESSAGE] = events[SPIKE_IN] + always_on * (about[BIAS_FAN_OUT] > 0)
        if about[IS_OUTPUT]:
            events[MESSAGE] += events[SPIKE_OUT] + always_on * about[READ]


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
