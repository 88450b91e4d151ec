"""A folder of Verilog: written all or nothing, read back, and refused where it is another's."""

import errno
import hashlib
import json
import os
from pathlib import Path

import pytest

from spikedeploy import zoo
from spikedeploy.exporters.verilog import eda_tools as tools
from spikedeploy.runtime import files
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.verilog import (
    MARK,
    RECORD,
    VerilogFolder,
    build_simulation,
    check_folder,
    is_export,
    read_folder,
    write_folder,
)

POLICY = zoo.path("hexapod/sparse")
NAMES = ("policy_core.v", "policy_params.vh", "synapses.hex", "top.v", "Makefile")


def texts_of(export, names=NAMES):
    return {name: f"{name} of {export}\n" for name in names}


def written(folder, texts, sha256=None):
    export = VerilogFolder(
        folder=folder, policy="hexapod/sparse.nir", sha256=sha256 or zoo.sha256(POLICY),
        chip="loihi1", board="icebreaker",
        files={name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()},
    )  # fmt: skip
    write_folder(texts, export)
    return export


def names_in(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_what_was_written_is_read_back(tmp_path):
    export = written(tmp_path, texts_of("one"))
    assert read_folder(tmp_path) == export
    assert check_folder(POLICY, tmp_path) == export
    assert names_in(tmp_path) == {*NAMES, RECORD}


def test_files_of_another_board_are_removed_and_those_of_the_user_stay(tmp_path):
    written(tmp_path, texts_of("one", (*NAMES, "board.pcf")))
    (tmp_path / "own.txt").write_text("of the user\n")
    written(tmp_path, texts_of("two"))
    assert names_in(tmp_path) == {*NAMES, RECORD, "own.txt"}


@pytest.mark.parametrize("renamed", range(len(NAMES) + 1))
def test_an_export_that_is_killed_leaves_no_makefile_and_is_written_again(
    tmp_path, monkeypatch, renamed
):
    written(tmp_path, texts_of("old"))
    done = []

    def killed(source, target):
        if len(done) == renamed:
            raise KeyboardInterrupt
        done.append(target)
        os.rename(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            written(tmp_path, texts_of("new"))
    assert not (tmp_path / "Makefile").exists()
    assert is_export(tmp_path)
    export = written(tmp_path, texts_of("new"))
    assert read_folder(tmp_path) == export
    assert names_in(tmp_path) == {*NAMES, RECORD}


def test_a_full_disk_leaves_the_earlier_export_as_it_was(tmp_path, monkeypatch):
    export = written(tmp_path, texts_of("old"))
    write, done = Path.write_text, []

    def full(path, *words, **options):
        done.append(path)
        if len(done) == 4:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, *words, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        with pytest.raises(OSError, match="No space"):
            written(tmp_path, texts_of("new"))
    assert read_folder(tmp_path) == export


def spoil_record(folder, **fields):
    record = json.loads((folder / RECORD).read_text())
    (folder / RECORD).write_text(json.dumps({**record, **fields}))


SPOILT = {
    "no record": (lambda f: (f / RECORD).unlink(), "is no folder that"),
    "a record of another tool": (lambda f: (f / RECORD).write_text("{}"), "is no folder that"),
    "a record cut short": (lambda f: (f / RECORD).write_text(f'{{"format": "{MARK}'), "is damaged"),
    "no chip": (lambda f: spoil_record(f, chip=None), r"damaged \(chip\)"),
    "no files": (lambda f: spoil_record(f, files=["a"]), r"damaged \(files\)"),
    "files elsewhere": (lambda f: spoil_record(f, files={"../x": ""}), r"damaged \(files\)"),
    "another policy": (lambda f: spoil_record(f, sha256="0" * 64), "is another file"),
    "a file less": (lambda f: (f / "top.v").unlink(), r"damaged, top\.v is missing"),
    "other synapses": (
        lambda f: (f / "synapses.hex").write_text("0\n"),
        r"synapses\.hex is not as exported, so that it is another program",
    ),
}


@pytest.mark.parametrize("name", SPOILT)
def test_a_folder_that_is_damaged_or_of_another_policy_is_refused_in_a_sentence(tmp_path, name):
    spoil, said = SPOILT[name]
    written(tmp_path, texts_of("one"))
    spoil(tmp_path)
    before = {name: (tmp_path / name).read_bytes() for name in names_in(tmp_path)}
    with pytest.raises(ConfigError, match=said) as error:
        check_folder(POLICY, tmp_path)
    assert "\n" not in str(error.value)
    assert {name: (tmp_path / name).read_bytes() for name in names_in(tmp_path)} == before


def test_a_core_that_was_edited_may_drive_since_every_state_is_compared(tmp_path):
    written(tmp_path, texts_of("one"))
    (tmp_path / "policy_core.v").write_text("a better core\n")
    assert check_folder(POLICY, tmp_path)


def test_a_simulation_that_cannot_be_built_is_a_sentence(tmp_path, monkeypatch):
    texts = {
        **texts_of("one"),
        "Makefile": "policy_sim:\n\t@echo Verilator is missing >&2; exit 1\n",
    }
    export = written(tmp_path, texts)
    with pytest.raises(ConfigError, match=r"cannot be built: Verilator is missing$"):
        build_simulation(export.folder)
    monkeypatch.setattr(tools, "find_tool", lambda name: None)
    with pytest.raises(ConfigError, match="apt-get install make"):
        build_simulation(export.folder)


def test_no_other_makefile_of_the_folder_is_run(tmp_path):
    texts = {**texts_of("one"), "Makefile": "policy_sim:\n\t@touch policy_sim\n"}
    export = written(tmp_path, texts)
    (tmp_path / "GNUmakefile").write_text("policy_sim:\n\t@touch policy_sim other\n")
    assert build_simulation(export.folder) == tmp_path / "policy_sim"
    assert not (tmp_path / "other").exists()
