"""The registry: one way to open files, run folders, shipped names and the gait."""

from dataclasses import replace

import numpy as np
import pytest

from spikedeploy import envs, zoo
from spikedeploy.envs.rollout import rollout
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.policies.registry import FORMATS, Candidate, find, open_policy
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.errors import ArtifactError, ConfigError, ObservationError
from spikedeploy.trainers.config import MlpConfig, PopsanConfig
from tests import toy_stroll_env
from tests.networks import event_driven


@pytest.fixture
def world(monkeypatch):
    toy_stroll_env.install(monkeypatch)
    return envs.make("stroll")


def write(kind, folder):
    makers = {
        ".onnx": lambda: toy_stroll_env.ann(folder / "sac.onnx"),
        ".nir": lambda: toy_stroll_env.snn(folder / "popsan.nir"),
        "run": lambda: toy_stroll_env.run_folder(folder, MlpConfig(hidden=(8,))),
        "gait": lambda: "gait",
        "random": lambda: "random",
    }
    return str(makers[kind]())


# test_gap.py, test_native.py, test_compared_teachers.py and tests/examples
ELSEWHERE = ("gap", "expert", ".so", "teacher", "function")


@pytest.mark.parametrize("kind", [kind for kind in FORMATS if kind not in ELSEWHERE])
def test_every_format_opens_acts_replays_and_is_priced(kind, world, tmp_path):
    candidate = find(write(kind, tmp_path))
    chip = "loihi1" if candidate.kind == "snn" else None
    player = open_policy(candidate, chip, world)
    observations = np.random.default_rng(0).normal(size=(4, 3))
    player.reset(10_000)
    acted = np.stack([player.act(observation) for observation in observations])
    assert acted.shape == (4, 2)
    assert np.abs(acted).max() <= 1
    player.reset(10_000)
    np.testing.assert_allclose(player.replay(observations), acted, atol=1e-6)
    assert player.costs(rollout(world, player, 10_000)).energy_unknown is not None


@pytest.mark.parametrize("chip", ["float", "loihi1"])
def test_an_event_driven_policy_answers_for_an_episode_in_its_order(chip, world, tmp_path):
    policy = event_driven()
    save(replace(policy, provenance=toy_stroll_env.ORIGIN), tmp_path / "event.nir")
    candidate = find(str(tmp_path / "event.nir"))
    player = open_policy(candidate, chip, world)
    played = rollout(world, player, 10_000)
    ledger = player.ledger
    player.reset(10_000)
    np.testing.assert_array_equal(player.replay(played.observation[:-1]), played.action)
    np.testing.assert_array_equal(player.ledger.counts, ledger.counts)


@pytest.mark.parametrize(("kind", "name", "expected"), [
    (".onnx", "sac", "ann"), (".nir", "popsan", "snn"), ("gait", "gait", "gait"),
    ("random", "random", "random"),
])  # fmt: skip
def test_a_candidate_says_what_it_is(kind, name, expected, world, tmp_path):
    candidate = find(write(kind, tmp_path))
    assert (candidate.name, candidate.kind) == (name, expected)
    if kind.startswith("."):
        assert (candidate.env, candidate.observed, candidate.actions) == (toy_stroll_env.ID, 3, 2)


def test_run_folders_are_ann_or_snn_by_their_policy(world, tmp_path):
    assert find(str(toy_stroll_env.run_folder(tmp_path, MlpConfig(hidden=(4,))))).kind == "ann"
    spiking = find(
        str(toy_stroll_env.run_folder(tmp_path, PopsanConfig(hidden=(4,), populations=2)))
    )
    assert spiking.kind == "snn"
    assert open_policy(spiking, "float", world).act(np.zeros(3)).shape == (2,)
    with pytest.raises(ConfigError, match="export it first: spikedeploy export"):
        open_policy(spiking, "loihi1", world)


def test_shipped_policies_go_by_short_names(world, monkeypatch, tmp_path):
    (tmp_path / "stroll").mkdir()
    path = toy_stroll_env.ann(tmp_path / "stroll/sac.onnx")
    monkeypatch.setattr(zoo, "FOLDER", tmp_path)
    assert find("stroll/sac").path == find("stroll/sac.onnx").path == str(path)
    with pytest.raises(ConfigError, match=r"'stroll/sax'.*did you mean 'stroll/sac'\?"):
        find("stroll/sax")


def test_a_policy_that_does_not_fit_is_one_clear_line(world, tmp_path):
    other = find(str(toy_stroll_env.snn(tmp_path / "p.nir", env="spikedeploy/Hexapod-v0")))
    with pytest.raises(ConfigError, match=r"p.nir was made for spikedeploy/Hexapod-v0, not for"):
        open_policy(other, "float", world)
    odd = Candidate("x.onnx", "x", "ann", ".onnx", observed=5, actions=2)
    with pytest.raises(ConfigError, match=r"x.onnx observes 5 numbers; test/Stroll-v0 has 3"):
        open_policy(odd, None, world)
    with pytest.raises(ConfigError, match="does not spike"):
        open_policy(find(write(".onnx", tmp_path)), "loihi1", world)
    with pytest.raises(ConfigError, match="name a chip, or 'float'"):
        open_policy(find(write(".nir", tmp_path)), None, world)


@pytest.mark.parametrize("seen", [[0.0, np.nan, 0.0], [0.0, np.inf, 0.0], [0.0] * 4])
@pytest.mark.parametrize("kind", [".onnx", ".nir"])
def test_what_is_no_observation_is_refused(seen, kind, world, tmp_path):
    player = open_policy(find(write(kind, tmp_path)), "loihi1" if kind == ".nir" else None, world)
    with pytest.raises(ObservationError, match=r"finite|3 numbers|shape"):
        player.act(np.array(seen))


def test_files_that_are_no_policies_are_refused(tmp_path):
    artifact = load(toy_stroll_env.snn(tmp_path / "p.nir"))
    save(replace(artifact, codec=None), tmp_path / "bare.nir")
    for name, content, says in (
        ("bare.nir", None, r"has no codec.*spikedeploy emulate"),
        ("broken.onnx", b"not a model", r"broken.onnx is not an ONNX file"),
        ("policy.pt", b"", r"neither .onnx, .nir nor a run folder"),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises((ArtifactError, ConfigError), match=says):
            find(str(tmp_path / name))


def test_onnx_runs_on_one_thread(tmp_path):
    options = OnnxController(toy_stroll_env.ann(tmp_path / "p.onnx"))._session.get_session_options()
    assert options.intra_op_num_threads == 1
