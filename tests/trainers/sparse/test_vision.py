"""Students that see by events: trained, resumed, pruned and rounded."""

import json

import numpy as np
import pytest
import torch

from lab.kill import differences
from spikedeploy.exporters.parity import check
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.config import VisionConfig, VisionSnnConfig, resolve
from spikedeploy.trainers.metrics import read
from spikedeploy.trainers.policies import from_config
from spikedeploy.trainers.policies.vision import SIGNS, vision_artifact
from spikedeploy.trainers.run_folder import RunFolder, load_policy
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.controllers import controller_of
from spikedeploy.trainers.sparse.phases import planned
from spikedeploy.trainers.sparse.pool import Walk, WalkPool, Windows
from spikedeploy.trainers.sparse.vision import (
    EventsOnChip,
    VisionStudent,
    mirrored,
    rounding_of_kernels,
)
from spikedeploy.trainers.train import train
from tests.trainers.test_resume import After, resumed

SHORT = ["validation.limit=12", "validation.episodes=1"]


@pytest.mark.parametrize("kind", ["cnn", "snn"])
def test_a_stopped_training_ends_with_the_same_files_and_keeps_its_budget(kind, tmp_path):
    recipe = f"smoke-eye-{kind}"
    whole = train(recipe, overrides=SHORT, runs=tmp_path / "whole", quiet=True)
    part = train(recipe, overrides=SHORT, runs=tmp_path / "part", quiet=True, interrupt=After(7))
    resumed(part)
    assert differences(whole, part) == []
    rows = read(whole / "metrics.csv")
    operations = {row["updates"]: row["operations"] for row in rows if "operations" in row}
    best = json.loads((whole / "checkpoints" / "best.json").read_text())
    # by the estimate of training, which follows its few updates slowly
    assert operations[max(operations)] <= 1.2 * 400 < max(operations.values())
    assert best["eval_operations"] > 0


@pytest.fixture(scope="module")
def guide(tmp_path_factory):
    return train("smoke-eye-cnn", overrides=SHORT, runs=tmp_path_factory.mktemp("runs"), quiet=True)


def test_a_student_with_a_guide_starts_from_its_kernels_and_is_written_as_it_is(guide, tmp_path):
    """Its walks are the guide's, and its training goes on to the same bits."""
    settings = [*SHORT, f"guide={guide}", f"pool={guide}", "teacher_walks=0", "noisy_walks=0"]
    settings += ["policy.most=2"]
    whole = train("smoke-eye-snn", overrides=settings, runs=tmp_path / "whole", quiet=True)
    runs, stop = tmp_path / "part", After(7)
    part = train("smoke-eye-snn", overrides=settings, runs=runs, quiet=True, interrupt=stop)
    resumed(part)
    assert differences(whole, part) == []
    policy = load_policy(whole)
    observations = np.random.default_rng(0).poisson(0.3, (60, 1024)).astype(np.float64)
    path = to_nir(policy, Provenance("kart-eye"), tmp_path / "policy.nir")
    checks = check(policy, path, observations)
    assert [found.passed for found in checks] == [True] * 7


def test_a_training_goes_on_at_another_control_rate_from_what_was_pruned(tmp_path):
    first = train("smoke-eye-snn", overrides=SHORT, runs=tmp_path, quiet=True)
    settings = [*SHORT, f"start={first}", "env.options.rate=240"]
    config = resolve(SparseConfig, "smoke-eye-snn", overrides=settings)
    policy = from_config(config.policy, 1024, 7, 4.0, None, "discrete")
    student = VisionStudent(policy, config)
    student.begin(WalkPool(), np.random.default_rng(0))
    before = RunFolder(first).policy(next(iter(RunFolder(first).levels.values())))
    for name in policy.synapses:
        assert (policy.matrix(name).mask == before.matrix(name).mask).all()
    assert any((policy.matrix(name).mask == 0).any() for name in policy.synapses)
    torch.testing.assert_close(policy.decay("out"), before.decay("out") ** (1 / 4))
    gain = (1 - policy.decay("conv1")) / (1 - before.decay("conv1"))
    torch.testing.assert_close(policy.biases["conv1"], before.biases["conv1"] * gain)
    second = train("smoke-eye-snn", overrides=settings, runs=tmp_path / "on", quiet=True)
    assert load_policy(second).spec() == before.spec()


def test_a_float_training_goes_on_at_another_control_rate(guide, tmp_path):
    settings = [*SHORT, f"start={guide}", "env.options.rate=240"]
    second = train("smoke-eye-cnn", overrides=settings, runs=tmp_path, quiet=True)
    before = RunFolder(guide).policy(next(iter(RunFolder(guide).levels.values())))
    assert load_policy(second).spec() == before.spec()


