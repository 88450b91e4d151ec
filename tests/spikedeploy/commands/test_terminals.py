"""What people see on every terminal: brackets, ASCII, full pipes, no display; one entry in full."""

import json
import os
import subprocess
import sys
from collections import Counter

import pytest

from spikedeploy import console
from spikedeploy.console import progress
from spikedeploy.envs import drawing
from spikedeploy.play.display import check_driver
from spikedeploy.reports.table import Table
from spikedeploy.runtime.chips.chip import CHIPS, chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metrics.energy_tables import TABLES
from spikedeploy.trainers.config import MlpConfig, PopsanConfig
from tests import toy_stroll_env
from tests.paths import ROOT

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER", "SDL_VIDEO_DRIVER")


def called(line, **environ):
    """A shell's command line with `spikedeploy` in it, done."""
    line = line.replace("spikedeploy", f"{sys.executable} -m spikedeploy")
    return subprocess.run(
        ["sh", "-c", line],
        cwd=ROOT,
        env={**os.environ, **environ},
        capture_output=True,
        check=False,
    )


def test_brackets_are_text_in_tables(capsys):
    Table(("time [s]", "[red]"), [('pip install ".[x]"', "[/]")], "[bold]out").print()
    out = capsys.readouterr().out
    for text in ("[bold]out", "time [s]", "[red]", 'pip install ".[x]"', "[/]"):
        assert text in out


NUMBERS = ("3,413 [3,405, 3,420]", "100.0%", "6,014,208", "≥ 51.61 nJ", "-203.2 [-253.3, -161.5]")
TEXT = "2.08 mJ (frady2020), 2.71 mJ (popsan2020), activations and the encoder"


@pytest.mark.parametrize("columns", [40, 60, 80, 120, 200])
@pytest.mark.parametrize("most", [None, 80])
@pytest.mark.parametrize(
    "name", ["sac", "sparse-gated · loihi1", "ppo-snn-Ant-v5-s0-20261126-080737"]
)
def test_no_number_is_cut_where_the_terminal_is_narrow(columns, most, name, capsys, monkeypatch):
    monkeypatch.setattr(console, "_PIPE_WIDTH", columns)
    heads = ("policy", "return", "of ANN", "horowitz45-int8", "first difference", "gain", "static")
    Table(heads, [(name, *NUMBERS, TEXT)] * 2, "What it earns", numbers=True).print(most)
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert max(map(len, lines)) <= min(columns, most or columns)
    out = "\n".join(lines)
    assert out.count("What it earns") == 1
    assert Counter(2 * " ".join([*NUMBERS, TEXT, ""]).split()) <= Counter(out.split())
    if most is None and columns >= 60:  # with their intervals
        assert [each for each in NUMBERS if out.count(each) < 2] == []


@pytest.mark.parametrize(
    ("name", "said"), [(None, "spikedeploy"), ("./spike", "./spike"), ("a b/spike", "'a b/spike'")]
)
def test_hints_name_the_command_as_the_user_calls_it(name, said, command, tmp_path, monkeypatch):
    monkeypatch.delenv("SPIKEDEPLOY_COMMAND", raising=False)
    if name:
        monkeypatch.setenv("SPIKEDEPLOY_COMMAND", name)
    _, out, _ = command("runs", "--runs", tmp_path)
    assert f"`{said} train RECIPE` makes one" in out


@pytest.mark.parametrize(
    ("words", "file", "printed"),
    [
        (["run", "a b/p.so"], "p.so", "spikedeploy run 'a b/p.so' --native --env ENV"),
        (["run", "a b/p.zip"], "p.zip", "spikedeploy compare ENV --teacher 'a b/p.zip'"),
        (["export", "stroll/popsan", "--to", "c", "-o", "a b/c"], "", "make -C 'a b/c' test"),
        (["train", "a b-v1"], "", "spikedeploy train 'a b-v1' --recipe ppo-snn"),
    ],
)
def test_printed_commands_quote_what_has_spaces(words, file, printed, command, stroll):
    (stroll / "a b").mkdir()
    if file:
        (stroll / "a b" / file).touch()
    _, out, err = command(*words)
    assert printed in out + err


def test_the_version_is_printed(command):
    code, out, _ = command("--version")
    assert code == 0
    assert out.startswith("spikedeploy ")


