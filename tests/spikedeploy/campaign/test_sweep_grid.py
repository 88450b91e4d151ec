"""SPEC.toml: what it may say, and what is refused."""

from dataclasses import replace

import pytest

from spikedeploy.campaign.sweep_grid import SweepGrid, expand, read_grid
from spikedeploy.evaluation_setup import Setup
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
        set = "track=small_S"
        quantise = "channel"
        """,
    )
    assert found.name == "chips"
    assert found.bits == (None, 6)
    assert found.disturb == ((), ("noise:2",), ("noise:1", "delay:1"))
    assert found.seed == (10_000, 10_010)
    assert found.setup == Setup(limits="off", set_=("track=small_S",), quantise="channel")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("chips = 'loihi1'", "unknown key 'chips': did you mean chip"),
        ("color = 1", "known: "),
        (f"env = 'kart-grid'\nname = '{'n' * 300}'", "name: .*100"),
        (
            "env = 'kart-grid'\nepisodes = 1\nseed = '10000-70000'\nspecimen = [0, 1]",
            "120,002 jobs",
        ),
        ("policy = 'gap'", "env: "),
        ("env = 3", "env.0: .*string"),
        ("env = []", "env is empty"),
        ("seed = []", "seed is empty"),
        ("env = ['a', 'a']", "a is given twice"),
        ("bits = 'few'", "bits.0: .*integer"),
        ("bits = 0", "bits.0: .*1, got 0"),
        ("episodes = 0", "episodes: .* got 0"),
        ("episodes = true", "episodes: .* got True"),
        ("seed = 9999", "trained on"),
        ("seed = [10000, 10005]", "share episodes.*'10000-10014'"),
        ("seed = 'some'", "numbers and ranges"),
        ("seed = '10005-10001'", "0 numbers"),
        ("seed = '10000-99999999'", "100,000"),
        ("limits = 'some'", "limits: "),
        ("set = 1", "set_.0: .*string"),
        ("quantise = 'all'", "quantise: .* got 'all'"),
        ("weight_shift = 'x'", "weight_shift: .* got 'x'"),
        ("metric = 'speed'", "name:mean"),
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
        ({"setup": Setup(set_=("wings=2",))}, "no option 'wings'"),
        ({"env": ("kart-boat",)}, "kart-boat"),
        ({"policy": ("gap",), "fault": (("dead-neurons:1",),)}, "no job is left"),
    ],
)
def test_what_does_not_exist_is_refused_before_a_job_is_run(change, words):
    with pytest.raises((SpikedeployError, EnvError), match=words):
        expand(replace(SweepGrid("x", ("kart-grid",)), **change))


def test_a_policy_that_was_trained_for_a_chip_is_swept_on_it_where_none_is_named():
    grid = SweepGrid("x", ("CartPole-v1",), policy=("chips/CartPole-v1/tinyodin", "random"))
    assert [job.entry.chip for job in expand(grid)] == ["tinyodin", None]
    named = replace(grid, chip=("int",))
    assert [job.entry.chip for job in expand(named)] == ["int", None]


def test_combinations_that_mean_the_same_are_one_job():
    grid = SweepGrid(
        "x", ("kart-grid",), policy=("gap", "kart-grid/snn"), chip=("loihi1", "float"),
        bits=(None, 4), fault=((), ("dead-neurons:1",)), specimen=(0, 1),
    )  # fmt: skip
    assert len({job.label for job in expand(grid)}) == len(expand(grid)) == 1 + 1 + 2 * (1 + 2)


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
