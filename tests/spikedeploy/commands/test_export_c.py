"""`export --to c`: what it writes, prints and refuses."""

import json
import shutil
import sys

import pytest

from spikedeploy import zoo
from spikedeploy.exporters.c.declarations import plain
from spikedeploy.exporters.c.packaging import INT16, MARK, file_names, write_texts
from spikedeploy.exporters.c.refusals import check_prefix
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping import export_c, exported_run, sources
from tests.networks import event_driven

CHIP = ("--to", "c", "--chip", "loihi1")


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A policy file that names no environment of ours."""
    from dataclasses import replace

    monkeypatch.chdir(tmp_path)
    artifact = event_driven()
    origin = replace(artifact.provenance, env="own_module:Env")
    save(replace(artifact, provenance=origin), tmp_path / "policy.nir")
    return "policy.nir"


def test_it_writes_every_file_and_says_what_they_take(command, file, tmp_path):
    code, out, err = command("export", file, *CHIP, "-o", "c", "--observations", "50", "--json")
    assert code == 0, err
    found = json.loads(out)
    written = {str(path.relative_to(tmp_path / "c")) for path in (tmp_path / "c").rglob("*.*")}
    names = set(file_names("policy")) - {"Makefile", "zephyr/Kconfig"}
    assert written == names
    assert set(found["files"]) == {*names, "Makefile", "zephyr/Kconfig"}
    assert found["int16"] is True
    costs = found["costs"]
    assert 0 < costs["sops"] <= costs["sops_max"]
    assert 0 < costs["events"] <= costs["events_max"]
    assert costs["rom"] > 0
    assert costs["ram"] > 0
    assert "a random walk stands for it" in err  # its environment is not imported


def test_a_run_is_played_in_its_own_environment(file, monkeypatch):
    artifact = load(file)
    assert sources.world_of(file, artifact) == ""  # what a file names is not imported
    monkeypatch.setattr(exported_run, "trained_in", lambda policy: "own_module:Env")
    assert sources.world_of("last", artifact) == "own_module:Env"


WORLD = """
import gymnasium, numpy as np
class Env(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-9, 9, (3,))
    action_space = gymnasium.spaces.Box(-1, 1, (2,))
    def reset(self, *, seed=None, options=None):
        self.left = 7
        return np.ones(3), {}
    def step(self, action):
        self.left -= 1
        return np.ones(3), 0.0, self.left == 0, False, {}
"""


@pytest.mark.parametrize("to", ["c", "onnx"])
def test_the_environment_that_the_user_names_is_played_and_one_of_another_shape_refused(
    to, command, file, tmp_path, monkeypatch
):
    (tmp_path / "own_module.py").write_text(WORLD)
    monkeypatch.delitem(sys.modules, "own_module", raising=False)
    words = ("export", file, "--to", to, "--observations", "50", "-o")
    code, _, err = command(*words, "other", "--env", "CartPole-v1")
    assert (code, "--env CartPole-v1: its observations have shape (4,)" in err) == (2, True)
    assert not (tmp_path / "other").exists()
    assert "own_module" not in sys.modules
    code, out, err = command(*words, "c", "--env", "own_module:Env", "--json")
    assert code == 0, err
    assert "random walk" not in err
    if to == "c":
        assert json.loads(out)["recorded"].startswith("7 control steps in own_module:Env")
    monkeypatch.delitem(sys.modules, "own_module")


def test_the_same_policy_is_written_again_and_other_files_are_not(command, file, tmp_path):
    words = ("export", file, *CHIP, "-o", "c", "--observations", "5")
    assert command(*words)[0] == 0
    first = (tmp_path / "c/policy.c").read_bytes()
    assert command(*words)[0] == 0
    assert (tmp_path / "c/policy.c").read_bytes() == first
    (tmp_path / "other").mkdir()
    (tmp_path / "other/Makefile").write_text("all:\n")
    code, _, err = command(*words[:-3], "other", *words[-2:])
    assert (code, "--force" in err) == (2, True)
    assert (tmp_path / "other/Makefile").read_text() == "all:\n"


PREFIXES = {
    "small letters": ["", "9a", "a-b", "A", "CON", "Makefile", "x" * 40],
    "C\\+\\+ reserves names": ["left__leg", "left_"],
    "is the name of": [
        *("makefile", "gnumakefile", "con", "aux", "nul", "prn", "com1", "com9", "lpt1", "lpt9"),
        *("int", "exp", "expf", "tanhl", "printf", "while", "read", "math", "spi"),
    ],
}


@pytest.mark.parametrize(("prefix", "why"), [(p, why) for why in PREFIXES for p in PREFIXES[why]])
def test_a_prefix_that_systems_take_for_something_else_is_refused(prefix, why):
    with pytest.raises(ConfigError, match=f"--prefix '{prefix}'.*{why}"):
        check_prefix(prefix)
    if why == "is the name of":
        check_prefix(f"{prefix}_policy")


def test_names_of_layers_keep_their_slashes_in_comments_and_end_none():
    assert plain("net/fc1.out") == "net/fc1.out"
    assert plain("net*/ x /*") == "net?/?x?/?"


def test_a_float_policy_is_written_in_8_bits_and_says_how_far_its_actions_move(
    command, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    words = ("export", "kart-grid/linear", "--to", "c", "-o", "c", "--observations", "40")
    code, out, err = command(*words, "--json")
    assert code == 0, err
    found = json.loads(out)
    assert found["weights"] <= 140
    assert found["largest_difference"] <= 0.05
    assert (tmp_path / "c/zephyr/module.yml").is_file()
    code, out, _ = command(*words)  # again, over what the first wrote
    assert code == 0
    assert "of choices differ from the float network's" in out


def test_c_is_written_for_the_clock_in_the_name_of_the_chip(command, file, tmp_path):
    words = ("export", file, "--to", "c", "-o", "c", "--observations", "5", "--chip")
    code_of = {}
    for clock in ("gated", "pipelined"):
        assert command(*words, f"loihi1:clock={clock}")[0] == 0
        code_of[clock] = (tmp_path / "c/policy.c").read_text().replace(clock, "")
    assert code_of["gated"] != code_of["pipelined"]


def texts_of(export):
    names = file_names("policy")
    return {name: f"{MARK}, {export}\n" for name in names}


def names_in(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_c_of_another_policy_is_removed_where_it_is_not_replaced(tmp_path):
    write_texts(texts_of("old"), tmp_path)
    (tmp_path / "host_i16.c").write_text("of the user\n")
    kept = {
        n: text
        for n, text in texts_of("new").items()
        if n not in {each.format(prefix="policy") for each in INT16}
    }
    export_c.write(kept, tmp_path, "policy")
    assert names_in(tmp_path) == {*kept, "host_i16.c"}


@pytest.mark.parametrize("to", ["c", "verilog", "program"])
def test_an_export_names_the_file_and_no_folder_of_the_machine(to, tmp_path, command):
    source = tmp_path / "some" / "where" / "mine.nir"
    source.parent.mkdir(parents=True)
    shutil.copy(zoo.resolve("kart-grid/snn"), source)
    more = ("--observations", 20, *(("--chip", "loihi1") if to != "verilog" else ()))
    code, _, err = command("export", source, "--to", to, *more, "-o", tmp_path / "out")
    assert code == 0, err
    texts = [path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert any(b"mine.nir" in text for text in texts)
    assert not any(str(tmp_path).encode() in text or b"some/where" in text for text in texts)
