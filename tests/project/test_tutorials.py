"""A reader who follows a tutorial from top to bottom sees what it shows."""

import os
import shutil
import subprocess
import sys

import pytest

from spikedeploy.exporters.verilog.eda_tools import find_tool
from spikedeploy.runtime import CHIPS
from tests.project.test_docs import checkout  # noqa: F401  the folder of the reader
from tests.project.tutorials import PAGES, commands, fails, missing, parts, programs, short
from tests.waiting import PATIENCE


@pytest.fixture
def reader(checkout, monkeypatch):  # noqa: F811
    """The folder, whose files can be imported; chips and modules that a page adds go with it."""
    chips, modules = dict(CHIPS), set(sys.modules)
    monkeypatch.syspath_prepend(str(checkout))
    monkeypatch.setenv("COLUMNS", "120")
    yield checkout
    CHIPS.clear()
    CHIPS.update(chips)
    for name in set(sys.modules) - modules:
        if str(checkout) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_tutorial_does_what_it_says(page, reader, command, capsys):
    names, printed = {}, ""
    for part in parts(page):
        if part.kind == "sh":
            printed = called(programs(part), reader)
            lines = commands(part)
            if any("--via" in line for line in lines) and not all(map(find_tool, NEEDED["sim"])):
                printed = None
            if printed is not None:
                printed += "".join(ran(line, command) for line in lines)
        elif part.kind in ("python", "c", "toml") and part.title:
            (reader / part.title).write_text(part.text, encoding="utf-8")
        elif part.kind == "python":
            exec(compile(part.text, page.name, "exec"), names)
            printed = capsys.readouterr().out
        elif part.kind == "text" and not part.title and printed is not None:
            assert missing(part.text, printed) is None, printed


def ran(line, command):
    """What a command prints on both streams; its exit code is the one of the page."""
    import shlex

    code, out, err = command(*shlex.split(short(line), comments=True)[1:])
    assert code == fails(line), err
    return out + err


def called(lines, folder):
    """What other programs print; None where one of them, or what it needs, is not installed."""
    printed = ""
    for words in lines:
        program = str(folder / words[0]) if "/" in words[0] else shutil.which(words[0])
        if program is None or shutil.which("cc") is None or not has_library(words[0]):
            return None
        if not all(find_tool(tool) for word in words for tool in NEEDED.get(word, ())):
            return None
        done = subprocess.run([program, *words[1:]], cwd=folder, capture_output=True, text=True,
                              check=False, stdin=subprocess.DEVNULL, timeout=PATIENCE)  # fmt: skip
        assert done.returncode == 0, done.stderr
        printed += done.stdout + done.stderr  # qemu writes what a board says to the second
    return printed


# targets of the Makefile of an export to Verilog -> what they need
NEEDED = {
    "lint": ("verilator",),
    "sim": ("verilator", "g++"),
    "netlist": ("verilator", "g++", "yosys"),
    "bit": ("yosys", "nextpnr-ice40", "icepack"),
    "bitcheck": ("verilator", "g++", "iceunpack", "icebox_vlog"),
}


def has_library(program):
    """Whether a cross compiler has picolibc, with which the page builds; also of its programs."""
    if "arm" not in program:
        return True
    compiler = shutil.which("arm-none-eabi-gcc")
    words = [compiler, "--specs=picolibc.specs", "-E", "-x", "c", os.devnull]
    return bool(compiler) and subprocess.run(words, capture_output=True).returncode == 0
