"""Programs that several tests build without a policy: from trace files and random integers."""

import json
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from runtime.chip import chip
from runtime.convention import Convention
from runtime.fixed import Register
from runtime.program import Layer, Program, Synapses
from runtime.quantize import stored

GOLDEN = Path(__file__).parent / "golden"


def layer(fixed, name, weights, synapses, *, decays, threshold, bias=0, start=0):
    """A layer from what a chip's registers hold; the threshold and the bias are state units."""
    ones = np.ones(len(weights), np.int64)
    return Layer(
        name=name,
        synapses=synapses,
        bias=0 * ones,
        voltage_bias=bias * ones,
        threshold=threshold * ones,
        current_keep=(fixed.decay_one - decays[0] - fixed.current_decay_offset) * ones,
        membrane_keep=(fixed.decay_one - decays[1] - fixed.membrane_decay_offset) * ones,
        scale=1.0,
        start=start,
    )


def golden(path):
    """The program, raster (1, T, M) and list of layers with expected u, v, s of a trace file."""
    trace = json.loads(Path(path).read_text())
    reading = READINGS[Path(path).name.split("_")[0]]
    common = trace.get("params", {})
    datasheet = chip(
        "loihi1",
        **reading,
        sign_mode="mixed" if _mixed(common) else "split",
        weight_bits=common.get("num_weight_bits", 8),
        refractory=common.get("refractory", common.get("refract_delay", 1)),
    )
    layers = trace.get("layers", [trace])
    names = [f"layer{k}" for k in range(len(layers))]
    built = [
        _golden_layer(datasheet, source, name, spec.get("params", spec))
        for source, name, spec in zip(["input", *names], names, layers, strict=False)
    ]
    convention = Convention(1e-3, delay=datasheet.delay)
    width = built[0].synapses[0].weight.shape[0]
    program = Program(datasheet, convention, "input", width, tuple(built), names[-1], None)
    return program, np.array(trace["input_spikes"], np.uint8)[None], layers


# where the emulators differ; without an entry a trace is lava's
READINGS = {
    "lava": {},
    # effective decays, mixed weights toward zero, no overflow, input acts in its own row
    "brian2loihi": {
        "delay": 0,
        "current_decay_offset": 0,
        "step_rounding": "zero",
        "current": Register(24, "none"),
        "membrane": Register(24, "none"),
    },
    # two's complement, input acts in its own row
    "nengoloihi": {
        "delay": 0,
        "accumulator": Register(22, "wrap"),
        "current": Register(24, "wrap"),
    },
}


def _mixed(p):
    return not p.get("exc_inh_split", True) or p.get("weights_mixed") is not None


def _golden_layer(datasheet, source, name, p):
    if "weights_exc" in p and p["weights_mixed"] is None:
        weights = np.array(p["weights_exc"]) + np.array(p["weights_inh"])
    else:
        weights = np.array(p.get("weights_mixed") or p["weights"])  # [post][pre]
    kept = np.ascontiguousarray(stored(weights.T, datasheet.fixed))
    return layer(
        datasheet.fixed,
        name,
        weights,
        (Synapses(source, kept, datasheet.delay),),
        decays=(p.get("du", p.get("decay_u")), p.get("dv", p.get("decay_v"))),
        threshold=p.get("vth", p.get("vth_mant")) << datasheet.fixed.mantissa_shift,
        bias=p.get("bias", p.get("bias_mant", 0) << p.get("bias_exp", 0)),
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
        membrane=Register(draw(st.sampled_from([18, 24])), draw(st.sampled_from(["none", "clip"]))),
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
    return Layer(
        name=name,
        synapses=tuple(synapses),
        bias=rng.integers(-top, top + 1, size) * rng.integers(0, 2),
        voltage_bias=rng.integers(-5000, 5001, size) * rng.integers(0, 2),
        threshold=rng.integers(0, 40 * top, size) << 6,
        current_keep=rng.integers(0, 4097, size),
        membrane_keep=rng.integers(0, 4097, size),
        scale=1.0,
        start=start,
    )
