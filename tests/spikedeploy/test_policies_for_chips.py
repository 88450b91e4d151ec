"""The contract of every policy that was trained for one chip, and of the table of them."""

import json

import numpy as np
import pytest
import typer

from spikedeploy import envs, zoo
from spikedeploy.commands.training import train
from spikedeploy.comparison.evaluation import line_up
from spikedeploy.policies.registry import find
from spikedeploy.runtime import SpikingController, load
from spikedeploy.runtime.chips import CHIPS
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import check
from spikedeploy.runtime.errors import ConfigError, EnvError

FILES = [file for file in zoo.for_chips() if file.suffix == ".nir"]


@pytest.fixture(params=FILES, ids=lambda file: f"{file.parent.name}/{file.stem}")
def file(request):
    return request.param


def test_the_design_rules_of_its_chip_accept_it(file):
    found = check(load(file), chip(file.stem))
    assert found.passed, [each.describe(file.stem) for each in found.results if each.failed]


def test_it_acts_in_its_environment_on_its_chip(file):
    world = envs.make(file.parent.name)
    observation, _ = world.reset(seed=10_000)
    controller = SpikingController(load(file), chip(file.stem))
    actions = controller.act_batch(np.stack([observation, -observation]))
    assert actions.shape[1:] == world.action_space.shape
    assert controller.ledger.total("spike_out") > 0


def test_its_card_says_how_it_was_trained_and_that_it_does_what_was_trained(file):
    card = json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))
    assert card["sha256"] == zoo.sha256(file)
    assert card["config"]["policy"]["chip"] == file.stem
    assert card["config"]["teacher"] == zoo.teacher(file.parent.name)
    assert card["seed"] < 5_000
    checks = [each for each in card["parity"] if "for information" not in each["name"]]
    assert len(checks) >= 2
    assert all(each["passed"] for each in checks)


def test_at_least_six_chips_beside_loihi1_have_policies_for_two_tasks():
    tasks = {}
    for each in FILES:
        tasks.setdefault(each.stem, set()).add(each.parent.name)
    assert set(tasks) <= set(CHIPS)
    assert sum(len(found) >= 2 for name, found in tasks.items() if name != "loihi1") >= 6


def test_it_is_found_by_name_runs_on_its_chip_and_stands_in_no_line_up(file):
    name, env = f"chips/{file.parent.name}/{file.stem}", file.parent.name
    assert zoo.path(name) == file
    assert file not in zoo.policies()
    assert name not in zoo.names()
    entries = line_up(env, [str(file)], None)
    assert [e.chip for e in entries if e.candidate.kind == "snn"] == [file.stem]
    assert find(name).default_chip == file.stem
    assert not entries[0].remark
    beside = line_up(env, [str(file)], ["int"])[0]
    assert f"was trained for {file.stem}, and runs on int here" in beside.remark


def test_chips_are_separated_by_commas_or_given_again(stroll, command):
    words = ("compare", "stroll", "stroll/popsan", "--episodes", 1, "--workers", 1, "--json")
    code, out, err = command(*words, "--chip", "int,loihi1", "--chip", "ideal")
    assert code == 0, err
    chips = [row["chip"] for row in json.loads(out)["rows"] if row["kind"] == "snn"]
    assert chips == ["float", "int", "loihi1", "ideal"]


def test_the_teacher_of_a_task_is_the_one_that_is_shipped():
    assert zoo.teacher("CartPole-v1") == "chips/CartPole-v1/teacher"
    assert zoo.teacher("hexapod") == "hexapod/sac"
    assert zoo.teacher("Acrobot-v1") is None


@pytest.mark.parametrize(("words", "error", "said"), [
    ({"what": None}, typer.BadParameter, None),
    ({"what": "CartPole-v1", "recipe": "ppo-snn"}, typer.BadParameter, None),
    ({"what": "Acrobot-v1"}, ConfigError,
     r"no float teacher of Acrobot-v1 is shipped.*distill my_module:pilot --env Acrobot-v1"),
    ({"what": "tests.own_env:Reech"}, EnvError, r"has no 'Reech'; did you mean 'Reach'\?"),
])  # fmt: skip
def test_for_goes_with_an_environment_that_has_a_teacher(words, error, said):
    with pytest.raises(error, match=said):
        train(**{"recipe": None, **words}, chip="odin")


def test_they_are_listed_beside_the_others(command):
    rows = json.loads(command("policies", "--json")[1])
    chips = {row["name"]: row["chip"] for row in rows}
    assert all(chips[f"chips/{each.parent.name}/{each.stem}"] == each.stem for each in FILES)


def test_drift_is_of_the_chip_that_it_was_trained_for(command):
    _, out, _ = command("drift", "chips/CartPole-v1/tinyodin", "--steps", 5, "--json")
    assert json.loads(out)["chip"] == "tinyodin"


def test_a_cut_card_is_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(zoo, "FOLDER", tmp_path)
    (tmp_path / "hexapod").mkdir()
    (tmp_path / "hexapod" / "mine.nir").write_bytes(b"policy")
    (tmp_path / "hexapod" / "mine.json").write_text('{"kind": "sn')
    with pytest.raises(ConfigError, match=r"mine\.json is damaged .* again"):
        zoo.card("hexapod/mine")
