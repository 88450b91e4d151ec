"""Programs that several tests build without a policy: from registers and random integers."""

import numpy as np
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention


def layer(fixed, name, weights, synapses, *, decays, threshold, bias=0, start=0):
    """A layer from what a chip's registers hold; the threshold and the bias are state units."""
    ones = np.ones(len(weights), np.int64)
    return Layer(
        name=name,
        synapses=synapses,
        bias=0 * ones,
        voltage_bias=bias * ones,
        threshold=threshold * ones,
        current_decay=(fixed.decay_one - decays[0] - fixed.current_decay_offset) * ones,
        membrane_decay=(fixed.decay_one - decays[1] - fixed.membrane_decay_offset) * ones,
        scale=1.0,
        start=start,
    )


def rasters(program, batch, timesteps, rate, seed, inferences=1):
    """Random input spikes: a list of (B, T, M)."""
    rng = np.random.default_rng(seed)
    shape = (batch, timesteps, program.width)
    return [(rng.random(shape) < rate).astype(np.uint8) for _ in range(inferences)]


@st.composite
def random_programs(draw):
    """Networks of every form that compile can make, with small, large and overflowing numbers."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    datasheet = chip(
        "loihi1",
        # narrow registers overflow within the few timesteps of a test
        accumulator=Register(
            draw(st.sampled_from([16, 22])), draw(st.sampled_from(["none", "wrap"]))
        ),
        current=Register(
            draw(st.sampled_from([17, 24])),
            draw(st.sampled_from(["none", "wrap", "wrap-once", "clip"])),
        ),
        push=Register(draw(st.sampled_from([17, 24])), draw(st.sampled_from(["none", "wrap"]))),
        membrane=Register(
            draw(st.sampled_from([18, 24])),
            draw(st.sampled_from(["none", "clip", "saturate"])),
            draw(st.sampled_from([None, None, (0, 1 << 20)])),
        ),
        refractory=draw(st.sampled_from([1, 1, 3])),
    )
    staggered = draw(st.booleans())
    loop, skip = draw(st.booleans()), draw(st.booleans())
    sizes = draw(st.lists(st.sampled_from([1, 3, 40, 210]), min_size=2, max_size=4))
    names = ["input", *(f"layer{k}" for k in range(1, len(sizes)))]
    layers = []
    for k, (name, size) in enumerate(zip(names[1:], sizes[1:], strict=True), start=1):
        start = k if staggered else 0
        wires = [(names[k - 1], sizes[k - 1], 1)]
        if loop:
            wires.append((name, size, 1))
        if skip and k > 1:
            wires.append(("input", sizes[0], k if staggered else 1))
        layers.append(_random_layer(rng, name, size, wires, start))
    convention = Convention(1e-3, state=draw(st.sampled_from(["reset", "kept"])))
    return Program(datasheet, convention, "input", sizes[0], tuple(layers), names[-1], None)


def _random_layer(rng, name, size, wires, start):
    top = rng.choice([3, 255])
    sparse = rng.random() < 0.5
    synapses = []
    for source, fan_in, delay in wires:
        weight = rng.integers(-top, top + 1, (fan_in, size))
        if sparse:
            weight *= rng.random(weight.shape) < 0.3
        synapses.append(Synapses(source, weight.astype(np.int16), delay))
    return random_neurons(rng, name, size, synapses, start, top)


def random_neurons(rng, name, size, synapses, start=0, top=255):
    """A layer of CuBa-LIF neurons, whose numbers are about as large as weights up to `top`."""
    return Layer(
        name=name,
        synapses=tuple(synapses),
        bias=rng.integers(-top, top + 1, size) * rng.integers(0, 2),
        voltage_bias=rng.integers(-5000, 5001, size) * rng.integers(0, 2, rng.choice([1, size])),
        threshold=rng.integers(0, 40 * top, size) << 6,
        current_decay=_keeps(rng, size) * rng.integers(0, 2),
        membrane_decay=_keeps(rng, size),
        scale=1.0,
        start=start,
    )


def _keeps(rng, size):
    """Decays of any length, or of halves and quarters, which fast number types take."""
    step = rng.choice([1, 1024])
    return step * rng.integers(0, 4096 // step + 1, size)


@st.composite
def chains(draw):
    """Small layers one behind the other, in whose registers everything fits."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sizes = draw(st.lists(st.sampled_from([1, 3, 20]), min_size=3, max_size=5))
    names = ["input", *(f"layer{k}" for k in range(1, len(sizes)))]
    layers = []
    for k, (name, size) in enumerate(zip(names[1:], sizes[1:], strict=True), start=1):
        weight = rng.integers(-3, 4, (sizes[k - 1], size)).astype(np.int16)
        layers.append(
            Layer(
                name=name,
                synapses=(Synapses(names[k - 1], weight, 1),),
                bias=rng.integers(-3, 4, size) * rng.integers(0, 2),
                voltage_bias=rng.integers(-70, 71, size) * rng.integers(0, 2),
                threshold=rng.integers(0, 12, size) << 6,
                current_decay=rng.integers(0, 3900, size) * rng.integers(0, 2),
                membrane_decay=rng.integers(0, 3900, size),
                scale=1.0,
                start=k,
            )
        )
    return Program(
        chip("loihi1"), Convention(1e-3), "input", sizes[0], tuple(layers), names[-1], None
    )


