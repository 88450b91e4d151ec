"""The 16-bit interface in C equals its integer specification; 8-bit networks in C equal theirs."""

import ctypes
import json
import shutil
import subprocess

import numpy as np
import pytest
import yaml

from spikedeploy import zoo
from spikedeploy.exporters.c.int8 import FloatMlp, Int8Mlp, mlp_in_c, quantise, read_onnx
from spikedeploy.exporters.c.int16 import ONE, Int16Observations, Int16Player, int16_codec, tanh_q15
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.c.to_c import policy_in_c, write, write_texts
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.codec import Normaliser
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.errors import ConfigError, ObservationError
from tests.c_builds import COMPILERS, STRICT, needs_c
from tests.exporters.test_c_policies import onto_readouts, walk
from tests.networks import event_driven, popsan

LOIHI = chip("loihi1")
SPARSE = [name for name in zoo.names() if name.endswith("/sparse")]
DENSE = ["hexapod/mlp-8", "hexapod/linear", "kart-grid/linear", "kart-grid/small"]
SANITIZER = ("-g", "-fsanitize=undefined", "-fno-sanitize-recover=all")
ARM = shutil.which("arm-none-eabi-gcc")
CMAKE = shutil.which("cmake")


def library(folder, *sources):
    """A shared object of sources of an export, which UBSan stops where something is undefined."""
    words = [COMPILERS[0], *STRICT, *SANITIZER, "-O1", "-fPIC", "-shared", "-o", "lib.so"]
    subprocess.run([*words, *sources, "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "lib.so"))


def acted(loaded, row, actions):
    """The action of policy_act_i16."""
    found = np.zeros(actions, np.int16)
    given = np.ascontiguousarray(row, np.int16)
    pointers = (each.ctypes.data_as(ctypes.c_void_p) for each in (given, found))
    loaded.policy_act_i16(*pointers)
    return found


class View(ctypes.Structure):
    """policy_layer_t of an export with 32-bit states."""

    _fields_ = [
        ("current", ctypes.POINTER(ctypes.c_int32)),
        ("membrane", ctypes.POINTER(ctypes.c_int32)),
        ("id", ctypes.c_void_p),
        ("times", ctypes.c_void_p),
        ("count", ctypes.c_uint32),
        ("size", ctypes.c_uint32),
    ]


def membranes(loaded, layer):
    """Membranes of a layer after the last step."""
    view = View()
    loaded.policy_net_layer(ctypes.c_uint32(layer), ctypes.c_uint32(0), ctypes.byref(view))
    return np.array(view.membrane[: view.size])


def any_rows(codec, steps=60, seed=0):
    """16-bit observations of a walk, then some that jump anywhere in 16 bits."""
    rows = codec.observations.quantise(walk_of(codec, steps, seed))
    rng = np.random.default_rng(seed)
    wild = rng.integers(-(2**15), 2**15, (steps // 2, rows.shape[1]))
    return np.concatenate([rows, wild, rows[:5]])


def walk_of(codec, steps, seed):
    """Numbers in units of training that drift within the range of the observations."""
    scales, rng = codec.observations, np.random.default_rng(seed)
    low, high = scales.low / 2.0**scales.exponent, scales.high / 2.0**scales.exponent
    drift = np.cumsum(0.05 * rng.normal(size=(steps, len(low))), axis=0)
    return (low + high) / 2 + (high - low) / 2 * np.clip(drift, -1.2, 1.2)


def check_int16(artifact, folder):
    """C and specification agree in every action and membrane."""
    program = compile_program(artifact, LOIHI, clock=own_clock(artifact.convention))
    codec = int16_codec(Plan(program, artifact.codec))
    write(policy_in_c(program, artifact.codec, walk(artifact.codec, 12), ""), folder)
    loaded = library(folder, "policy.c", "codec_i16.c")
    for seed in (0, 1):
        player = Int16Player(program, codec)
        loaded.policy_reset_i16()
        moved = 0
        for row in any_rows(codec, seed=seed):
            wanted = player.act(row)
            np.testing.assert_array_equal(acted(loaded, row, codec.actions), wanted)
            for k, layer in enumerate(program.layers):
                np.testing.assert_array_equal(membranes(loaded, k), player.states[layer.name])
                moved += int(np.abs(player.states[layer.name]).max() > 0)
        assert moved > 0


@needs_c
@pytest.mark.parametrize("name", SPARSE)
def test_shipped_policies_in_16_bits_equal_their_specification(tmp_path, name):
    check_int16(load(zoo.path(name)), tmp_path)


@needs_c
@pytest.mark.parametrize("kind", ["same", "second", "two layers", "only"])
def test_every_readout_in_16_bits_equals_its_specification(tmp_path, kind):
    check_int16(onto_readouts(kind), tmp_path)


@needs_c
def test_unary_events_and_spikes_in_16_bits_equal_their_specification(tmp_path):
    check_int16(event_driven(), tmp_path)


@needs_c
@pytest.mark.parametrize("name", SPARSE[:1])
def test_recorded_observations_give_nearly_the_actions_of_doubles(tmp_path, name):
    artifact = load(zoo.path(name))
    program = compile_program(artifact, LOIHI, clock=own_clock(artifact.convention))
    seen = walk(artifact.codec, 100)
    write(policy_in_c(program, artifact.codec, seen, ""), tmp_path)
    loaded = library(tmp_path, "policy.c", "codec_i16.c", "codec.c")
    codec = int16_codec(Plan(program, artifact.codec))
    loaded.policy_reset()
    wanted = []
    for row in np.ascontiguousarray(seen):
        action = np.zeros(codec.actions)
        pointers = (each.ctypes.data_as(ctypes.c_void_p) for each in (row, action))
        assert loaded.policy_step(*pointers) == 0
        wanted.append(action)
    loaded.policy_reset_i16()
    rows = codec.observations.quantise(seen)
    found = codec.floats(np.array([acted(loaded, row, codec.actions) for row in rows]))
    # one event more or less moves an action; most steps have none
    assert np.median(np.abs(found - wanted)) < 1e-3


def test_the_table_of_tanh_is_within_five_units_of_q15():
    score = np.arange(-(2**20), 2**20, 37)
    found = tanh_q15(score, 17)
    assert np.abs(found - ONE * np.tanh(score / 2**17)).max() <= 5
    assert (found == -tanh_q15(-score, 17)).all()


def test_observations_are_rounded_to_even_and_kept_in_the_range_of_training():
    scales = Int16Observations.of(Normaliser(np.array([0.0, 10.0]), np.array([1.0, 0.5]), 4.0))
    assert scales.exponent.tolist() == [12, 11]
    assert scales.quantise(np.array([[2.5 / 4096, 99.0], [-5.0, 8.0]])).tolist() == [
        [2, 24576],
        [-16384, 16384],
    ]
    with pytest.raises(ObservationError, match="not finite"):
        scales.quantise(np.array([np.nan, 0.0]))


@pytest.mark.parametrize("std", [1e-60, 1e60])
def test_a_range_that_no_power_of_two_brings_into_16_bits_is_refused(std):
    with pytest.raises(ConfigError, match="observation 0 reaches"):
        Int16Observations.of(Normaliser(np.zeros(1), np.array([std]), 4.0))


@pytest.mark.parametrize(
    ("artifact", "why"),
    [(popsan(), "delta codes"), (event_driven(timesteps=3), "one timestep")],
)
def test_policies_without_a_16_bit_interface_say_why(artifact, why):
    program = compile_program(artifact, LOIHI, clock=own_clock(artifact.convention))
    files = policy_in_c(program, artifact.codec, walk(artifact.codec, 12), "")
    assert why in files.without_int16
    assert not any("i16" in name for name in files.text)
    assert json.loads(files.text["interface.json"])["int16"] is None


# ------------------------------------------------------------------------------------------------


def pruned(seed=0, hidden="tanh"):
    """A network most of whose weights are 0, with a hidden layer of this activation."""
    rng = np.random.default_rng(seed)
    weights = [rng.normal(size=shape) * (rng.random(shape) < 0.3) for shape in ((9, 12), (12, 3))]
    return FloatMlp(
        Normaliser(rng.normal(size=9), rng.uniform(0.1, 2, 9), 4.0),
        tuple(weights),
        (rng.normal(size=12), rng.normal(size=3)),
        (hidden, "tanh"),
        False,
    )


def check_dense(network: Int8Mlp, folder):
    """C of a network equals its specification on a walk, and on anything in 16 bits."""
    rows = any_rows(network)
    files = mlp_in_c(network, rows[:20] / 2.0**network.observations.exponent, "a test")
    write_texts(files.text, folder)
    loaded = library(folder, "policy.c", "host_i16.c")
    found = np.array([acted(loaded, row, network.actions) for row in rows])
    np.testing.assert_array_equal(found, network.act(rows))
    assert len(np.unique(found)) > 1


@needs_c
@pytest.mark.parametrize("name", DENSE)
def test_shipped_networks_in_8_bits_equal_their_specification(tmp_path, name):
    check_dense(quantise(read_onnx(zoo.path(name))), tmp_path)


@needs_c
@pytest.mark.parametrize("hidden", ["tanh", "relu"])
def test_pruned_networks_in_8_bits_equal_their_specification(tmp_path, hidden):
    check_dense(quantise(pruned(hidden=hidden)), tmp_path)


@needs_c
def test_a_large_pruned_network_is_lists_and_equals_its_specification(tmp_path):
    rng = np.random.default_rng(3)
    shapes = ((30, 500), (500, 4))
    network = FloatMlp(
        Normaliser(np.zeros(30), np.ones(30), 4.0),
        tuple(rng.normal(size=s) * (rng.random(s) < 0.4) for s in shapes),
        (np.zeros(500), np.zeros(4)),
        ("relu", "none"),
        True,
    )
    check_dense(quantise(network), tmp_path)
    assert "source0" in (tmp_path / "policy.c").read_text()


@pytest.mark.parametrize("name", DENSE)
def test_8_bit_weights_move_actions_little(name):
    controller = OnnxController(zoo.path(name))
    network = quantise(read_onnx(zoo.path(name)))
    seen = walk_of(network, 200, 0)
    scales = network.observations
    seen = np.clip(seen, scales.low / 2.0**scales.exponent, scales.high / 2.0**scales.exponent)
    found = network.floats(network.act(scales.quantise(seen)))
    apart = np.abs(found - np.asarray(controller.replay(seen)).reshape(found.shape))
    assert (apart > 0).mean() < 0.05 if network.chooses else np.quantile(apart, 0.99) < 0.1


def test_weights_are_8_bits_and_sums_fit_in_32():
    for network in map(quantise, [pruned(1), *(read_onnx(zoo.path(name)) for name in DENSE)]):
        largest = np.full(len(network.layers[0].shift), 2**15)
        for layer in network.layers:
            assert np.abs(layer.weight).max() <= 127
            reached = np.abs(layer.bias) + largest @ np.abs(layer.factors)
            assert reached.max() < 2**31
            relu = layer.activation == "relu"
            largest = reached >> layer.drop if relu else np.full(len(reached), 2**15)
            assert largest.max() <= 2**15 or not relu


def test_networks_that_are_more_than_layers_are_refused():
    with pytest.raises(ConfigError, match=r"fourier\.onnx computes Gather"):
        read_onnx(zoo.path("hexapod/fourier"))


# ------------------------------------------------------------------------------------------------


def exported(kind, folder):
    """The files of a spiking or dense policy, written."""
    if kind == "dense":
        network = quantise(read_onnx(zoo.path("kart-grid/linear")))
        rows = walk_of(network, 20, 0)
        text = mlp_in_c(network, rows, "a test").text
        write_texts(text, folder)
        return text
    artifact = popsan() if kind == "population" else event_driven()
    files = policy_in_c(
        compile_program(artifact, LOIHI, clock=own_clock(artifact.convention)),
        artifact.codec,
        walk(artifact.codec),
        "",
    )
    write(files, folder)
    return files.text


KINDS = ("delta", "population", "dense")


def sources(text):
    """The C files that are no test and no example."""
    return {n for n in text if n.endswith(".c") and "selftest" not in n and n != "cycles.c"}


@pytest.mark.parametrize("kind", KINDS)
def test_zephyr_and_cmsis_list_every_source(tmp_path, kind):
    text = exported(kind, tmp_path)
    module = yaml.safe_load(text["zephyr/module.yml"])
    assert module["build"] == {"cmake": "zephyr", "kconfig": "zephyr/Kconfig"}
    assert all(f"/{name})" in text["zephyr/CMakeLists.txt"] for name in sources(text))
    layer = yaml.safe_load(text["policy.clayer.yml"])["layer"]
    (group,) = layer["groups"]
    assert {each["file"] for each in group["files"]} == sources(text)
    assert all(name in text["README.md"] for name in sources(text))
    options = {line.split()[1] for line in text["zephyr/Kconfig"].splitlines() if "config " in line}
    used = set(text["zephyr/CMakeLists.txt"].replace("(", " ").replace(")", " ").split())
    assert {f"CONFIG_{name}" for name in options} <= used


@needs_c
@pytest.mark.skipif(not CMAKE, reason="cmake is not installed")
@pytest.mark.parametrize("kind", KINDS)
def test_the_zephyr_module_builds_with_every_option(tmp_path, kind):
    text = exported(kind, tmp_path / "policy")
    (tmp_path / "CMakeLists.txt").write_text(ZEPHYR)
    build = tmp_path / "build"
    words = [CMAKE, "-S", str(tmp_path), "-B", str(build), f"-DCMAKE_C_COMPILER={COMPILERS[0]}"]
    options = {line.split()[1] for line in text["zephyr/Kconfig"].splitlines() if "config " in line}
    given = [f"-DCONFIG_{name}=y" for name in options]
    for command in ([*words, *given], [CMAKE, "--build", str(build)]):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    built = {path.name.removesuffix(".o") for path in build.rglob("*.o")}
    assert built == sources(text)


# the functions of Zephyr that the module calls
ZEPHYR = """
cmake_minimum_required(VERSION 3.20)
project(test C)
macro(zephyr_library_named name)
  set(current ${name})
  add_library(${name} STATIC)
endmacro()
macro(zephyr_library_sources)
  target_sources(${current} PRIVATE ${ARGN})
endmacro()
macro(zephyr_library_compile_options)
  target_compile_options(${current} PRIVATE ${ARGN})
endmacro()
macro(zephyr_include_directories)
  include_directories(${ARGN})
endmacro()
add_subdirectory(policy/zephyr)
"""


@pytest.mark.skipif(not ARM, reason="arm-none-eabi-gcc is not installed")
@pytest.mark.parametrize("core", ["cortex-m0", "cortex-m3", "cortex-m4", "cortex-m33"])
def test_the_16_bit_interface_and_the_cycle_counter_compile_for_cores_without_a_library(
    tmp_path, core
):
    text = exported("delta", tmp_path)
    dense = tmp_path / "dense"
    exported("dense", dense)
    strict = [ARM, f"-mcpu={core}", "-mthumb", *STRICT, "-ffreestanding", "-O2", "-c"]
    for folder, names in ((tmp_path, ["policy.c", "codec_i16.c"]), (dense, ["policy.c"])):
        for name in [*names, "cycles.c"]:
            done = subprocess.run(
                [*strict, name], cwd=folder, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stderr
    assert "DWT" in text["cycles.h"]


def test_a_core_without_a_known_counter_is_an_error(tmp_path):
    exported("delta", tmp_path)
    done = subprocess.run(
        [COMPILERS[0], "-fsyntax-only", "cycles.c"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "no cycle counter is known" in done.stderr


@needs_c
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_no_number_is_refused_also_where_the_compiler_assumes_that_there_is_none(tmp_path, value):
    network = quantise(read_onnx(zoo.path(DENSE[0])))
    seen = any_rows(network)[:5] / 2.0**network.observations.exponent
    write_texts(mlp_in_c(network, seen, "a test").text, tmp_path)
    # -ffast-math itself would also make subnormal numbers 0 in this whole process
    words = [
        COMPILERS[0],
        *STRICT,
        "-O2",
        "-ffinite-math-only",
        "-fPIC",
        "-shared",
        "-o",
        "fast.so",
    ]
    subprocess.run([*words, "policy.c", "host_i16.c", "-lm"], cwd=tmp_path, check=True)
    loaded = ctypes.CDLL(str(tmp_path / "fast.so"))
    double = np.ctypeslib.ndpointer(np.float64)
    loaded.policy_to_i16.argtypes = [double, np.ctypeslib.ndpointer(np.int16)]
    found = np.zeros(len(seen[0]), np.int16)
    assert loaded.policy_to_i16(seen[0].copy(), found) == 0
    assert loaded.policy_to_i16(np.r_[value, seen[0][1:]], found) == 1
