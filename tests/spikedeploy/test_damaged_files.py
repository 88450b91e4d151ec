"""Damaged files raise only errors of ours: bytes, JSON trees and HDF5 trees, of every reader."""

import json
import shutil
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spikedeploy import zoo
from spikedeploy.emulation.raster_emulation import emulate_artifact
from spikedeploy.emulation.rasters import read_inputs
from spikedeploy.envs.kart import track as track_file
from spikedeploy.envs.rollout import Rollout
from spikedeploy.policies import run_record
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import check
from spikedeploy.runtime.errors import ConventionError, EnvError, SpikedeployError
from spikedeploy.runtime.graph.ports import ports
from spikedeploy.runtime.traces.verify import verify
from spikedeploy.shipping.reproduce import read_evaluation
from spikedeploy.trainers.config import resolve
from spikedeploy.trainers.ppo import PpoConfig
from spikedeploy.trainers.run_folder import RunFolder
from tests.paths import GOLDEN, ROOT

OURS = (SpikedeployError, EnvError)
CHIPS = ("loihi1", "xylo-a2", "odin")


def network(path):
    """Load, check for three chips, run in float, write, read again."""
    try:
        artifact = load(path)
    except ConventionError:
        artifact = load(path, dt=1e-3)  # the usual remedy
    for name in CHIPS:
        check(artifact, chip(name))
    inputs = {p.name: np.ones((3, *p.shape), np.uint8) for p in ports(artifact.graph.inputs)}
    emulate_artifact(artifact, "float", inputs)
    save(artifact, path.with_suffix(".copy"))
    load(path.with_suffix(".copy"))


def raster(path):
    """Play it to a network."""
    artifact = load(ROOT / "examples/net.nir")
    emulate_artifact(artifact, "float", read_inputs(path, artifact))


def policy(path):
    """Open an ONNX file and act."""
    player = OnnxController(path)
    player.act(np.zeros(player.observed))


def card(path):
    """Read what `reproduce` takes from a card beside a policy."""
    shutil.copyfile(zoo.FOLDER / "kart-steer/linear.onnx", path.parent / "linear.onnx")
    read_evaluation(str(path))


def configuration(path):
    """Read the configuration of a run folder."""
    folder = path.parent / "run"
    folder.mkdir(exist_ok=True)
    shutil.copyfile(path, folder / "config.json")
    run_record.settings(folder)
    RunFolder(folder).config(PpoConfig)


def walk(path):
    """Write two steps of a walk."""
    numbers = {"x": np.zeros(2), "y": np.ones(2)}
    episode = (np.zeros((3, 4)), np.ones((2, 1)), np.ones(2), True, False, numbers)
    Rollout("spikedeploy/Hexapod-v0", 1, *episode, {"slope": 1}).save(path)


SETTINGS = "steps = 1000\n[env]\ncount = 2\n[policy]\nhidden = [8, 8]\n"
CONFIG = resolve(PpoConfig, "kart-grid-ann", seed=0).model_dump_json()

# name -> its sound file or what writes one, what reads it, its ending
KINDS = {
    "policy.nir": (zoo.FOLDER / "kart-steer/sparse.nir", network),
    "net.nir": (ROOT / "examples/net.nir", network),
    "raster.npy": (ROOT / "examples/raster.npy", raster),
    "linear.onnx": (zoo.FOLDER / "kart-steer/linear.onnx", policy),
    "walk.rollout": (walk, Rollout.load),
    "lava.trace": (GOLDEN / "lava_I_bias.json", verify),
    "xylo.trace": (GOLDEN / "xylo_A_ff.json", verify),
    "a.drawn.json": (track_file.FOLDER / "small_S.json", track_file.load),
    "card.json": (zoo.FOLDER / "kart-steer/linear.json", card),
    "config.json": (lambda path: path.write_text(CONFIG), configuration),
    "settings.toml": (
        lambda path: path.write_text(SETTINGS),
        lambda path: resolve(PpoConfig, "kart-grid-ann", file=path),
    ),
}
OF_JSON = [name for name in KINDS if name.endswith((".json", ".trace"))]
OF_HDF5 = [name for name in KINDS if name.endswith(".nir")]
few = settings(
    max_examples=12, derandomize=True, database=None,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip


def sound(name, folder):
    """A sound file of a kind, and what reads it."""
    source, read = KINDS[name]
    path = Path(folder) / name
    source(path) if callable(source) else shutil.copyfile(source, path)
    return path, read


def refused_or_read(path, read):
    """Read a damaged file; anything but an error of ours comes through."""
    with suppress(*OURS):
        read(path)


@pytest.mark.parametrize("name", KINDS)
def test_the_files_that_are_damaged_are_sound(name, tmp_path):
    path, read = sound(name, tmp_path)
    read(path)


@few
@given(data=st.data())
@pytest.mark.parametrize("name", KINDS)
def test_damaged_bytes_are_read_or_refused(name, tmp_path_factory, data):
    path, read = sound(name, tmp_path_factory.mktemp("bytes"))
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(content)))
        kind = data.draw(st.sampled_from(("cut", "overwrite", "insert")))
        new = data.draw(st.binary(min_size=1, max_size=8))
        content[at : {"cut": None, "overwrite": at + len(new), "insert": at}[kind]] = (
            b"" if kind == "cut" else new
        )
    path.write_bytes(content)
    refused_or_read(path, read)


trees = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=12,
)


def places(tree):
    """Every (container, key) of a JSON tree."""
    keys = tree if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in keys:
        yield tree, key
        yield from places(tree[key])


@few
@given(data=st.data())
@pytest.mark.parametrize("name", OF_JSON)
def test_any_value_in_a_json_file_is_read_or_refused(name, tmp_path_factory, data):
    path, read = sound(name, tmp_path_factory.mktemp("json"))
    tree = json.loads(path.read_text("utf-8"))
    found = list(places(tree))
    holder, key = found[data.draw(st.integers(0, len(found) - 1))]
    holder[key] = data.draw(trees)
    path.write_text(json.dumps(tree), "utf-8")
    refused_or_read(path, read)


# of the same shape, numbers; of another shape or type
NUMBERS = (np.nan, np.inf, -1.0, 5e-324, 1e300, 1 << 62, 1j)
OTHERS = {
    "empty": lambda old: np.zeros((0, *np.shape(old)[1:])),
    "flat": lambda old: np.zeros(max(np.size(old), 1)),
    "another axis": lambda old: np.zeros((1, *np.shape(old), 1)),
    "text": lambda old: b"LIF",
}


@few
@given(data=st.data())
@pytest.mark.parametrize("name", OF_HDF5)
def test_any_array_of_a_network_is_read_or_refused(name, tmp_path_factory, data):
    path, read = sound(name, tmp_path_factory.mktemp("hdf5"))
    with h5py.File(path, "r+") as file:
        names = []
        file.visit(names.append)
        chosen = data.draw(st.sampled_from(sorted(names)))
        kind = data.draw(st.sampled_from(["missing", "renamed", *NUMBERS, *OTHERS]))
        old, made = file[chosen], None
        if not isinstance(old, h5py.Group) and kind not in ("missing", "renamed"):
            make = OTHERS.get(kind, lambda old: np.full(np.shape(old), kind))
            made = make(old[()])
        if kind == "renamed":
            file.move(chosen, f"{chosen}x")
        else:
            del file[chosen]
        if made is not None:
            file[chosen] = made
    refused_or_read(path, read)
