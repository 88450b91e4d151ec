"""No command overwrites its input, a device, a run's files or what it did not write."""

import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spikedeploy.outputs import check_output, check_output_folder, has_text, mark
from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import write_text
from spikedeploy.shipping.export_run import _same_training
from tests.networks import ORIGIN, popsan
from tests.paths import ROOT

NET = ROOT / "examples" / "net.nir"
RASTER = ROOT / "examples" / "raster.npy"


@pytest.fixture
def run(tmp_path):
    """A run folder with its files."""
    folder = tmp_path / "run"
    (folder / "checkpoints").mkdir(parents=True)
    (folder / "config.json").write_text("{}")
    (folder / "metrics.csv").write_text("env_steps,eval_return\n0,1.0\n10,2.0\n")
    (folder / "checkpoints" / "last.safetensors").write_text("weights")
    return folder


def refused(words, *, says, command, kept=()):
    before = [path.read_bytes() for path in kept]
    code, _, err = command(*words)
    assert code == 2, err
    assert re.search(says, err), err
    assert [path.read_bytes() for path in kept] == before


COMMANDS = {
    "emulate": lambda f, _: ("emulate", NET, "--chip", "float", "--input", RASTER, "-o", f),
    "run": lambda f, _: ("run", "kart-steer/snn", "--video", f),
    "visualize": lambda f, run: ("visualize", run, "-o", f),
    "compare": lambda f, run: ("compare", "kart-steer", "--episodes", "1", "-o", run),
}


@pytest.mark.parametrize(
    ("name", "says"),
    [
        *((name, "--force") for name in COMMANDS if name != "compare"),
        ("compare", "folder of a training run"),
    ],
)
def test_every_command_leaves_what_it_did_not_write(name, says, run, command):
    path = run.parent / "out.mp4"
    path.write_text("my notes")
    refused(COMMANDS[name](path, run), says=says, command=command, kept=[path])


@pytest.mark.parametrize("output", ["net.nir", "in.npy", "linked.npz", "hard.npz", "x/../net.nir"])
def test_an_input_is_never_overwritten_by_any_of_its_names(output, tmp_path):
    net, raster = tmp_path / "net.nir", tmp_path / "in.npy"
    shutil.copy(NET, net)
    shutil.copy(RASTER, raster)
    (tmp_path / "linked.npz").symlink_to(raster)
    os.link(net, tmp_path / "hard.npz")
    (tmp_path / "x").mkdir()
    with pytest.raises(ConfigError, match="is the input"):
        check_output("-o", tmp_path / output, (net, str(raster), "hexapod/popsan"), force=True)


KINDS = {
    "folder": (lambda path: path.mkdir(), "is a folder"),
    "fifo": (os.mkfifo, "a pipe"),
    "device": (lambda path: path.symlink_to("/dev/null"), "a device"),
    "dangling": (lambda path: path.symlink_to(path.parent / "nowhere"), "link to nothing"),
    "under a file": (lambda path: path.parent.write_text("mine"), "is a file"),
    "a long name": (lambda path: None, "File name too long"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_plain_file_is_refused(kind, tmp_path):
    name = {"under a file": "notes/out.mp4", "a long name": "x" * 300}.get(kind, "out.mp4")
    make, says = KINDS[kind]
    make(tmp_path / name)
    with pytest.raises(ConfigError, match=says):
        check_output("-o", tmp_path / name, force=True)


def test_no_name_and_a_folder_that_takes_nothing_are_refused():
    with pytest.raises(ConfigError, match=r"-o \. is a folder"):
        check_output("-o", Path())
    with pytest.raises(ConfigError, match=r"-o /proc/x\.npz: /proc takes no file"):
        check_output("-o", Path("/proc/x.npz"))


@pytest.mark.parametrize(
    "inside", ["config.json", "metrics.csv", "checkpoints/last.safetensors", "a.csv"]
)
def test_files_of_a_run_are_never_overwritten(inside, run):
    with pytest.raises(ConfigError, match="inside the run folder"):
        check_output("-o", run / inside, force=True)


def test_an_export_takes_no_tuned_file_for_its_own(tmp_path):
    exported, tuned = tmp_path / "policy.nir", tmp_path / "tuned.nir"
    save(popsan(), exported)
    save(replace(popsan(), tuned="adapted to loihi1"), tuned)
    assert _same_training(ORIGIN, exported)
    assert not _same_training(ORIGIN, tuned)


def test_exports_and_pictures_may_stand_in_a_run_folder(run, command):
    for _ in range(2):
        assert command("visualize", run, "-o", run / "mine.png")[0] == 0
    assert has_text(run / "mine.png", mark("visualize"))
    check_output("-o", run / "policy.nir")


@pytest.mark.parametrize("ending", ["npz", "h5"])
def test_an_earlier_output_is_replaced_and_a_link_stays(ending, tmp_path, command):
    real, link = tmp_path / f"real.{ending}", tmp_path / f"link.{ending}"
    link.symlink_to(real)
    for path in (real, link):
        assert command(*COMMANDS["emulate"](path, None))[0] == 0
    assert link.is_symlink()
    np.savez(tmp_path / "mine.npz", a=np.ones(3))
    (tmp_path / "mine.npz").replace(real)  # the user's own now
    refused(COMMANDS["emulate"](link, None), says="--force", command=command, kept=[real])


def test_a_folder_with_files_of_somebody_else_needs_force(tmp_path):
    (tmp_path / "report.md").write_text("my own report")
    names = ("report.md", "report.json")
    with pytest.raises(ConfigError, match=r"report\.md: the file exists"):
        check_output_folder("-o", tmp_path, names)
    check_output_folder("-o", tmp_path, names, force=True)
    check_output_folder("-o", tmp_path, names, ours=lambda folder: True)


def test_every_writer_follows_links_and_refuses_devices(tmp_path):
    real = tmp_path / "real.txt"
    (tmp_path / "link.txt").symlink_to(real)
    write_text(tmp_path / "link.txt", "text")
    assert (tmp_path / "link.txt").is_symlink()
    assert real.read_text() == "text"
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FileExistsError, match="no plain file"):
        write_text(tmp_path / "pipe", "text")


def test_a_text_that_quotes_the_mark_is_not_ours(tmp_path):
    notes = tmp_path / "notes.txt"
    notes.write_text(f"{mark('emulate')}, it says\n")
    assert not has_text(notes, mark("emulate"))
