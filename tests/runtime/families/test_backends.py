"""Every backend of every family equals the interpreter in all states, spikes and counts.

A family is a strategy of programs that its backends know: any combination of rules, registers that
overflow within a few timesteps, loops, skips and delays, matrices and the kernels of convolutions.
"""

from dataclasses import fields, replace
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.chips.registers import OVERFLOWS, Register
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.backend import backend_class
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.integrate_and_fire.neurons import IntegrateAndFireRules
from tests.equality import check_equal, check_like_the_interpreter, runs
from tests.networks import popsan
from tests.programs import random_convolutions, random_neurons, random_programs, rasters
from tests.xylo_networks import random_cores, random_networks

compiled = pytest.mark.skipif(
    find_spec("numba") is None, reason="numba is not installed (pip install '.[fast]')"
)
seeds = st.integers(0, 2**32 - 1)


@st.composite
def convolved(draw, programs, make_layer=random_neurons):
    """Kernels of convolutions, on chips and by conventions of these programs."""
    program, rng = draw(programs), np.random.default_rng(draw(seeds))
    delay, loop = draw(st.sampled_from([(1, True), (1, False), (0, False)]))
    delay = min(delay, program.chip.delay_max)
    return random_convolutions(
        rng, make_layer, program.chip, program.convention, max(delay, loop), loop
    )


# CuBa-LIF neurons in integers


def known(program):
    """The program with registers that the compiled kernels know."""
    fixed = program.chip.arithmetic
    overflow = "clip" if fixed.membrane.overflow == "saturate" else fixed.membrane.overflow
    membrane = Register(fixed.membrane.bits, overflow)
    plain = replace(fixed, push=Register(24, "none"), membrane=membrane)
    return replace(program, chip=replace(program.chip, arithmetic=plain))


@st.composite
def resets(draw, programs):
    """No chip of integers subtracts yet, but the specification says what would happen."""
    program, reset = draw(programs), draw(st.sampled_from(["zero", "subtract"]))
    return replace(program, convention=replace(program.convention, reset=reset))


compilable = resets(random_programs().map(known))


@st.composite
def free_widths(draw):
    """Chips of any width, and programs whose numbers a few bits hold."""
    mixed, overflows = draw(st.booleans()), st.sampled_from(["clip", "wrap"])
    register = st.builds(Register, st.integers(10, 36), overflows)
    datasheet = chip(
        "int",
        weight_bits=draw(st.integers(2, 16) if mixed else st.integers(1, 15)),
        sign_mode="mixed" if mixed else "split",
        decay_bits=draw(st.integers(1, 16)),
        mantissa_shift=draw(st.integers(0, 4)),
        threshold_bits=draw(st.integers(4, 20)),
        accumulator=draw(register),
        current=draw(register),
        membrane=draw(register),
        refractory=draw(st.sampled_from([1, 1, 2])),
    )
    program, one = draw(resets(random_programs())), datasheet.arithmetic.decay_one

    def shorter(decays):
        return decays * one // 4096

    layers = tuple(
        replace(a, current_decay=shorter(a.current_decay), membrane_decay=shorter(a.membrane_decay))
        for a in program.layers
    )
    return replace(program, chip=replace(datasheet, delay_max=15), layers=layers)


# CuBa-LIF neurons in float32


def neurons_in_float32(rng, name, size, synapses, start=0):
    """A layer whose numbers are about as large as its weights."""
    single = len(synapses) == 1  # of several, biases are added in an order of their own
    return Layer(
        name=name,
        synapses=tuple(synapses),
        bias=(single * rng.normal(size=size) * rng.integers(0, 2)).astype(np.float32),
        voltage_bias=(rng.normal(size=size) * rng.integers(0, 2)).astype(np.float32),
        threshold=rng.uniform(0, 60, size).astype(np.float32),
        current_decay=(rng.random(size) * rng.integers(0, 2)).astype(np.float32),
        membrane_decay=rng.random(size).astype(np.float32),
        scale=1.0,
        start=start,
    )


