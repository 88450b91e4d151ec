"""Python objects where commands take names: environments, teachers, networks, settings."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

import spikedeploy as sd
from spikedeploy.objects import env_target, overrides_of, target, teacher_target
from spikedeploy.runtime.errors import ConfigError
from tests import own_networks
from tests.own_env import Levels
from tests.own_teachers import level_logits

pytest.importorskip("torch")

FEW = {
    "updates": 16, "iterations": 1, "states": 32, "batch": 8, "env": {"count": 2},
    "validation": {"every": 16, "episodes": 1}, "policy": {"timesteps": 4},
}  # fmt: skip


class Model:
    """What a model of Stable-Baselines3 is to its user."""

    def predict(self, observation, deterministic=False):
        assert deterministic
        return np.zeros(len(observation), np.int64), None


def test_classes_and_functions_have_their_own_names():
    assert target(Levels) == "tests.own_env:Levels"
    assert target(level_logits) == "tests.own_teachers:level_logits"
    assert target("hexapod/sac") == "hexapod/sac"


def test_instances_and_inner_functions_are_kept_for_this_process():
    def inner(observation):
        return 0

    name = target(inner)
    assert name.startswith("spikedeploy.objects:inner_")
    assert target(inner) == name
    assert target(lambda observation: 1) != name
    made = gymnasium.make("CartPole-v1")
    module, _, within = env_target(made).partition(":")
    assert env_target(made) == f"{module}:{within}"
    again = getattr(__import__(module, fromlist=[within]), within)()
    assert again is not made
    assert again.spec.id == "CartPole-v1"


def test_settings_are_text_or_nested_dicts():
    assert overrides_of({"updates": 8, "policy": {"timesteps": 4}, "env.count": 2}) == [
        "updates=8", "policy.timesteps=4", "env.count=2",
    ]  # fmt: skip
    assert overrides_of(["seed=1"]) == ["seed=1"]


def test_a_network_is_distilled_from_a_function_compared_and_exported(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = sd.distill(
        Levels, level_logits, network=own_networks.Net, chip="loihi1", overrides=FEW, quiet=True
    )
    policy = sd.load(run).on("loihi1")
    assert policy.artifact.trained_for == "loihi1"
    found = sd.compare(Levels, [policy], teacher=level_logits, episodes=2)
    assert any("level_logits" in row["policy"] for row in found.rows)
    written = sd.export(run, "student.nir", to="nir")
    assert written.is_file()
    assert written.name == "student.nir"
    firmware = sd.export(run, "firmware", to="c", env=Levels)
    assert (firmware / "policy.c").is_file()
    # an instance has a name in this process alone, and sizes decide whether the policy fits it
    assert sd.compare(Levels(), run, chips="loihi1", episodes=1).rows
    with pytest.raises(ConfigError, match=r"observes|puts out"):
        sd.compare(gymnasium.make("Pendulum-v1"), policy, episodes=1)
    with pytest.raises(ConfigError, match="unknown format 'rust'"):
        sd.export(run, to="rust")


def test_a_model_with_predict_is_a_teacher(tmp_path):
    module, _, within = teacher_target(Model()).partition(":")
    predict = getattr(__import__(module, fromlist=[within]), within)
    assert predict.vectorised
    assert predict(np.zeros((3, 2))).shape == (3,)


def test_an_instance_of_a_network_is_trained_by_reward(tmp_path):
    network = own_networks.Net(24, 2)
    before = network.fc1.weight.clone()
    run = sd.train(
        Levels, network=network, chip="loihi1", runs=tmp_path, quiet=True,
        overrides={
            "steps": 32, "horizon": 16, "env.count": 2, "epochs": 1, "policy.timesteps": 4,
            "validation": {"every": 32, "episodes": 1},
        },
    )  # fmt: skip
    assert (run / "checkpoints" / "best.safetensors").is_file()
    assert (network.fc1.weight == before).all()  # a run trains a copy
    with pytest.raises(ConfigError, match="needs a recipe"):
        sd.train(Levels)


def test_settings_are_numbers_of_numpy_arrays_and_paths_too():
    given = {"steps": np.int64(2), "policy": {"hidden": np.arange(2), "network": Path("x.nir")}}
    wanted = ["steps=2", "policy.hidden=[0, 1]", 'policy.network="x.nir"']
    assert overrides_of(given) == wanted
    with pytest.raises(ConfigError, match="a setting is a set"):
        overrides_of({"steps": {1}})
