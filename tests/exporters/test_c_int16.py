"""The 16-bit interface in C equals its integer specification; 8-bit networks in C equal theirs."""

import ctypes
import json
import shutil
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from spikedeploy import zoo
from spikedeploy.exporters.c.int8 import FloatMlp, Int8Mlp, quantise, read_onnx
from spikedeploy.exporters.c.int16 import (
    ONE,
    Int16Observations,
    Int16Player,
    action_as_floats,
    int16_codec,
    tanh_q15,
)
from spikedeploy.exporters.c.packaging import write_texts
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.c.to_c import mlp_in_c
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.codec.codec import Normaliser
from spikedeploy.runtime.errors import ConfigError, ObservationError
from tests.c_builds import COMPILERS, STRICT, called, library, needs_c, program_of, run, written
from tests.exporters.test_c_policies import onto_readouts, stepped, walk
from tests.networks import event_driven, popsan, with_last

SPARSE = [name for name in zoo.names() if name.endswith("/sparse")]
DENSE = ["hexapod/mlp-8", "hexapod/linear", "kart-grid/linear", "kart-grid/small"]
UNDEFINED = ("-g", "-fsanitize=undefined", "-fno-sanitize-recover=all")
ARM = shutil.which("arm-none-eabi-gcc")
CMAKE = shutil.which("cmake")


