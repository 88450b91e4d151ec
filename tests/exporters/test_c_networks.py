"""Generated networks in C equal the interpreter in every current, membrane and spike."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from spikedeploy.exporters.c.to_c import network_in_c
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.convolution import Window
from spikedeploy.runtime.chips.layer import Layer, Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError
from tests.c_builds import LOIHI, SANITIZED, check_network, needs_c
from tests.programs import random_convolutions, random_programs

# each example is compiled
FEW = settings(
    max_examples=8,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.filter_too_much],
)


@needs_c
@FEW
@given(random_programs(), st.sampled_from(["zero", "subtract"]), st.integers(1, 5))
def test_cuba_networks_equal_the_interpreter(tmp_path_factory, program, reset, timesteps):
    program = replace(program, convention=replace(program.convention, reset=reset))
    try:
        network_in_c(program, np.ones((1, 1, program.width), np.uint8), "")
    except ConfigError:  # nothing bounds its states; a test below has that
        assume(False)
    check_network(program, tmp_path_factory.mktemp("c"), timesteps)


def delayed(seed, longest=4):
    """A loop of three layers with synapses of several delays, refractory periods and biases."""
    rng = np.random.default_rng(seed)
    sizes = {"input": 9, "a": 20, "b": 300, "c": 7}
    wires = {"a": ["input", "a", "c"], "b": ["a", "input", "b"], "c": ["b", "input", "a"]}
    layers = []
    for name, sources in wires.items():
        synapses = []
        for source in sources:
            weight = rng.integers(-255, 256, (sizes[source], sizes[name]))
            weight *= rng.random(weight.shape) < rng.choice([0.1, 1.0])
            synapses.append(
                Synapses(source, weight.astype(np.int16), int(rng.integers(1, longest)))
            )
        size = sizes[name]
        layers.append(
            Layer(
                name=name,
                synapses=tuple(synapses),
                bias=rng.integers(-200, 200, size) * rng.integers(0, 2),
                voltage_bias=rng.integers(-9000, 9000, size),
                threshold=rng.integers(50, 3000, size) << 6,
                current_decay=rng.integers(0, 4097, size),
                membrane_decay=rng.integers(0, 4097, size),
                scale=1.0,
                start=0,
            )
        )
    datasheet = chip("loihi1", refractory=int(rng.integers(1, 4)))
    convention = Convention(1e-3, state="kept" if seed % 2 else "reset")
    return Program(datasheet, convention, "input", 9, tuple(layers), "c", None)


@needs_c
@pytest.mark.parametrize("seed", range(2))
def test_delays_loops_and_refractory_periods_equal_the_interpreter(tmp_path, seed):
    flags = SANITIZED if seed == 0 else ()
    check_network(delayed(seed), tmp_path, timesteps=7, seed=seed, flags=flags)


# arithmetic, options, conventions
FAMILIES = [
    ("truenorth", {}, {}),
    ("truenorth", {"leak_order": "first", "fires": "above"}, {"reset": "subtract"}),
    ("truenorth", {"leak": "linear"}, {"floor": "zero"}),
    ("truenorth", {"membrane": Register(12, "wrap")}, {"floor": "threshold"}),
    ("odin", {}, {}),
    ("odin", {"spikes_max": 1}, {}),
    ("odin", {"checks": "step"}, {"reset": "subtract"}),
    ("odin", {"leak_order": "last"}, {}),
    ("speck2f", {}, {"reset": "subtract"}),
    ("speck2f", {"membrane": Register(9, "clip")}, {"reset": "subtract", "floor": "threshold"}),
    ("spiker", {}, {}),
    ("spiker", {}, {"reset": "subtract"}),
    ("spiker", {"leak_order": "last", "reset_at": "spike"}, {"reset": "subtract"}),
    ("tinyodin", {}, {}),
]


def integrate(name, options, convention, seed):
    """A loop of two layers of integrate-and-fire neurons."""
    rng = np.random.default_rng(seed)
    datasheet = chip(name, **options)
    rules = datasheet.arithmetic
    low, high = rules.weight_range
    most = rules.threshold_max
    layers = []
    for size, target, wires in (
        (11, "a", [("input", 8, 0), ("b", 30, 1)]),
        (30, "b", [("a", 11, 0)]),
    ):
        leak = rng.integers(-1 if rules.leak == "shift" else 0, 6, size)
        bias = rng.integers(low, high + 1, size) * rng.integers(0, 2)
        synapses = []
        for source, fan_in, lag in wires:
            weight = rng.integers(low, high + 1, (fan_in, size)) * (
                rng.random((fan_in, size)) < 0.6
            )
            delay = lag + (datasheet.delay if lag == 0 else 0)
            synapses.append(Synapses(source, weight.astype(np.int16), max(delay, lag)))
        layers.append(
            Layer(
                name=target,
                synapses=tuple(synapses),
                bias=bias,
                voltage_bias=0 * bias,
                threshold=rng.integers(0, max(2, min(most, 4 * high)), size),
                current_decay=0 * leak,
                membrane_decay=leak * (rules.leak != "none"),
                scale=1.0,
                start=0,
            )
        )
    agreed = Convention(1e-3, state="kept" if seed % 2 else "reset", **convention)
    return Program(datasheet, agreed, "input", 8, tuple(layers), "b", None)


@needs_c
@pytest.mark.parametrize(("name", "options", "convention"), FAMILIES)
def test_integrate_and_fire_networks_equal_the_interpreter(tmp_path, name, options, convention):
    seed = len(name) + len(options)
    program = integrate(name, options, convention, seed)
    check_network(program, tmp_path, timesteps=4, inferences=2, seed=seed)


def neurons(rng, name, size, synapses):
    """Neurons of numbers that integrators and CuBa-LIF neurons of Loihi both hold."""
    return Layer(
        name=name,
        synapses=tuple(synapses),
        bias=rng.integers(-9, 10, 1).repeat(size) * rng.integers(0, 2),
        voltage_bias=np.zeros(size, np.int64),
        threshold=rng.integers(1, 40, size) << rng.choice([0, 6]),
        current_decay=np.zeros(size, np.int64),
        membrane_decay=np.zeros(size, np.int64),
        scale=1.0,
        start=0,
    )


@needs_c
@pytest.mark.parametrize(
    ("name", "options", "seed"),
    [
        ("loihi1", {}, 0),
        ("loihi1", {}, 1),
        ("speck2f", {}, 2),
        ("speck2f", {"adds": "event", "checks": "event"}, 0),
        ("speck2f", {"adds": "event", "spikes_max": 1, "floor": -30}, 1),
    ],
)
def test_convolutions_equal_the_interpreter(tmp_path, name, options, seed):
    rng, datasheet = np.random.default_rng(seed), chip(name, **options)
    convention = Convention(1e-3, "subtract", state="kept")
    program = random_convolutions(rng, neurons, datasheet, convention, datasheet.delay)
    flags = SANITIZED if seed == 0 else ()
    check_network(program, tmp_path, timesteps=3, inferences=2, seed=seed, flags=flags)


def test_a_convolution_is_written_as_its_kernel_and_a_bias_of_each_channel():
    rng, window = np.random.default_rng(0), Window((2, 32, 32), (8, 16, 16), (3, 3), stride=(2, 2))
    kernel = rng.integers(-9, 10, (8, 2, 3, 3)).astype(np.int16)
    layer = neurons(rng, "one", 8 * 256, [Synapses("input", kernel, 1, window=window)])
    layer = replace(layer, bias=np.arange(8).repeat(256), threshold=np.full(2048, 9))
    program = Program(LOIHI, Convention(1e-3), "input", 2048, (layer,), "one", None)
    files = network_in_c(program, np.ones((1, 1, 2048), np.uint8), "")
    assert files.costs.rom == kernel.size + 8


@needs_c
def test_numbers_of_64_bits_equal_the_interpreter(tmp_path):
    wide = chip("int", membrane=Register(36, "clip"), current=Register(36, "wrap"))
    program = replace(delayed(5), chip=wide)
    layers = [replace(layer, threshold=layer.threshold << 8) for layer in program.layers]
    program = replace(program, layers=tuple(layers))
    raster = np.ones((1, 2, 9), np.uint8)
    assert "typedef int64_t" in network_in_c(program, raster, "").text["policy.h"]
    check_network(program, tmp_path, timesteps=8)


def test_states_that_nothing_bounds_are_refused():
    program = delayed(1)
    kept = np.full(300, 4096)
    layers = [replace(a, current_decay=kept[: a.size]) for a in program.layers]
    free = chip("loihi1", current=Register(24, "none"))
    with pytest.raises(ConfigError, match="nothing bounds its states"):
        network_in_c(
            replace(program, chip=free, layers=tuple(layers)), np.ones((1, 1, 9), np.uint8), ""
        )


@pytest.mark.parametrize("name", ["ideal", "xylo-a2", "spinnaker2"])
def test_an_arithmetic_that_is_not_written_in_c_is_refused(name):
    program = replace(delayed(1, longest=2), chip=chip(name))
    with pytest.raises(ConfigError, match="rule arithmetic"):
        network_in_c(program, np.ones((1, 1, 9), np.uint8), "")
