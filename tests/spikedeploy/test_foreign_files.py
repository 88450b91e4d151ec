"""Observations, rollouts, rasters, tracks and settings of others: one sentence each."""

import json
import math
import zipfile

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.campaign.sweep_grid import read_grid
from spikedeploy.emulation.rasters import as_raster, read_rasters
from spikedeploy.envs.kart import track as track_file
from spikedeploy.envs.rollout import Rollout
from spikedeploy.policies.nir import read_codec
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.codec import observed_numbers
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.emulator.running_network import FloatMachine
from spikedeploy.runtime.errors import ConfigError, EnvError, ObservationError, SpikedeployError
from spikedeploy.runtime.files import read_json
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.traces.verify import verify
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.distill.distill import DistillConfig
from spikedeploy.trainers.ppo import PpoConfig
from tests.effort import memory_below
from tests.networks import popsan

DEEP = "[" * 100_000


@pytest.fixture(scope="module")
def codec():
    return load(zoo.FOLDER / "hexapod" / "popsan.nir").codec


@pytest.mark.parametrize(("rows", "message"), [
    ([[10**400] * 77], "no array of numbers"),
    ([["x"] * 77], "and not real numbers"),
    (np.ma.masked_array(np.ones((1, 77)), mask=True), "masked values"),
    ([[[1, 2]] * 77], "has shape"),
    ([[None] * 77], "holds nan"),
    ([[1.0], [1.0, 2.0]], "no array of numbers"),
    (np.zeros((0, 77)), r"shape \(0, 77\)"),
], ids=["huge", "text", "masked", "deep", "none", "ragged", "empty"])  # fmt: skip
def test_what_is_no_observation_is_refused(rows, message, codec):
    with pytest.raises(ObservationError, match=message):
        codec.encode(rows)


def test_real_numbers_of_any_type_and_size_are_taken_without_a_warning(codec):
    for kind in ("f2", "f4", "i1", "u8", "?"):
        assert observed_numbers(np.ones(3, kind)).dtype == np.dtype(kind)
    large = codec.encode(np.full((1, 77), 1e308))
    np.testing.assert_array_equal(large, codec.encode(np.full((1, 77), 1e30)))


def test_masked_spikes_are_refused_wherever_they_come_in():
    artifact = popsan()
    program = compile_program(artifact, chip("loihi1"))
    spikes = np.ma.MaskedArray(np.ones((1, 5, artifact.codec.encoder.width), np.uint8), mask=True)
    for call in (
        lambda: Machine(program).infer(spikes),
        lambda: Machine(program).step(spikes[:, 0]),
        lambda: Machine(program, None).infer(spikes),
        lambda: FloatMachine(artifact).infer(spikes),
        lambda: FloatGraph(artifact).run({"input": spikes}),
        lambda: as_raster(spikes[0]),
    ):
        with pytest.raises(ObservationError, match=r"masked values.* Fill them"):
            call()


def walk(path):
    row = np.zeros(2)
    Rollout("x", 0, np.zeros((3, 2)), np.zeros((2, 1)), row, True, False, {"x": row}).save(path)


OBJECTS = np.array([{}], dtype=object)


@pytest.mark.parametrize("changes", [
        {"header": np.array([1, 2])}, {"observation": np.array(["a"])},
        {"observation": np.zeros((9, 2))}, {"reward": np.zeros((2, 2))}, {"info/x": np.zeros(5)},
        {"options": np.array(DEEP)}, {"options": np.array("[1]")}, {"observation": OBJECTS},
])  # fmt: skip
def test_an_episode_with_other_arrays_is_refused(changes, tmp_path):
    path = tmp_path / "g.npz"
    walk(path)
    Rollout.load(path)
    np.savez_compressed(path, **{**np.load(path), **changes})
    with pytest.raises(EnvError, match=r"g\.npz"):
        Rollout.load(path)


def bomb(path):
    """An archive of 400 kB that unpacks to 320 MB of zeros."""
    shape = {"descr": "|u1", "fortran_order": False, "shape": (320_000_000,)}
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("x.npy", "w", force_zip64=True) as file,
    ):
        np.lib.format.write_array_header_1_0(file, shape)
        for _ in range(320):
            file.write(bytes(1_000_000))
    return path


