"""The contract of every shipped policy; a new file is tested without touching this one."""

import json

import gymnasium
import numpy as np
import pytest

from spikedeploy import envs, zoo
from spikedeploy.comparison.lineup import line_up
from spikedeploy.policies.registry import find, open_policy

SHIPPED = zoo.policies()


def name(path):
    return f"{path.parent.name}/{path.stem}"


@pytest.fixture(params=SHIPPED, ids=name)
def path(request):
    return request.param


@pytest.fixture
def card(path):
    return json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))


def test_it_acts_in_the_environment_of_its_folder(path):
    candidate = find(str(path))
    world = envs.make(path.parent.name)
    player = open_policy(candidate, "loihi1" if candidate.kind == "snn" else None, world)
    observation, _ = world.reset(seed=10_000)
    player.reset(10_000)
    # through a pipeline an observation acts one or two control steps later
    actions = np.stack([player.act(sign * observation) for sign in (1, -1, 1, -1, -1, -1)])
    assert actions.shape[1:] == world.action_space.shape
    assert np.ptp(actions) > 0
    if isinstance(world.action_space, gymnasium.spaces.Box):
        assert np.abs(actions).max() <= 1


def test_its_card_names_recipe_seed_steps_and_commit(path, card):
    assert card["file"] == path.name
    assert card["kind"] == find(str(path)).kind
    assert card["env"] == envs.spec(path.parent.name).id
    assert card["recipe"]
    assert card["seed"] < 5_000
    assert card["steps"] > 0
    assert len(card["commit"]) == 40


def test_its_card_shows_that_it_was_evaluated_on_unseen_seeds(card):
    assert card["evaluation"]
    assert all(row["episodes"] >= 20 for row in card["evaluation"])
    assert all(check["passed"] for check in card["parity"])


def test_it_has_a_page_and_a_curve_for_people(path):
    assert path.with_suffix(".md").read_text(encoding="utf-8").startswith(f"# {path.stem}\n")
    assert path.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert path.with_suffix(".csv").stat().st_size > 100


def test_names_are_unique():
    assert len(set(zoo.names())) == len(zoo.names())


@pytest.mark.skipif(not SHIPPED, reason="no policies are shipped yet")
@pytest.mark.parametrize("env", ["hexapod", "hexapod-command"])
def test_each_task_has_a_float_ann_a_spiking_policy_and_the_three_controls(env):
    kinds = {path.stem: find(str(path)).kind for path in zoo.policies(env)}
    assert set(kinds.values()) == {"ann", "snn", "control"}
    assert {stem for stem, kind in kinds.items() if kind == "control"} >= {
        "phase", "bilinear", "linear",
    }  # fmt: skip


def test_the_command_task_has_every_float_control_in_its_line_up():
    found = [entry.label for entry in line_up("hexapod-command", [], ["loihi1"])]
    assert [label for label in found if label.startswith(("fourier", "linear", "mlp"))] == [
        "fourier", "linear", "mlp-8", "mlp-16", "mlp-32", "mlp-64",
    ]  # fmt: skip


@pytest.mark.parametrize("env", ["kart-grid", "kart-gazebo", "kart-steer"])
def test_each_kart_world_has_the_small_and_the_linear_driver_in_its_line_up(env):
    found = [entry.label for entry in line_up(env, [], ["loihi1"])]
    assert found[-2:] == ["linear", "small"]


@pytest.mark.parametrize("env", ["hexapod", "hexapod-command"])
def test_a_distilled_control_is_small_and_its_card_names_recipe_and_teacher(env):
    teachers = {"hexapod": {"sac"}, "hexapod-command": {"sac", "smooth"}}[env]
    for path in zoo.policies(env):
        if find(str(path)).kind != "control":
            continue
        assert path.stat().st_size < 50_000
        card = zoo.card(f"{env}/{path.stem}")
        assert card["recipe"] == f"{env}-{path.stem}"
        teacher = card["config"]["teacher"].removeprefix("spikedeploy/zoo/").removesuffix(".onnx")
        assert teacher in {f"{env}/{name}" for name in teachers}
        assert f'"{card["config"]["teacher"]}"' in path.with_suffix(".md").read_text("utf-8")


@pytest.mark.parametrize("env", sorted({path.parent.name for path in SHIPPED}))
def test_each_task_has_a_float_ann_that_others_are_measured_against(env):
    kinds = [find(str(path)).kind for path in zoo.policies(env)]
    assert {"ann", "snn"} <= set(kinds)


def test_the_published_teacher_stays_what_others_are_measured_against():
    first, second, *_ = line_up("hexapod-command", [], ["loihi1"])
    assert (first.label, second.label) == ("sac", "smooth")
    assert second.reference == first


def test_a_smooth_walker_earns_more_with_less_energy_than_the_first_teacher():
    first, smooth = (zoo.card(f"hexapod-command/{n}")["evaluation"][0] for n in ("sac", "smooth"))
    assert smooth["return_ci95"][0] > first["return_ci95"][1]
    assert smooth["cot"] < 0.75 * first["cot"]


def test_reports_name_shipped_files_without_the_folders_of_the_machine():
    assert all(zoo.called(str(path)) == "/".join(path.parts[-2:]) for path in zoo.policies())
    assert zoo.called("elsewhere/policy.nir") == "elsewhere/policy.nir"