def test_a_slowed_float_policy_remembers_for_as_long():
    config = VisionConfig(shape=(2, 4, 4), channels=(2,), kernels=(3,), strides=(1,), gru=5)
    policy = from_config(config, 32, 7, head="discrete")
    with torch.no_grad():
        policy.biases["gru"][5:10] += 4.0  # so that the memory lasts
    steady = torch.full((1, 40, 32), 4.0)
    memory = policy.unrolled(steady, policy.weights(), policy.rest(1)).state[1]
    slow = policy.slowed(4)
    found = slow.unrolled(steady.repeat(1, 4, 1) / 4, slow.weights(), slow.rest(1)).state[1]
    assert memory.abs().max() > 0.1
    torch.testing.assert_close(found, memory, rtol=0.05, atol=0.005)
    with pytest.raises(ConfigError, match="leaky traces"):
        from_config(config.model_copy(update={"traces": (0.5,)}), 32, 7).slowed(4)


@pytest.mark.parametrize("setting", ["guide", "start"])
def test_policies_that_do_not_see_take_no_other_policy(setting, guide, tmp_path):
    with pytest.raises(ConfigError, match=f"{setting}: .* policies that see"):
        train("smoke-sparse", overrides=[f"{setting}={guide}"], runs=tmp_path, quiet=True)


def test_a_start_that_is_something_else_is_refused(guide):
    config = resolve(SparseConfig, "smoke-eye-snn", overrides=[f"start={guide}"])
    student = VisionStudent(from_config(config.policy, 1024, 7, 4.0, None, "discrete"), config)
    with pytest.raises(ConfigError, match="not one as is trained here"):
        student.begin(WalkPool(), np.random.default_rng(0))


def test_a_guide_lends_kernels_to_further_channels_alike(guide):
    config = resolve(SparseConfig, "smoke-eye-snn", overrides=[f"guide={guide}", "policy.most=2"])
    policy = from_config(config.policy, 1024, 7, head="discrete")
    student = VisionStudent(policy, config)
    normalised = []
    policy.normalise = normalised.append
    student.begin(pool_of_counts(), np.random.default_rng(0))
    own, known = (each.matrix("conv1").weight for each in (policy, student.guide))
    assert torch.equal(own[:, 0::2], known)
    assert torch.equal(own[:, 1::2], known)
    assert len(normalised) == 1


def pool_of_counts():
    counts = np.random.default_rng(0).poisson(0.3, (30, 1024)).astype(np.uint8)
    pool = WalkPool([Walk(counts, np.zeros((30, 10), np.float32))])
    pool.take_observations()
    return pool


def test_labels_of_a_guide_are_its_outputs_through_the_whole_walk(guide):
    config = resolve(SparseConfig, "smoke-eye-snn", overrides=[f"guide={guide}"])
    student = VisionStudent(from_config(config.policy, 1024, 7, head="discrete"), config)
    pool = pool_of_counts()
    student.prepare(pool)
    label = pool.windows(np.array([0]), np.array([5]), 20).label[0]
    state, seen = student.guide.rest(1), torch.from_numpy(pool.walks[0].observation[:25]).float()
    said = [student.guide.advance(counts[None], state)[0][0] for counts in seen]
    assert label.shape == (20, 20)
    torch.testing.assert_close(label[:, 10:17], torch.stack(said)[5:].detach())


def test_a_guide_with_other_kernels_lends_none(guide):
    settings = [f"guide={guide}", "policy.channels=[4, 3]"]
    config = resolve(SparseConfig, "smoke-eye-snn", overrides=settings)
    policy = from_config(config.policy, 1024, 7, head="discrete")
    policy.normalise = lambda counts: None
    before = [policy.matrix(name).weight.clone() for name in ("conv1", "conv2")]
    VisionStudent(policy, config).begin(pool_of_counts(), np.random.default_rng(0))
    after = [policy.matrix(name).weight for name in ("conv1", "conv2")]
    assert all(map(torch.equal, before, after))


def test_a_guide_that_sees_something_else_is_refused(guide):
    config = resolve(SparseConfig, "smoke-eye-snn", overrides=[f"guide={guide}"])
    policy = from_config(VisionSnnConfig(shape=(2, 8, 32), hidden=4), 512, 7, head="discrete")
    with pytest.raises(ConfigError, match="Give a run of one"):
        VisionStudent(policy, config)


def test_nothing_is_pruned_on_the_way_to_a_budget_that_is_not_reached():
    config = resolve(SparseConfig, "kart-eye-gru")
    assert [phase.last for phase in planned(config)] == [None] * config.dense_rounds + [1e6]