def test_an_archive_that_unpacks_to_hundreds_of_megabytes_is_refused(tmp_path):
    path = bomb(tmp_path / "a.npz")
    assert path.stat().st_size < 1_000_000
    for read in (read_rasters, Rollout.load):
        with memory_below(2**25), pytest.raises((EnvError, ObservationError), match="unpack"):
            read(path)


def test_numbers_that_would_take_gigabytes_as_floats_are_refused(tmp_path):
    path = tmp_path / "a.npz"
    rows = np.ones((3_000_000, 8), np.int8)
    np.savez_compressed(path, rows)
    assert read_rasters(path)["arr_0"].dtype == np.uint8
    np.savez_compressed(path, -rows)
    with pytest.raises(ObservationError, match="24000000 numbers, which take 8 bytes each"):
        read_rasters(path)


@pytest.mark.parametrize("name", ["objects", "header", "huge", "holes"])
def test_a_raster_of_objects_or_with_a_strange_header_is_refused(name, tmp_path):
    path = tmp_path / "a.npy"
    if name == "objects":
        np.save(path, OBJECTS, allow_pickle=True)
    elif name == "holes":
        np.lib.format.open_memmap(path, mode="w+", dtype="f8", shape=(1000, 225_000)).flush()
    else:
        text = "{'descr':'<f8','fortran_order':False,'shape':(%s,)}" % ("9" * 30)
        text = text if name == "huge" else "(" * 60_000
        path.write_bytes(b"\x93NUMPY\x02\x00" + len(text).to_bytes(4, "little") + text.encode())
    with pytest.raises(ObservationError, match="when unpacked" if name == "holes" else None):
        read_rasters(path)


def settings(path):
    resolve(PpoConfig, "kart-grid-ann", file=path, seed=0)


@pytest.mark.parametrize("read", [
    read_rasters, track_file.load, read_grid, settings, verify, read_codec, read_json,
    lambda path: chip(str(path.with_suffix(".toml"))),
])  # fmt: skip
def test_a_device_is_not_read(read, tmp_path):
    path = tmp_path / "zero.json"
    for link in (path, path.with_suffix(".toml")):
        link.symlink_to("/dev/zero")
    with pytest.raises((SpikedeployError, OSError), match=r"no (plain )?file"):
        read(path)


def circle(path, points, radius, **changes):
    record = json.loads((track_file.FOLDER / "small_S.json").read_text())
    angles = np.linspace(0, 2 * math.pi, points + 1)
    record["walls"] = [(radius * np.stack([np.cos(angles), np.sin(angles)], 1)).tolist()]
    record["gates"], record["start"]["position"] = [[[100, -50], [100, 50]]], [0, 0]
    path.write_text(json.dumps({**record, **changes}))
    return path


def test_a_track_too_long_or_too_large_is_refused(tmp_path):
    path = circle(tmp_path / "a.json", 4_000, 1500)
    with memory_below(2**27):
        assert len(track_file.load(path).walls) == 4_000
    for points, radius, changes, says in (
        (30_000, 900, {}, "of each"),
        (60, 9000, {}, "square px"),
        (60, 900, {"sway": 1.0}, "unknown field"),
    ):
        with pytest.raises(EnvError, match=says):
            track_file.load(circle(tmp_path / "a.json", points, radius, **changes))


@pytest.mark.parametrize(("model", "recipe", "override", "says"), [
    (PpoConfig, "kart-grid-ann", "policy.hidden=[1000000000]", "16384"),
    (PpoConfig, "kart-grid-ann", "env.count=1000000000", "4096"),
    (PpoConfig, "kart-grid-ann", "steps=99999999999999999999", "1000000000000"),
    (DistillConfig, "hexapod-distill", "batch=10000000000", "1048576"),
    (PpoConfig, "kart-grid-ann", "steps=" + "[" * 5000, "nested too deeply|valid integer"),
])  # fmt: skip
def test_settings_that_no_machine_can_hold_are_refused(model, recipe, override, says):
    with pytest.raises(ConfigError, match=says):
        resolve(model, recipe, overrides=[override], seed=0)


@pytest.mark.parametrize(
    "text",
    ["x = " + "[" * 5000, "x = " + "9" * 10_000, "\0", "a" + ".a" * (1 << 14) + " = 1"],
    ids=["deep", "digits", "nul", "dots"],
)
def test_a_strange_toml_file_is_refused(text, tmp_path):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(ConfigError):
        resolve(PpoConfig, "kart-grid-ann", file=tmp_path / "a.toml", seed=0)
