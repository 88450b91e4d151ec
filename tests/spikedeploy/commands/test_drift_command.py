"""`spikedeploy drift`: what it says of files and shipped policies, and how it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.emulation.drift_report import observed_inputs, random_inputs
from spikedeploy.envs.rollout import rollout
from spikedeploy.policies.registry import find, open_policy
from spikedeploy.runtime.analysis.drift import drift
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.errors import ObservationError
from tests import toy_stroll_env
from tests.networks import crowd, event_driven, popsan


@pytest.fixture
def raster(tmp_path):
    spikes = (np.random.default_rng(0).random((200, 30)) < 0.3).astype(np.uint8)
    np.save(tmp_path / "raster.npy", spikes)
    save(popsan(), tmp_path / "p.nir")
    return spikes


def test_a_shipped_policy_is_compared_on_what_its_float_twin_observes(command, stroll):
    code, out, err = command("drift", "stroll/popsan", "--steps", 7, "--json")
    found = json.loads(out)
    assert (code, err) == (0, "")
    assert found["inputs"] == (
        "7 of 20 control steps of the float twin in test/Stroll-v0, seed 10000"
    )
    assert (found["chip"], found["inferences"], found["timesteps"]) == ("loihi1", 7, 5)
    assert found["output"]["kind"] == "action"
    assert [step["name"] for step in found["rungs"]] == [
        "weights", "thresholds", "decays", "states"
    ]  # fmt: skip


@pytest.fixture(autouse=True)
def here(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def test_tables_are_printed_for_people(command, raster):
    _, out, _ = command("drift", "p.nir", "--input", "raster.npy")
    assert "Which rounding costs what" in out
    assert "Dead and saturated" not in out


def test_a_dead_layer_is_named(command, tmp_path):
    save(crowd(), tmp_path / "crowd.nir")
    np.save(tmp_path / "all.npy", np.ones((6, 600), np.uint8))
    words = ("drift", "crowd.nir", "--input", "all.npy", "--json")
    (finding,) = json.loads(command(*words)[1])["findings"]
    assert (finding["layer"], finding["health"], finding["cause"]) == ("n2", "dead", "states")


def test_spikes_can_be_drawn_for_a_file_without_a_codec(command, tmp_path):
    save(crowd(), tmp_path / "crowd.nir")
    words = ("drift", "crowd.nir", "--random", 0.1, "--steps", 30, "--json")
    found = json.loads(command(*words)[1])
    assert found["timesteps"] == 30
    assert found["inputs"] == "spikes drawn at a rate of 0.1, seed 10000"
    inputs = random_inputs(crowd(), 0.1, 30, 1)
    assert 0.08 < inputs.raster.mean() < 0.12


def test_without_codec_and_raster_it_says_what_to_give(command, tmp_path):
    save(crowd(), tmp_path / "crowd.nir")
    code, _, err = command("drift", "crowd.nir")
    assert code == 2
    assert "crowd.nir has no codec" in err
    assert "--input" in err


def test_kept_states_begin_anew_with_each_episode(stroll):
    candidate = find("stroll/popsan")
    artifact = load(candidate.path, state="kept")
    seeds = range(10_000, 10_003)
    inputs = observed_inputs(artifact, candidate, None, seeds, 14)
    assert inputs.episodes == (5, 5, 4)
    on = chip("loihi1")
    whole = drift(artifact, on, inputs.raster, episodes=inputs.episodes)
    alone = [
        drift(artifact, on, observed_inputs(artifact, candidate, None, [seed], n).raster)
        for seed, n in zip(seeds, inputs.episodes, strict=True)
    ]
    assert whole.inferences == 14
    for found, *each in zip(whole.layers, *(one.layers for one in alone), strict=True):
        differ = sum(part.differing * n for part, n in zip(each, inputs.episodes, strict=True))
        assert found.differing == pytest.approx(differ / 14)


def test_episodes_must_be_those_of_the_raster():
    artifact = event_driven()
    raster = np.zeros((6, 1, artifact.codec.encoder.width), np.uint8)
    with pytest.raises(ObservationError, match="have 4, 3 inferences, the raster has 6"):
        drift(artifact, chip("loihi1"), raster, episodes=(4, 3))


def test_a_delta_code_is_compared_on_whole_episodes(command, stroll):
    policy = event_driven()
    provenance = replace(policy.provenance, env=toy_stroll_env.ID)
    save(replace(policy, provenance=provenance), "event.nir")
    words = ("drift", "event.nir", "--episodes", 2, "--steps", 30, "--json")
    found = json.loads(command(*words)[1])
    assert (found["inferences"], found["timesteps"]) == (30, 1)
    inputs = observed_inputs(load("event.nir"), find("event.nir"), None, [10_000], 20)
    with np.load(played()) as episode:
        seen = episode["observation"][:-1]
    np.testing.assert_array_equal(inputs.raster, policy.codec.encode_episode(seen))


def played():
    """A file with the episode that the float twin plays."""
    world = envs.make("stroll")
    rollout(world, open_policy(find("event.nir"), "float", world), 10_000).save("event.npz")
    return "event.npz"


def test_run_and_compare_take_the_same_quantisation_and_report_it(command, stroll):
    words = ("run", "stroll/popsan", "--json")
    plain, channel = (json.loads(command(*words, *o)[1]) for o in ((), ("--quantise", "channel")))
    assert plain["rows"][0]["returns"] != channel["rows"][0]["returns"]
    assert "on chips" not in plain["conventions"]["popsan"]
    said = channel["conventions"]["popsan"]
    assert said.endswith("; on chips a scale for each channel, the chip's own rounding")
    words = ("compare", "stroll", "stroll/popsan", "--episodes", 1, "--workers", 1, "--json")
    found = json.loads(command(*words, "--quantise", "channel")[1])
    (on_chip,) = [row for row in found["rows"] if row["chip"] == "loihi1"]
    assert on_chip["returns"] == channel["rows"][0]["returns"]
    assert found["conventions"]["popsan"] == said
