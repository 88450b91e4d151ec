"""SPEC.toml: what it may say, and what is refused."""

from dataclasses import replace

import pytest

from spikedeploy.campaign.sweep_grid import SweepGrid, expand, read_grid
from spikedeploy.runtime.errors import EnvError, SpikedeployError
from spikedeploy.seeds import listed_numbers


def read(tmp_path, text):
    (tmp_path / "trial.toml").write_text(text)
    return read_grid(tmp_path / "trial.toml")


def test_an_environment_is_enough(tmp_path):
    assert read(tmp_path, 'env = "kart-grid"') == SweepGrid("trial", ("kart-grid",))


def test_axes_take_one_value_or_many(tmp_path):
    found = read(
        tmp_path,
        """
        name = "chips"
        env = ["kart-grid", "kart-steer"]
        bits = ["own", 6]
        disturb = ["none", "noise:2", ["noise:1", "delay:1"]]
        fault = "dead-neurons:1"
        specimen = [0, 1]
        seed = "10000-10019"
        episodes = 10
        limits = "off"
        options.track = "small_S"
        quantisation.granularity = "channel"
        """,
    )
    assert found.name == "chips"
    assert found.bits == (None, 6)
    assert found.disturb == ((), ("noise:2",), ("noise:1", "delay:1"))
    assert found.seed == (10_000, 10_010)
    assert not found.limits
    assert found.options == {"track": "small_S"}
    assert found.quantisation.granularity == "channel"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("chips = 'loihi1'", "unknown key 'chips': did you mean chip"),
        ("color = 1", "known: bits, chip, disturb"),
        (f"env = 'kart-grid'\nname = '{'n' * 300}'", "name: String should have at most 100"),
        (
            "env = 'kart-grid'\nepisodes = 1\nseed = '10000-70000'\nspecimen = [0, 1]",
            "120,002 jobs; at most 100,000 in a sweep",
        ),
        ("policy = 'gap'", "env: Field required"),
        ("env = 3", r"env.0: Input should be a valid string, got 3"),
        ("env = []", "env is empty"),
        ("seed = []", "seed is empty"),
        ("env = ['a', 'a']", "a is given twice"),
        ("bits = 'few'", "bits.0: .* integer, got 'few'"),
        ("bits = 0", "greater than or equal to 1, got 0"),
        ("episodes = 0", "episodes: .* got 0"),
        ("episodes = true", "episodes: .* got True"),
        ("seed = 9999", "may have been trained on"),
        ("seed = [10000, 10005]", "share episodes.*'10000-10014'"),
        ("seed = 'some'", "write numbers and ranges"),
        ("seed = '10005-10001'", "has 0 numbers"),
        ("seed = '10000-99999999'", "from 1 to 100,000"),
        ("limits = 'some'", "limits: .* boolean"),
        ("options = 1", "options: .* dictionary, got 1"),
        ("quantisation = 1", "quantisation: .* dictionary"),
        ("quantisation.tuned = 1", "unknown key of quantisation 'tuned': known: granularity"),
        ("quantisation.granularity = 'all'", "granularity: .* got 'all'"),
        ("quantisation.weight_shift = 'x'", "weight_shift: .* got 'x'"),
        ("metrics = 'speed'", "name:mean"),
        ("name = '../up'", "name of a folder"),
        ("env = ", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_named(text, words, tmp_path):
    with pytest.raises(SpikedeployError, match=words):
        read(tmp_path, text if text.startswith(("env", "policy")) else f"env = 'kart-grid'\n{text}")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"chip": ("loihi9",)}, "no chip 'loihi9'"),
        ({"bits": (99,)}, "99"),
        ({"fault": (("rust:1",),)}, "a chip has no 'rust'"),
        ({"disturb": (("rain:1",),)}, "no 'rain'"),
        ({"policy": ("hexapod/popsan",)}, "none is for kart-grid"),
        ({"policy": ("gap", "hexapod/popsan")}, "popsan is for"),
        ({"options": {"wings": 2}}, "no option 'wings'"),
        ({"env": ("kart-boat",)}, "kart-boat"),
        ({"policy": ("gap",), "fault": (("dead-neurons:1",),)}, "no job is left"),
    ],
)
def test_what_does_not_exist_is_refused_before_a_job_is_run(change, words):
    with pytest.raises((SpikedeployError, EnvError), match=words):
        expand(replace(SweepGrid("x", ("kart-grid",)), **change))


def test_a_policy_that_was_trained_for_a_chip_is_swept_on_it_where_none_is_named():
    grid = SweepGrid("x", ("CartPole-v1",), policy=("chips/CartPole-v1/tinyodin", "random"))
    assert [job.chip for job in expand(grid).jobs] == ["tinyodin", None]
    named = replace(grid, chip=("int",))
    assert [job.chip for job in expand(named).jobs] == ["int", None]


def test_combinations_that_mean_the_same_are_one_job():
    grid = SweepGrid(
        "x", ("kart-grid",), policy=("gap", "kart-grid/snn"), chip=("loihi1", "float"),
        bits=(None, 4), fault=((), ("dead-neurons:1",)), specimen=(0, 1),
    )  # fmt: skip
    found = [(job.policy, job.place, job.fault, job.specimen) for job in expand(grid).jobs]
    assert len(found) == len(set(found)) == 1 + 1 + 2 * (1 + 2)


@pytest.mark.parametrize(
    ("text", "numbers"),
    [("0-4", [0, 1, 2, 3, 4]), ("0,2,5", [0, 2, 5]), ("3", [3]), ("0-1,7", [0, 1, 7])],
)
def test_ranges_and_lists_of_numbers(text, numbers):
    assert listed_numbers("--seeds", text) == numbers


@pytest.mark.parametrize("text", ["", "-1", "1-", "a", "0,0", "0-2,1", "4-1"])
def test_other_texts_are_no_numbers(text):
    with pytest.raises(SpikedeployError, match="--seeds"):
        listed_numbers("--seeds", text)