def random_kernel(rng, maps, source, delay, top):
    """Synapses by a kernel, on maps (C, Y, X) of a source."""
    channels, *extents = maps
    groups = int(rng.choice([n for n in (1, 2, 3) if channels % n == 0]))
    pool = tuple(int(rng.integers(1, min(2, extent) + 1)) for extent in extents)
    axes = []
    for extent, pooled in zip(extents, pool, strict=True):
        kernel, stride, padding, dilation = (int(n) for n in rng.integers(1, [4, 4, 4, 3]))
        span, inside = dilation * (kernel - 1) + 1, extent // pooled
        # as much padding behind as makes a position at least
        behind = max(int(rng.integers(0, 3)), span - inside - padding + 1)
        axes.append((kernel, stride, padding - 1, dilation, inside + padding - 1 + behind - span))
    kernel, stride, padding, dilation, room = zip(*axes, strict=True)
    features = groups * int(rng.integers(1, 4))
    places = (each // step + 1 for each, step in zip(room, stride, strict=True))
    window = Window(maps, (features, *places), kernel, pool, stride, padding, dilation, groups)
    weight = rng.integers(-top, top + 1, (features, channels // groups, *kernel))
    weight *= rng.random(weight.shape) < rng.choice([0.5, 1.0])
    return Synapses(source, weight.astype(np.int16), delay, window=window)


def random_convolutions(rng, make_layer, datasheet, convention, delay=1, loop=False):
    """Two convolutions and a layer behind a matrix; make_layer has names, sizes and synapses."""
    maps = (int(rng.integers(1, 4)), int(rng.integers(1, 8)), int(rng.integers(1, 8)))
    width, top, layers, source = int(np.prod(maps)), 20, [], "input"
    for name in ("one", "two"):
        kernel = random_kernel(rng, maps, source, delay, top)
        layers.append(make_layer(rng, name, kernel.shape[1], (kernel,)))
        maps, source = kernel.window.target, name
    size = int(rng.integers(1, 5))
    wires = [("two", kernel.shape[1]), *[("three", size)] * loop]
    synapses = tuple(
        Synapses(
            n, rng.integers(-top, top + 1, (m, size)).astype(np.int16), max(delay, n == "three")
        )
        for n, m in wires
    )
    layers.append(make_layer(rng, "three", size, synapses))
    return Program(datasheet, convention, "input", width, tuple(layers), "three", None)