def acted(loaded, row, actions):
    """The action of policy_act_i16."""
    found = np.zeros(actions, np.int16)
    called(loaded.policy_act_i16, np.ascontiguousarray(row, np.int16), found)
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
    wild = np.random.default_rng(seed).integers(-(2**15), 2**15, (steps // 2, rows.shape[1]))
    return np.concatenate([rows, wild, rows[:5]])


def walk_of(codec, steps, seed):
    """Numbers in units of training that drift within the range of the observations."""
    scales, rng = codec.observations, np.random.default_rng(seed)
    low, high = scales.low / 2.0**scales.exponent, scales.high / 2.0**scales.exponent
    drift = np.cumsum(0.05 * rng.normal(size=(steps, len(low))), axis=0)
    return (low + high) / 2 + (high - low) / 2 * np.clip(drift, -1.2, 1.2)


READOUTS = ("same", "second", "two layers", "only")
SPIKING = {
    **{name: lambda name=name: load(zoo.path(name)) for name in SPARSE},
    **{kind: lambda kind=kind: onto_readouts(kind) for kind in READOUTS},
    "unary events and spikes": event_driven,
    "three timesteps": lambda: with_last(onto_readouts("same")),
    "three timesteps, late": lambda: with_last(onto_readouts("second", delay=1)),
    "three timesteps, spikes": lambda: with_last(event_driven()),
}


@needs_c
@pytest.mark.parametrize("name", SPIKING)
def test_spiking_policies_in_16_bits_equal_their_specification(tmp_path, name):
    artifact = SPIKING[name]()
    program = program_of(artifact)
    codec = int16_codec(Plan(program, artifact.codec))
    written(artifact, tmp_path, walk(artifact.codec, 12))
    loaded = library(tmp_path, "policy.c", "codec_i16.c", flags=UNDEFINED)
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
def test_recorded_observations_give_nearly_the_actions_of_doubles(tmp_path):
    artifact = load(zoo.path(SPARSE[0]))
    seen = walk(artifact.codec, 100)
    written(artifact, tmp_path, seen)
    loaded = library(tmp_path, "policy.c", "codec_i16.c", "codec.c")
    codec = int16_codec(Plan(program_of(artifact), artifact.codec))
    loaded.policy_reset()
    wanted = [stepped(loaded, row, codec.actions)[1] for row in seen]
    loaded.policy_reset_i16()
    rows = codec.observations.quantise(seen)
    acts = np.array([acted(loaded, row, codec.actions) for row in rows])
    found = action_as_floats(acts, codec.chooses)
    # one event more or less moves an action; most steps have none
    assert np.median(np.abs(found - wanted)) < 1e-3


def test_the_table_of_tanh_is_within_five_units_of_q15():
    score = np.arange(-(2**20), 2**20, 37)
    found = tanh_q15(score, 17)
    assert np.abs(found - ONE * np.tanh(score / 2**17)).max() <= 5
    assert (found == -tanh_q15(-score, 17)).all()


def test_observations_are_rounded_to_even_and_kept_in_the_range_of_training():
    scales = Int16Observations.from_normaliser(
        Normaliser(np.array([0.0, 10.0]), np.array([1.0, 0.5]), 4.0)
    )
    assert scales.exponent.tolist() == [12, 11]
    found = scales.quantise(np.array([[2.5 / 4096, 99.0], [-5.0, 8.0]]))
    assert found.tolist() == [[2, 24576], [-16384, 16384]]
    with pytest.raises(ObservationError, match="not finite"):
        scales.quantise(np.array([np.nan, 0.0]))


@pytest.mark.parametrize("std", [1e-60, 1e60])
def test_a_range_that_no_power_of_two_brings_into_16_bits_is_refused(std):
    with pytest.raises(ConfigError, match="observation 0 reaches"):
        Int16Observations.from_normaliser(Normaliser(np.zeros(1), np.array([std]), 4.0))


@pytest.mark.parametrize(
    ("artifact", "why"),
    [(popsan(), "delta codes"), (event_driven(timesteps=3), "last timestep")],
)
def test_policies_without_a_16_bit_interface_say_why(tmp_path, artifact, why):
    files = written(artifact, tmp_path, walk(artifact.codec, 12))
    assert why in files.without_int16
    assert not any("i16" in name for name in files.text)
    assert json.loads(files.text["interface.json"])["int16"] is None


# ------------------------------------------------------------------------------------------------


def pruned(shapes, part, activations, chooses=False):
    """A network most of whose weights are 0."""
    rng = np.random.default_rng(0)
    inputs = shapes[0][0]
    normaliser = Normaliser(rng.normal(size=inputs), rng.uniform(0.1, 2, inputs), 4.0)
    weights = tuple(rng.normal(size=shape) * (rng.random(shape) < part) for shape in shapes)
    biases = tuple(rng.normal(size=shape[1]) for shape in shapes)
    return FloatMlp(normaliser, weights, biases, activations, chooses)


SMALL = ((9, 12), (12, 3))
NETWORKS = {
    **{name: lambda name=name: read_onnx(zoo.path(name)) for name in DENSE},
    "pruned, tanh": lambda: pruned(SMALL, 0.3, ("tanh", "tanh")),
    "pruned, relu": lambda: pruned(SMALL, 0.3, ("relu", "tanh")),
    "large and pruned": lambda: pruned(((30, 500), (500, 4)), 0.4, ("relu", "none"), True),
}


def dense(network: Int8Mlp, observation, folder):
    """The C of a float network, written; the files by name."""
    texts = mlp_in_c(network, observation, "a test")
    write_texts(texts, folder)
    return SimpleNamespace(text=texts)


@needs_c
@pytest.mark.parametrize("name", NETWORKS)
def test_networks_in_8_bits_equal_their_specification(tmp_path, name):
    network = quantise(NETWORKS[name]())
    rows = any_rows(network)
    dense(network, rows[:20] / 2.0**network.observations.exponent, tmp_path)
    loaded = library(tmp_path, "policy.c", "host_i16.c", flags=UNDEFINED)
    found = np.array([acted(loaded, row, network.actions) for row in rows])
    np.testing.assert_array_equal(found, network.act(rows))
    assert len(np.unique(found)) > 1
    assert ("source0" in (tmp_path / "policy.c").read_text()) == name.startswith("large")


@pytest.mark.parametrize("name", NETWORKS)
def test_weights_are_8_bits_and_sums_fit_in_32(name):
    network = quantise(NETWORKS[name]())
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


@pytest.fixture(scope="module")
def exports(tmp_path_factory):
    """Folder and files of a policy of each kind that is packaged otherwise."""
    folders = {kind: tmp_path_factory.mktemp(kind) for kind in KINDS}
    network = quantise(read_onnx(zoo.path("kart-grid/linear")))
    files = {"dense": dense(network, walk_of(network, 20, 0), folders["dense"])}
    for kind, artifact in (("delta", event_driven()), ("population", popsan())):
        files[kind] = written(artifact, folders[kind], walk(artifact.codec))
    return {kind: (folders[kind], files[kind].text) for kind in KINDS}


KINDS = ("delta", "population", "dense")


def sources(text):
    """The C files that are no test and no example."""
    return {n for n in text if n.endswith(".c") and "selftest" not in n and n != "cycles.c"}


def options_of(text):
    return {line.split()[1] for line in text["zephyr/Kconfig"].splitlines() if "config " in line}


@pytest.mark.parametrize("kind", KINDS)
def test_zephyr_and_cmsis_list_every_source(exports, kind):
    _, text = exports[kind]
    module = yaml.safe_load(text["zephyr/module.yml"])
    assert module["build"] == {"cmake": "zephyr", "kconfig": "zephyr/Kconfig"}
    assert all(f"/{name})" in text["zephyr/CMakeLists.txt"] for name in sources(text))
    (group,) = yaml.safe_load(text["policy.clayer.yml"])["layer"]["groups"]
    assert {each["file"] for each in group["files"]} == sources(text)
    assert all(name in text["README.md"] for name in sources(text))
    used = set(text["zephyr/CMakeLists.txt"].replace("(", " ").replace(")", " ").split())
    assert {f"CONFIG_{name}" for name in options_of(text)} <= used


@needs_c
@pytest.mark.skipif(not CMAKE, reason="cmake is not installed")
@pytest.mark.parametrize("kind", KINDS)
def test_the_zephyr_module_builds_with_every_option(exports, tmp_path, kind):
    folder, text = exports[kind]
    (tmp_path / "policy").symlink_to(folder)
    (tmp_path / "CMakeLists.txt").write_text(ZEPHYR)
    words = [CMAKE, "-S", ".", "-B", "build", f"-DCMAKE_C_COMPILER={COMPILERS[0]}"]
    run(*words, *(f"-DCONFIG_{name}=y" for name in options_of(text)), folder=tmp_path)
    run(CMAKE, "--build", "build", folder=tmp_path)
    objects = {path.name.removesuffix(".o") for path in (tmp_path / "build").rglob("*.o")}
    assert objects == sources(text)


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
def test_16_bits_and_the_cycle_counter_compile_for_cores_without_a_library(exports, core):
    strict = [ARM, f"-mcpu={core}", "-mthumb", *STRICT, "-ffreestanding", "-O2", "-c"]
    for kind, names in (("delta", ["policy.c", "codec_i16.c"]), ("dense", ["policy.c"])):
        for name in [*names, "cycles.c"]:
            run(*strict, name, folder=exports[kind][0])


@needs_c
def test_a_core_without_a_known_counter_is_an_error(exports):
    words = [COMPILERS[0], "-fsyntax-only", "cycles.c"]
    folder, _ = exports["delta"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert "no cycle counter is known" in done.stderr


@needs_c
def test_no_number_is_refused_also_where_the_compiler_assumes_that_there_is_none(exports):
    # -ffast-math itself would also make subnormal numbers 0 in this whole process
    loaded = library(exports["dense"][0], "policy.c", "host_i16.c", flags=["-ffinite-math-only"])
    network = quantise(read_onnx(zoo.path("kart-grid/linear")))
    seen = walk_of(network, 1, 0)[0]
    found = np.zeros(len(seen), np.int16)
    assert called(loaded.policy_to_i16, seen, found) == 0
    for value in (np.nan, np.inf, -np.inf):
        assert called(loaded.policy_to_i16, np.r_[value, seen[1:]], found) == 1
