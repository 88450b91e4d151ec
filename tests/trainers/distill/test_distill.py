import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from spikedeploy import envs
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.runtime.artifact.artifact import save
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import EnvConfig, ValidationConfig, resolve
from spikedeploy.trainers.distill.distill import (
    DaggerDataset,
    Distill,
    DistillConfig,
    DistillLearner,
    collect,
)
from spikedeploy.trainers.distill.teachers import (
    Teacher,
    policy_teacher,
    same_teacher,
    score,
    teacher,
)
from spikedeploy.trainers.metrics_file import read_metrics
from spikedeploy.trainers.policies import (
    MlpPolicy,
    PopsanPolicy,
    SpikingMlpPolicy,
)
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.train import train
from tests.delta_policies import delta_policy
from tests.networks import event_driven

HEXAPOD, LEVELS = "spikedeploy/Hexapod-v0", "tests.own_env:Levels"


@pytest.fixture(scope="module")
def onnx(tmp_path_factory):
    torch.manual_seed(1)
    path = tmp_path_factory.mktemp("teacher") / "teacher.onnx"
    return to_onnx(MlpPolicy(77, 18, hidden=(8,)), Provenance(HEXAPOD), path)


def config(onnx="", **changes):
    return resolve(DistillConfig, "smoke-distill", overrides=[f"teacher={onnx}"]).model_copy(
        update=changes
    )


def never():
    return False


def constant(action):
    return Teacher(lambda observation: np.tile(action, (len(observation), 1)), 77, 18)


def test_a_student_learns_what_its_teacher_does():
    torch.manual_seed(0)
    student = PopsanPolicy(6, 2, hidden=(32, 32), populations=5)
    observation = torch.randn(256, 6)
    label = torch.tanh(observation[:, :2])
    settings = config(learning_rate=3e-3, precision="float32")
    learner = DistillLearner(settings, student)
    errors = [float(learner.update(observation, label, k / 150)["loss"]) for k in range(150)]
    assert errors[-1] < 0.2 * errors[0]


def test_only_rates_above_their_target_are_penalised():
    student = PopsanPolicy(6, 2, hidden=(32,), populations=5)
    observation, label = torch.randn(64, 6), torch.zeros(64, 2)
    rates = {"rate_penalty": 2.0, "input_penalty": 3.0}

    def penalty(**targets):
        return float(
            DistillLearner(config(**rates, **targets), student).update(observation, label, 1.0)[
                "rate_penalty"
            ]
        )

    with torch.no_grad():
        spikes = [float(raster.mean()) for raster in student.spikes(observation)]
    assert penalty(rate_target=1.0, input_target=1.0) == 0
    assert penalty(rate_target=1.0, input_target=0.0) == pytest.approx(3 * spikes[0], rel=0.02)
    expected = 2 * sum(spikes[1:])
    assert penalty(rate_target=0.0, input_target=1.0) == pytest.approx(expected, rel=0.05)


def test_iteration_zero_acts_as_the_teacher_and_the_next_as_the_student():
    settings = config(env=EnvConfig(count=2), states=20)
    one, other = constant(np.full(18, 0.5)), constant(np.full(18, -0.5))
    previous = envs.make("hexapod").unwrapped.OBSERVATION["previous"]
    with_teacher = collect(settings, 0, one, other, never)
    with_student = collect(settings, 1, one, other, never)
    assert with_teacher[0].shape == (20, 77)
    np.testing.assert_array_equal(with_student[1], np.full((20, 18), 0.5))
    # the filtered command follows what was executed
    assert with_teacher[0][-1, previous].mean() > 0.1
    assert with_student[0][-1, previous].mean() < -0.1


def test_mixing_lets_the_teacher_execute_some_actions():
    settings = config(env=EnvConfig(count=2), states=40, mixing=0.5)
    labelled = constant(np.full(18, 0.5))
    steps = []
    student = Teacher(lambda o: steps.append(len(o)) or np.full((2, 18), -0.5), 77, 18)
    found = collect(settings, 1, labelled, student, never)
    previous = found[0][-10:, envs.make("hexapod").unwrapped.OBSERVATION["previous"]]
    assert -0.2 < previous.mean() < 0.2
    assert steps


