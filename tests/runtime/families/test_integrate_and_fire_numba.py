"""Compiled integrate-and-fire neurons equal the interpreter by every rule, kernels included."""

from dataclasses import fields, replace
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.chips.registers import OVERFLOWS, Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.backend import backend_class
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.integrate_and_fire import numba_kernels as kernels
from spikedeploy.runtime.families.integrate_and_fire.neurons import IntegrateAndFireRules
from tests.equality import check_like_the_interpreter, runs
from tests.programs import random_convolutions, rasters

pytestmark = pytest.mark.skipif(
    find_spec("numba") is None, reason="numba is not installed (pip install '.[fast]')"
)


@st.composite
def datasheets(draw):
    """Chips of every combination of rules that there can be, in timesteps."""
    any_of = {
        "leak": ["none", "linear", "crossing", "shift"],
        "leak_order": ["first", "last"],
        "floor": [None, -50, 0],
        "adds": ["step", "event"],
        "fires": ["above", "reached"],
        "spikes_max": [1, 2, 255],
    }
    rules = {name: draw(st.sampled_from(values)) for name, values in any_of.items()}
    special = draw(st.sampled_from(["none", "late reset", "checks events"]))
    if special == "late reset":
        rules |= {"reset_at": "leak", "leak_order": "first", "spikes_max": 1}
    elif special == "checks events":
        rules |= {"adds": "event", "checks": "event"}
    # narrow registers overflow within the few timesteps of a test
    membrane = Register(draw(st.sampled_from([8, 16])), draw(st.sampled_from(OVERFLOWS)))
    datasheet = chip("speck2f")
    arithmetic = replace(datasheet.arithmetic, event_order="none", membrane=membrane, **rules)
    return replace(datasheet, arithmetic=arithmetic, delay_max=15)


@st.composite
def conventions(draw):
    return Convention(
        1e-3,
        reset=draw(st.sampled_from(["zero", "subtract"])),
        state=draw(st.sampled_from(["reset", "kept"])),
        spikes=draw(st.sampled_from(["above", "many"])),
        floor=draw(st.sampled_from(["none", "zero", "threshold"])),
    )


def neurons(rng, name, size, synapses, start=0):
    """A layer of numbers of any size, some of them 0."""
    return Layer(
        name=name,
        synapses=tuple(synapses),
        bias=rng.integers(-20, 21, size) * rng.integers(0, 2),
        voltage_bias=rng.integers(-20, 21, size) * rng.integers(0, 2),
        threshold=rng.integers(0, 60, size),
        current_decay=np.zeros(size, np.int64),
        membrane_decay=rng.integers(0, 8, size),
        scale=1.0,
        start=start,
        v_reset=int(rng.choice([0, 0, -7])),
    )


def leaky(program):
    """The program, some of whose neurons do not leak where the others leak by a shift of 1 to 7."""
    lost = program.chip.arithmetic.leak == "shift"
    layers = (replace(a, membrane_decay=a.membrane_decay - lost) for a in program.layers)
    return replace(program, layers=tuple(layers))


@st.composite
def programs(draw):
    """Matrices between layers, loops, skips and delays included."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    delay, loop, skip = draw(st.sampled_from([0, 1, 2])), draw(st.booleans()), draw(st.booleans())
    staggered = delay * draw(st.booleans())
    sizes = draw(st.lists(st.sampled_from([1, 3, 20]), min_size=2, max_size=4))
    names = ["input", *(f"layer{k}" for k in range(1, len(sizes)))]
    layers = []
    for k, (name, size) in enumerate(zip(names[1:], sizes[1:], strict=True), start=1):
        wires = [(names[k - 1], sizes[k - 1], delay)]
        if loop:
            wires.append((name, size, max(delay, 1)))
        if skip and k > 1:
            wires.append(("input", sizes[0], k * delay if staggered else delay))
        synapses = [
            Synapses(source, rng.integers(-40, 41, (m, size)).astype(np.int16), late)
            for source, m, late in wires
        ]
        layers.append(neurons(rng, name, size, synapses, k * staggered))
    return Program(
        draw(datasheets()), draw(conventions()), "input", sizes[0], tuple(layers), names[-1], None
    )


@settings(max_examples=100)
@given(programs(), runs)
def test_it_equals_the_interpreter_in_every_membrane_spike_and_count(program, run):
    check_like_the_interpreter(leaky(program), run, "numba")


@settings(max_examples=60)
@given(datasheets(), conventions(), st.integers(0, 2**32 - 1), st.booleans(), runs)
def test_kernels_of_convolutions_do_too(datasheet, convention, seed, loop, run):
    rng = np.random.default_rng(seed)
    program = random_convolutions(rng, neurons, datasheet, convention, int(loop), loop)
    check_like_the_interpreter(leaky(program), run, "numba")


@pytest.mark.parametrize("timesteps", [1, 6])
def test_single_timesteps_of_the_chip_equal_the_interpreter(timesteps):
    rng = np.random.default_rng(timesteps)
    program = random_convolutions(rng, neurons, chip("speck2f", delay=1), Convention(1e-3))
    ours, theirs = (Machine(program, 2, backend=b) for b in ("numba", "interpreter"))
    raster = rasters(program, 2, timesteps, 0.5, seed=0)[0]
    for step in range(timesteps):
        np.testing.assert_array_equal(ours.step(raster[:, step]), theirs.step(raster[:, step]))
        for name, membrane in theirs.membrane.items():
            np.testing.assert_array_equal(ours.membrane[name], membrane)
    np.testing.assert_array_equal(ours.ledger.counts, theirs.ledger.counts)


def test_the_kernels_know_every_rule():
    # a new rule changes what a chip computes: teach the kernels, or let the backend refuse it
    at_compile_time = {
        "weight_bits", "signs", "axon_types", "bias_bits", "leak_bits", "floors", "threshold_bits",
        "scaling", "rounding",
    }  # fmt: skip
    in_the_kernels = {
        "leak", "leak_order", "membrane", "floor", "adds", "checks", "fires", "spikes_max",
        "reset_at",
    }  # fmt: skip
    refused = {"queue", "queue_entries", "host", "event_order", "event_spikes"}
    assert {f.name for f in fields(IntegrateAndFireRules)} == (
        at_compile_time | in_the_kernels | refused
    )
    assert set(kernels.OVERFLOWS) == set(OVERFLOWS)


def test_a_queue_on_the_chip_is_refused_and_auto_interprets():
    rng = np.random.default_rng(0)
    layer = neurons(rng, "layer", 3, [Synapses("input", np.ones((2, 3), np.int16), 0)])
    program = Program(
        chip("odin", queue="on"), Convention(1e-3), "input", 2, (layer,), "layer", None
    )
    with pytest.raises(ConfigError, match="supported by interpreter alone"):
        backend_class(program, "numba")
    assert backend_class(program, "auto").__name__ == "InterpreterBackend"
