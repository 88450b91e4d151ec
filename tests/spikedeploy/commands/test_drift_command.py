"""`spikedeploy drift`: what it says of files and shipped policies, and how it refuses."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from spikedeploy import envs
from spikedeploy.emulation.drift_report import observed_inputs, random_inputs
from spikedeploy.envs.rollout import rollout
from spikedeploy.policies.registry import find, open_policy
from spikedeploy.runtime.analysis.activity import activity
from spikedeploy.runtime.analysis.calibration import tune_to_float
from spikedeploy.runtime.analysis.drift import drift
from spikedeploy.runtime.analysis.tuned import tuned_artifact
from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import UNTUNED, Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
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


def test_tables_are_printed_for_people_and_as_markdown(command, raster):
    _, out, _ = command("drift", "p.nir", "--input", "raster.npy")
    assert "Which rounding costs what" in out
    assert "Dead and saturated" not in out
    _, out, _ = command("drift", "p.nir", "--input", "raster.npy", "--markdown")
    assert "| layer | neurons | rate, float |" in out
    assert "| n2 | 16 |" in out


def test_a_dead_layer_is_named_and_calibration_wakes_it(command, tmp_path):
    save(crowd(), tmp_path / "crowd.nir")
    np.save(tmp_path / "all.npy", np.ones((6, 600), np.uint8))
    words = ("drift", "crowd.nir", "--input", "all.npy", "--json")
    (finding,) = json.loads(command(*words)[1])["findings"]
    assert (finding["layer"], finding["health"], finding["cause"]) == ("n2", "dead", "states")
    found = json.loads(command(*words, "--calibrate")[1])
    assert (found["layers"][0]["saturations"], found["first"]) == (0, None)
    assert found["calibrated"] == "all.npy"


def test_calibration_and_measurement_are_on_different_inferences(command, stroll):
    words = ("drift", "stroll/popsan", "--steps", 9, "--tune", "--json")
    found = json.loads(command(*words)[1])
    assert found["calibrated"].endswith("seed 10000, 5 of them")
    assert found["inputs"].endswith("seed 10000, 4 of them")
    assert found["inferences"] == 4


@pytest.mark.parametrize("how", [(), ("--quantise", "channel")])
def test_emulating_a_tuned_file_gives_the_spikes_that_tuning_measured(how, command, raster):
    raster = raster[:50]
    np.save("some.npy", raster)
    on = ("--chip", "loihi1:weight_bits=3", "--input", "some.npy", *how)
    _, out, err = command("drift", "p.nir", "--tune", "--tuned", "t.nir", *on, "--json")
    assert f"wrote t.nir; with {' '.join((*on[:2], *how))} it computes what was measured" in err
    found = json.loads(out)
    assert found["tuned"] == load("t.nir").tuned
    command("emulate", "t.nir", *on, "-o", "out.npz")
    spikes = np.load("out.npz")
    assert found["layers"]
    for layer in found["layers"]:
        assert spikes[layer["name"]].mean() == pytest.approx(layer["chip_rate"], abs=0)
    low, granularity = chip("loihi1", weight_bits=3), how[1] if how else "layer"
    chosen = tune_to_float(
        popsan(),
        low,
        raster[None],
        Quantisation(granularity),
        possible=partial(tuned_artifact, popsan(), low, ""),
    )
    assert any(each != UNTUNED for each in chosen.tuned.values())
    measured = activity(popsan(), compile_program(popsan(), low, chosen), raster[None]).spikes
    for name, rows in measured.items():
        np.testing.assert_array_equal(spikes[name], rows[0])


def test_a_tuned_file_destroys_nothing_and_is_not_written_where_nothing_helps(command, raster):
    on = ("--chip", "loihi1", "--input", "raster.npy")
    _, out, _ = command("drift", "p.nir", *on, "--tune")
    assert "--tuned FILE.nir" in out
    code, _, err = command("drift", "p.nir", *on, "--tuned", "p.nir")
    assert code == 2
    assert "is the input p.nir" in err
    save(popsan(seed=1), "other.nir")
    code, _, err = command("drift", "p.nir", *on, "--tuned", "other.nir")
    assert code == 2
    assert "other.nir: the file exists" in err
    code, _, err = command("drift", "p.nir", *on, "--tuned", "t.nir", "--calibrate")
    assert code == 2
    assert "no file can say" in err
    save(crowd(), "crowd.nir")  # without a bias, and so as silent as the chip
    np.save("none.npy", np.zeros((20, 600), np.uint8))
    silent = command("drift", "crowd.nir", *on[:2], "--input", "none.npy", "--tuned", "t.nir")
    assert silent[0] == 0
    assert "t.nir was not written: nothing" in silent[1]
    assert not Path("t.nir").exists()


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
    first, rest = inputs.halves()
    assert (first.episodes, rest.episodes) == ((5, 4), (5,))
    np.testing.assert_array_equal(rest.raster, inputs.raster[5:10])


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
    found = json.loads(command(*words, "--calibrate", "--tune")[1])
    assert found["calibrated"].endswith("seeds 10000 to 10001, 15 of them")
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