def test_states_are_all_kept_and_drawn_at_random():
    dataset = DaggerDataset(3, 1)
    dataset.add(np.full((4, 3), 1.0), np.full((4, 1), 10.0))
    dataset.add(np.full((4, 3), 2.0), np.full((4, 1), 20.0))
    observation, action = dataset.sample(200, np.random.default_rng(0))
    assert len(dataset) == 8
    assert 60 < int((observation[:, 0] == 1).sum()) < 140
    np.testing.assert_array_equal(action[:, 0], 10 * observation[:, 0])


def test_a_run_leaves_its_files_and_reports_its_share_of_the_teachers_return(onnx, tmp_path):
    run = train("smoke-distill", overrides=[f"teacher={onnx}"], runs=tmp_path, quiet=True)
    rows = read_metrics(run / "metrics.csv")
    assert (rows[-1]["updates"], rows[-1]["env_steps"], rows[-1]["iteration"]) == (40, 120, 1)
    state = json.loads((run / "checkpoints" / "best.json").read_text())
    assert state["eval_of_teacher"] == pytest.approx(state["eval_return"] / state["teacher_return"])
    best = max(row["eval_return"] for row in rows if "eval_return" in row)
    assert state["best"] == pytest.approx(best)
    assert {"sparsity_lif1", "sparsity_lif2", "sparsity_lif3"} <= rows[-1].keys()
    policy = RunFolder(run).policy()
    assert isinstance(policy, PopsanPolicy)
    assert float(policy.normalizer.std.min()) > 0
    assert not torch.equal(policy.normalizer.mean, torch.zeros(77))


def test_a_policy_may_learn_from_a_run_an_onnx_file_or_a_nir_file(onnx, tmp_path):
    observation = np.random.default_rng(0).normal(size=(5, 77))
    torch.manual_seed(1)
    expected = policy_teacher(MlpPolicy(77, 18, hidden=(8,))).act_all(observation)
    np.testing.assert_allclose(
        teacher(str(onnx), "hexapod").act_all(observation), expected, atol=1e-5
    )
    policy = PopsanPolicy(77, 18, hidden=(8,), populations=2)
    written = to_nir(policy, Provenance(HEXAPOD), tmp_path / "p.nir")
    found = teacher(str(written), "hexapod")
    assert (found.observations, found.actions) == (77, 18)
    np.testing.assert_allclose(
        found.act_all(observation), policy_teacher(policy.double()).act_all(observation), atol=1e-5
    )
    run = RunFolder.create(tmp_path, config())
    run.save("last", policy.float(), {})
    assert teacher(str(run.path), HEXAPOD).env == "hexapod"


@pytest.mark.parametrize("state", ["kept", "reset"])
def test_a_policy_that_acts_on_earlier_observations_is_no_teacher(state, tmp_path):
    policy = event_driven()
    convention = replace(policy.convention, state=state)
    save(replace(policy, convention=convention), tmp_path / "event.nir")
    with pytest.raises(ConfigError, match="acts on the observations before"):
        teacher(str(tmp_path / "event.nir"), "hexapod")


def test_the_teachers_score_is_its_return_on_the_validation_seeds():
    still = constant(np.zeros(18))
    validation = ValidationConfig(episodes=2, limit=5)
    env = envs.make("hexapod", max_steps=5)
    totals = []
    for seed in (5_000, 5_001):
        env.reset(seed=seed)
        totals.append(sum(env.step(np.zeros(18))[1] for _ in range(5)))
    assert score(still, EnvConfig(), validation) == pytest.approx(np.mean(totals))


def test_a_missing_or_unsuitable_teacher_is_refused_before_training(onnx, tmp_path):
    run = RunFolder.create(tmp_path, config())
    small = to_onnx(MlpPolicy(6, 2, hidden=()), Provenance(HEXAPOD), tmp_path / "small.onnx")
    command = {"env": EnvConfig(name="hexapod-command")}
    for given, changes, message in (
        ("", {}, "--set teacher=PATH"),
        (tmp_path / "none.onnx", {}, "no teacher at"),
        (tmp_path / "none", {}, "no run folder"),
        (onnx, command, "Hexapod-v0, not in hexapod-command"),
        (small, {}, "takes 6 observations"),
    ):
        with pytest.raises(ConfigError, match=message):
            Distill(config(given, **changes), run)