def test_a_terminal_of_ascii_gets_ascii():
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = called("spikedeploy energy horowitz45-int8; spikedeploy chips", **ascii_only)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"horowitz45-int8" in done.stdout
    done.stdout.decode("ascii")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
def test_a_full_disk_is_one_line():
    done = called("spikedeploy chips > /dev/full")
    assert done.returncode == 2
    assert done.stderr.startswith(b"error: No space left on device")
    assert done.stderr.count(b"\n") == 1


def test_a_reader_that_leaves_is_not_a_network_that_does_not_fit():
    piped = "spikedeploy energy; echo $? >&2"
    done = called(f"({piped}) | true")
    assert done.stderr.strip().split(b"\n")[-1] == b"141"


def test_progress_comes_in_lines_where_there_is_no_terminal(capsys, monkeypatch):
    with progress("quick", 2) as done:
        done()
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(console, "PAUSE", 0.0)
    with progress("kart [bold]", 2) as done:
        done()
        done()
    assert capsys.readouterr().err == "kart [bold]: 1 of 2\nkart [bold]: 2 of 2\n"


@pytest.mark.skipif(sys.platform in ("darwin", "win32"), reason="there is always a display")
@pytest.mark.parametrize("words", [("play", "kart-grid")])
def test_without_a_display_no_window_is_opened(words, command, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name in DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    code, out, err = command(*words)
    assert (code, out) == (2, "")
    assert err.startswith("error: no display: ")
    assert list(tmp_path.iterdir()) == []


def test_a_display_that_cannot_be_reached_is_none(monkeypatch):
    for name in DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DISPLAY", ":99")
    with pytest.raises(ConfigError, match="no display: :99 cannot be reached"):
        check_driver("offscreen")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(drawing, "_sdl_is_ours", False)
    check_driver("dummy")  # as asked for


@pytest.mark.parametrize("name", CHIPS)
def test_a_chip_is_printed_in_full(name, command):
    code, out, _ = command("chips", name)
    assert code == 0
    assert chip(name).summary[:30] in out
    found = json.loads(command("chips", name, "--json")[1])
    assert found["name"] == name
    assert (found["limits"] is None) == (chip(name).limits is None)
    named = [field for field, value in found["fields"].items() if value not in (None, [], "")]
    assert all(field in out for field in named)


@pytest.mark.parametrize("name", TABLES)
def test_an_energy_table_is_printed_in_full(name, command):
    code, out, _ = command("energy", name)
    assert code == 0
    assert all(event in out for event in TABLES[name].joules)
    assert json.loads(command("energy", name, "--json")[1])["joules"] == dict(TABLES[name].joules)


def test_a_policy_is_printed_in_full(command, monkeypatch, tmp_path):
    out = command("policies", "hexapod/popsan")[1]
    assert "hidden 512 × 512" in out
    assert "loihi1:clock=gated" in out
    assert "gait" in command("policies", "gait")[1]
    found = json.loads(command("policies", "hexapod/popsan", "--json")[1])
    assert (found["name"], found["recipe"]) == ("hexapod/popsan", "hexapod-distill")


@pytest.mark.parametrize("verb", ["chips", "energy", "policies"])
def test_an_entry_that_is_not_there_is_one_line(verb, command):
    code, out, err = command(verb, "nowhere")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1


def test_export_takes_the_format_from_the_file_or_the_policy(command, stroll):
    spiking = toy_stroll_env.run_folder(stroll / "runs", PopsanConfig(hidden=(6,), populations=3))
    words = ("export", spiking, "--observations", 30)
    assert command(*words, "-o", "x.nir")[0] == 0
    assert (stroll / "x.nir").is_file()
    assert command(*words)[0] == 0
    assert (spiking / "policy.nir").is_file()
    plain = toy_stroll_env.run_folder(stroll / "other", MlpConfig(hidden=(6,)))
    assert command("export", plain, "--observations", 30)[0] == 0
    assert (plain / "policy.onnx").is_file()


def test_export_says_that_a_training_is_unfinished(command, stroll):
    run = toy_stroll_env.run_folder(stroll / "runs", MlpConfig(hidden=(6,)))
    words = ("export", run, "--observations", 30)
    assert "unfinished" not in command(*words)[2]
    file = run / "checkpoints/last.json"
    file.write_text(json.dumps({"share": 0.12, "finished": False}))
    assert "its training is unfinished: stopped at 12 %" in command(*words)[2]
