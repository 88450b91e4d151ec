"""The contract of every shipped policy; a new file is tested without touching this one."""

import json

import gymnasium
import numpy as np
import pytest

from lab.publish import page
from spikedeploy import envs, zoo
from spikedeploy.comparison.evaluation import line_up
from spikedeploy.policies.registry import find, open_policy

SHIPPED = zoo.policies()


def name(path):
    return f"{path.parent.name}/{path.stem}"


@pytest.fixture(params=SHIPPED, ids=name)
def path(request):
    return request.param


def test_it_acts_in_the_environment_of_its_folder(path):
    candidate = find(str(path))
    world = envs.make(path.parent.name)
    player = open_policy(candidate, candidate.default_chip, world)
    observation, _ = world.reset(seed=10_000)
    if not observation.any():  # a camera sees no event before something moves
        observation = sum(world.step(3)[0] for _ in range(20))
    player.reset(10_000)
    # through a pipeline an observation acts one or two control steps later
    actions = np.stack([player.act(sign * observation) for sign in (1, -1, 1, -1, -1, -1)])
    assert actions.shape[1:] == world.action_space.shape
    assert np.ptp(actions) > 0
    if isinstance(world.action_space, gymnasium.spaces.Box):
        assert np.abs(actions).max() <= 1


def test_it_has_a_card_a_page_and_a_curve(path):
    card = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
    assert card["file"] == path.name
    assert card["kind"] == find(str(path)).kind
    assert card["env"] == envs.spec(path.parent.name).id
    assert card["recipe"]
    assert card["seed"] < 5_000
    assert card["steps"] > 0
    assert len(card["commit"]) == 40
    assert card["evaluation"]  # on seeds that training never saw
    assert all(row["episodes"] >= 20 for row in card["evaluation"])
    assert all(check["passed"] for check in card["parity"])
    assert path.with_suffix(".md").read_text("utf-8") == page(path.stem, card)
    assert path.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    assert path.with_suffix(".csv").stat().st_size > 100
    assert zoo.name_in_reports(str(path)) == "/".join(path.parts[-2:])  # no folder of the machine


def test_names_are_unique():
    assert len(set(zoo.names())) == len(zoo.names())


@pytest.mark.parametrize("env", sorted({path.parent.name for path in SHIPPED}))
def test_each_task_has_a_float_ann_and_a_spiking_policy_the_walkers_three_controls(env):
    kinds = {path.stem: find(str(path)).kind for path in zoo.policies(env)}
    assert {"ann", "snn"} <= set(kinds.values())
    controls = {stem for stem, kind in kinds.items() if kind == "control"}
    assert controls >= ({"phase", "bilinear", "linear"} if env.startswith("hexapod") else set())


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


def test_the_published_teacher_stays_what_others_are_measured_against():
    first, second, *_ = line_up("hexapod-command", [], ["loihi1"])
    assert (first.label, second.label) == ("sac", "smooth")
    assert second.reference == first


def test_a_smooth_walker_earns_more_with_less_energy_than_the_first_teacher():
    first, smooth = (zoo.card(f"hexapod-command/{n}")["evaluation"][0] for n in ("sac", "smooth"))
    assert smooth["return_ci95"][0] > first["return_ci95"][1]
    assert smooth["cot"] < 0.75 * first["cot"]