@st.composite
def spinnaker2(draw):
    reset, state = draw(st.sampled_from(["zero", "subtract"])), draw(st.sampled_from(STATES))
    program = draw(random_programs())
    return replace(
        program, chip=chip("spinnaker2-lif"), convention=Convention(1e-3, reset, state=state)
    )


STATES = ["reset", "kept"]


# integrate-and-fire neurons


@st.composite
def fire_chips(draw):
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
    membrane = Register(draw(st.sampled_from([8, 16])), draw(st.sampled_from(OVERFLOWS)))
    datasheet = chip("speck2f")
    arithmetic = replace(datasheet.arithmetic, event_order="none", membrane=membrane, **rules)
    return replace(datasheet, arithmetic=arithmetic, delay_max=15)


@st.composite
def conventions(draw):
    return Convention(
        1e-3,
        reset=draw(st.sampled_from(["zero", "subtract"])),
        state=draw(st.sampled_from(STATES)),
        spikes=draw(st.sampled_from(["above", "many"])),
        floor=draw(st.sampled_from(["none", "zero", "threshold"])),
    )


def fire_neurons(rng, name, size, synapses, start=0):
    """A layer of numbers of any size, some of them 0."""
    return Layer(
        name=name,
        synapses=tuple(synapses),
        bias=rng.integers(-20, 21, size) * rng.integers(0, 2),
        voltage_bias=rng.integers(-20, 21, size) * rng.integers(0, 2),
        threshold=rng.integers(0, 60, size) if rng.random() < 0.7 else np.full(size, 30),
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
def fire_programs(draw):
    """Matrices between layers, loops, skips and delays included."""
    rng = np.random.default_rng(draw(seeds))
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
        layers.append(fire_neurons(rng, name, size, synapses, k * staggered))
    return Program(
        draw(fire_chips()), draw(conventions()), "input", sizes[0], tuple(layers), names[-1], None
    )


# Xylo


@st.composite
def xylo(draw):
    """Programs without second currents and aliases, which the interpreter alone knows."""
    program, _ = draw(random_cores())
    layers = tuple(
        replace(
            layer,
            synapses=tuple(s for s in layer.synapses if not s.current),
            current_decay=layer.current_decay[:1],
            aliases=(),
        )
        for layer in program.layers
    )
    convention = replace(program.convention, state=draw(st.sampled_from(STATES)))
    return replace(program, layers=layers, convention=convention)


# family -> its programs, and how many are tried
FAMILIES = {
    ("numpy", "cuba"): (random_programs(), 50),
    ("numpy", "cuba, kernels"): (convolved(random_programs()), 25),
    ("numpy", "free widths"): (free_widths(), 25),
    ("numba", "cuba"): (compilable, 50),
    ("numba", "cuba, kernels"): (convolved(compilable), 30),
    ("numba", "free widths"): (free_widths(), 25),
    ("numba", "float32, kernels"): (convolved(spinnaker2(), neurons_in_float32), 25),
    ("numba", "integrate and fire"): (fire_programs().map(leaky), 50),
    ("numba", "integrate and fire, kernels"): (
        convolved(fire_programs(), fire_neurons).map(leaky),
        30,
    ),
    ("numba", "xylo"): (xylo(), 30),
}


@pytest.mark.parametrize(("backend", "family"), FAMILIES)
def test_it_equals_the_interpreter_in_every_current_membrane_spike_and_count(backend, family):
    if backend == "numba" and find_spec("numba") is None:
        pytest.skip("numba is not installed (pip install '.[fast]')")
    programs, examples = FAMILIES[backend, family]

    @settings(max_examples=examples)
    @given(programs, runs)
    def equal(program, run):
        check_like_the_interpreter(program, run, backend)

    equal()


@compiled
@settings(max_examples=12)
@given(convolved(compilable), runs)
def test_kernels_of_convolutions_equal_their_matrices(program, run):
    raster = rasters(program, *run)[0]
    ours, listed = (
        Machine(each, run[0], trace=True, backend="numba") for each in (program, program.dense())
    )
    np.testing.assert_array_equal(ours.infer(raster), listed.infer(raster))
    check_equal(ours.recordings, listed.recordings)
    np.testing.assert_array_equal(ours.ledger.counts, listed.ledger.counts)


@compiled
@settings(max_examples=12)
@given(random_networks(), runs)
def test_networks_that_are_compiled_for_xylo_do_too(artifact, run):
    program = compile_program(artifact, chip("xylo-a2"), limits=False)
    ours, theirs = (Machine(program, run[0], "each", True, b) for b in ("numba", "interpreter"))
    for raster in rasters(program, *run, inferences=2):
        np.testing.assert_array_equal(ours.infer(raster), theirs.infer(raster))
        check_equal(ours.recordings, theirs.recordings)
    np.testing.assert_array_equal(ours.ledger.counts, theirs.ledger.counts)


@compiled
@settings(max_examples=12)
@given(xylo(), seeds)
def test_up_to_15_events_of_an_axon_in_a_timestep_do_too(program, seed):
    counts = np.random.default_rng(seed).integers(0, 16, (2, 9, program.width)).astype(np.uint8)
    machine = Machine(program, 2, trace=True, backend="numba")
    machine.infer(counts)
    check_equal(machine.recordings, trace(program, counts))


@compiled
@pytest.mark.parametrize("timesteps", [1, 6])
def test_single_timesteps_of_the_chip_equal_the_interpreter(timesteps):
    rng = np.random.default_rng(timesteps)
    program = random_convolutions(rng, fire_neurons, chip("speck2f", delay=1), Convention(1e-3))
    ours, theirs = (Machine(program, 2, backend=b) for b in ("numba", "interpreter"))
    raster = rasters(program, 2, timesteps, 0.5, seed=0)[0]
    for step in range(timesteps):
        np.testing.assert_array_equal(ours.step(raster[:, step]), theirs.step(raster[:, step]))
        for name, membrane in theirs.membrane.items():
            np.testing.assert_array_equal(ours.membrane[name], membrane)
    np.testing.assert_array_equal(ours.ledger.counts, theirs.ledger.counts)


def biased_twice():
    """A bias in float32 beside the spikes of two sources."""
    rng, used = np.random.default_rng(0), chip("spinnaker2")
    program = random_convolutions(rng, neurons_in_float32, used, Convention(1e-3), 1, loop=True)
    last = replace(program.layers[-1], bias=np.ones(program.layers[-1].size, np.float32))
    return replace(program, layers=(*program.layers[:-1], last))


def negative_exponent():
    """A negative weight exponent, by which sums are rounded."""
    program = compile_program(popsan(), chip("loihi1"))
    first, *others = program.layers
    shifted = replace(first, synapses=(replace(first.synapses[0], shift=1),))
    return replace(program, layers=(shifted, *others))


def queue():
    """A queue of spikes on the chip."""
    synapses = [Synapses("input", np.ones((2, 3), np.int16), 0)]
    layer = fire_neurons(np.random.default_rng(0), "layer", 3, synapses)
    on = chip("odin", queue="on")
    return Program(on, Convention(1e-3), "input", 2, (layer,), "layer", None)


def two_currents():
    """Xylo's second current."""
    return random_cores().filter(lambda core: len(core[0].layers[0].current_decay) > 1).example()[0]


@pytest.mark.filterwarnings("ignore::hypothesis.errors.NonInteractiveExampleWarning")
@compiled
@pytest.mark.parametrize(
    ("build", "said"),
    [
        (biased_twice, "one after another"),
        (queue, "supported by interpreter alone"),
        (two_currents, "several currents"),
        (negative_exponent, "a negative exponent"),
    ],
)
def test_what_no_kernel_knows_is_refused_and_auto_interprets(build, said):
    program = build()
    assert backend_class(program, "auto").__name__ == "InterpreterBackend"
    with pytest.raises(ConfigError, match=said):
        backend_class(program, "numba")


def test_the_kernels_know_every_rule_of_integrate_and_fire_neurons():
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
    known_rules = at_compile_time | in_the_kernels | refused
    assert {f.name for f in fields(IntegrateAndFireRules)} == known_rules