def test_a_shipped_policy_may_teach_by_its_name():
    for name, env, sizes in (
        ("hexapod/sac", "hexapod", (77, 18)),
        ("kart-grid/ann", "kart-grid", None),
    ):
        found = teacher(name, env)
        assert found.env == envs.spec(env).id
        assert sizes in (None, (found.observations, found.actions))
    with pytest.raises(ConfigError, match="not in hexapod-command"):
        teacher("hexapod/sac", "hexapod-command")
    with pytest.raises(ConfigError, match="did you mean the shipped policy hexapod/sac"):
        teacher("hexapod/scc", "hexapod")


def test_a_run_of_a_policy_that_keeps_its_states_is_no_teacher(tmp_path):
    run = RunFolder.create(tmp_path, config())
    run.save("last", delta_policy(obs=77, act=18, hidden=3), {})
    with pytest.raises(ConfigError, match=r"acts on the observations before.* the float policy"):
        teacher(str(run.path), "hexapod")


def test_a_run_with_discrete_actions_teaches_by_its_logits_as_its_file_does(tmp_path):
    policy = MlpPolicy(4, 3, hidden=(5,), head="discrete").eval()
    observation = np.random.default_rng(0).normal(size=(6, 4))
    file = to_onnx(policy, Provenance("kart-grid"), tmp_path / "t.onnx")
    expected = teacher(str(file), "kart-grid").act_all(observation)
    np.testing.assert_allclose(policy_teacher(policy).act_all(observation), expected, atol=1e-5)
    assert expected.shape == (6, 3)


def test_a_student_learns_the_choices_of_its_teacher_from_logits():
    torch.manual_seed(0)
    student = MlpPolicy(4, 3, hidden=(16,), head="discrete")
    observation = torch.randn(256, 4)
    label = 5.0 * observation[:, :3]
    learner = DistillLearner(config(learning_rate=2e-2, precision="float32"), student)
    errors = [float(learner.update(observation, label, k / 200)["loss"]) for k in range(200)]
    target = torch.softmax(label, -1)
    least = float(-(target * target.log()).sum(-1).mean())  # entropy of the teacher
    assert least < errors[-1] < least + 0.1 * (errors[0] - least)
    assert float((student(observation) == label.argmax(-1)).float().mean()) > 0.95


def test_discrete_actions_are_executed_as_choices_of_which_noise_draws_some():
    settings = config(env=EnvConfig(name=LEVELS, count=2), states=40)
    labels = Teacher(lambda seen: 9.0 * np.eye(3, 4)[seen.argmax(-1)], 3, 4)
    found = collect(settings, 0, labels, labels, never)
    assert found[1].shape == (40, 4)
    assert set(found[2]) == {5.0}
    noisy = collect(settings.model_copy(update={"noise": 0.5}), 0, labels, labels, never)
    assert 0.0 < np.mean(noisy[2]) < 5.0


def test_a_spiking_file_with_discrete_actions_teaches_by_its_scores(tmp_path):
    policy = SpikingMlpPolicy(4, 2, hidden=(8,), timesteps=4, head="discrete").eval()
    file = to_nir(policy, Provenance("CartPole-v1"), tmp_path / "t.nir")
    seen = np.random.default_rng(0).normal(size=(6, 4))
    found = teacher(str(file), "CartPole-v1").act_all(seen)
    assert found.shape == (6, 2)
    np.testing.assert_array_equal(found.argmax(-1), policy(torch.from_numpy(seen).float()))


def test_a_teacher_is_the_same_under_its_name_its_path_and_as_a_copy(onnx, tmp_path):
    copy = tmp_path / "copy.onnx"
    copy.write_bytes(onnx.read_bytes())
    assert same_teacher("hexapod/sac", "spikedeploy/zoo/hexapod/sac.onnx")
    assert same_teacher(str(onnx), str(copy))
    assert same_teacher("gone.onnx", "gone.onnx")
    assert not same_teacher(str(onnx), "hexapod/sac")
    assert not same_teacher("gone.onnx", str(onnx))