def test_a_mirrored_window_is_that_of_the_other_arm():
    policy = from_config(VisionSnnConfig(shape=(2, 2, 3), hidden=4), 12, 7, head="discrete")
    seen = torch.arange(24).view(2, 1, 12)
    label = torch.tensor([[0.0, 1, 2, 3, 4, 5, 6, 0, 1, 0]]).repeat(2, 1)[:, None]
    windows = Windows(seen, seen[..., :0], label, torch.ones(2) > 0)
    counts, labels = mirrored(windows, torch.tensor([False, True]), policy)
    assert counts[0].tolist() == seen[0].tolist()
    assert counts[1, 0].tolist() == [14, 13, 12, 17, 16, 15, 20, 19, 18, 23, 22, 21]
    assert labels[:, 0, 0].tolist() == [
        [0, 1, 2, 3, 4, 5, 6, 0, 1, 0],
        [6, 5, 4, 3, 2, 1, 0, 0, 0, 1],
    ]


def test_rounded_weights_are_multiples_of_the_chips_step():
    torch.manual_seed(0)
    config = VisionSnnConfig(channels=(3, 4), hidden=9, memory=4)
    policy = from_config(config, 1024, 7, head="discrete")
    offsets = rounding_of_kernels(policy, chip("loihi1"))
    assert offsets.keys() == policy.weights().keys()
    for name in ("conv1", "conv2", "out"):
        weight = (policy.weights()[name] + offsets[name]).detach().double().numpy()
        step = np.unique(np.abs(weight[np.abs(weight) > 1e-6])).min()
        levels = np.abs(weight).max() / step
        assert offsets[name].abs().max() > 0
        assert offsets[name].abs().max() <= 1.01 * np.abs(weight).max() / 127
        assert levels < 260


@pytest.mark.parametrize(("recipe", "on"), [("kart-eye-snn", "loihi1"), ("kart-eye-if", "speck2f")])
def test_a_spiking_student_keeps_the_design_rules_of_its_chip(recipe, on):
    policy = from_config(resolve(SparseConfig, recipe).policy, 1024, 7, head="discrete")
    assert compile_program(vision_artifact(policy), chip(on)).layers


def test_windows_hold_what_was_seen_and_nothing_outside_of_a_walk():
    rng = np.random.default_rng(0)
    shapes = [(6, 4), (9, 4)]
    pool = WalkPool([Walk(rng.integers(1, 9, s, np.uint8), np.zeros((s[0], 10))) for s in shapes])
    pool.take_observations()
    windows = pool.windows(np.array([0, 1]), np.array([-2, 4]), 8)
    first, second = (walk.observation for walk in pool.walks)
    nothing = np.zeros((2, 4), np.uint8)
    np.testing.assert_array_equal(windows.seen[0], np.concatenate([nothing, first]))
    np.testing.assert_array_equal(windows.seen[1], [*second[4:], *[second[0] * 0] * 3])
    assert windows.moved.shape == (2, 8, 0)
    assert windows.begins.tolist() == [True, False]


def test_a_student_of_a_chip_that_works_event_by_event_learns_from_what_it_does_there():
    settings = ['chip="speck2f:queue=on"', "batch=3", "window=9", "burn_in=2"]
    config = resolve(SparseConfig, "kart-eye-if", overrides=settings)
    policy = from_config(config.policy, 1024, 7, 4.0, None, "discrete")
    student = VisionStudent(policy, config)
    rng = np.random.default_rng(0)
    counts = rng.poisson(0.4, (3, 9, 1024)).astype(np.float64)
    with torch.no_grad():
        policy.normalise(torch.from_numpy(counts).float())
        policy.synapses["out"].weight.mul_(5)
    seen = EventsOnChip(chip(config.chip)).seen(policy, torch.from_numpy(counts).float())
    given = torch.from_numpy(counts).float(), policy.weights(), policy.rest(3)
    by_events, by_timesteps = policy.unrolled(*given, seen), policy.unrolled(*given)
    assert not torch.equal(by_events.mean, by_timesteps.mean)
    controller = controller_of(policy, chip(config.chip))
    controller.reset(3)
    acted = [controller.act_batch(rows) for rows in counts.transpose(1, 0, 2)]
    np.testing.assert_array_equal(by_events.mean.argmax(-1).T, np.stack(acted))
    walk = Walk(counts[0].astype(np.uint8), np.zeros((9, 7 + SIGNS), np.float32), False)
    pool = WalkPool()
    pool.add([walk])
    student.prepare(pool)
    error, _ = student.loss(pool, rng)
    error.backward()
    assert all(policy.matrix(name).weight.grad.abs().sum() > 0 for name in policy.synapses)
