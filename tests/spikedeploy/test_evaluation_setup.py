"""Setup: as the command line, as JSON, as options of an environment."""

import pytest

from spikedeploy.evaluation_setup import DEFAULT, OnChip, Setup, parse_options
from spikedeploy.runtime.errors import ConfigError

GIVEN = Setup(
    set_=("track=small_S", "lidar.noise=5"),
    disturb=("grip:2",),
    rounding="truncate",
    fault=("dead-neurons:2",),
    specimen=3,
    energy=("sanafe",),
)


def test_it_is_the_same_through_json_and_says_no_more_than_was_given():
    assert DEFAULT.as_json() == {}
    assert Setup.read(GIVEN.as_json(), "report.json") == GIVEN
    assert sorted(GIVEN.as_json()) == [
        "disturb", "energy", "fault", "rounding", "set_", "specimen",
    ]  # fmt: skip


def test_it_has_what_environment_and_chip_take():
    options = {"track": "small_S", "lidar": {"noise": 5}, "disturb": ["grip:2"]}
    assert GIVEN.options() == options
    assert Setup.with_options(options).options() == options
    assert GIVEN.quantisation.rounding == "truncate"
    assert (GIVEN.faults.specimen, len(GIVEN.faults.each)) == (3, 1)
    assert GIVEN.check() == GIVEN
    words = ["--quantise", "channel", "--weight-shift", "2"]
    assert OnChip(quantise="channel", weight_shift=2).words() == words
    words = ["--sampled", "--set", "a=1", "--set", "b=2"]
    assert Setup(sampled=True, set_=("a=1", "b=2")).words() == words


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"metric": ("speed",)}, "--metric"),
        ({"energy": ("pi",)}, "pi"),
        ({"fault": ("dead",)}, "--fault"),
        ({"set_": ("success=1",)}, "--success"),
    ],
)
def test_what_is_unknown_is_refused(wrong, word):
    with pytest.raises(ConfigError, match=word):
        Setup(**wrong).check()


def test_limits_are_no_boolean():
    with pytest.raises(ConfigError, match="limits True is unknown"):
        OnChip(limits=True)


def test_texts_are_options():
    assert parse_options(["track=small_S", "lidar.noise=2", "lidar.count=9", "on=true"]) == {
        "track": "small_S", "lidar": {"noise": 2, "count": 9}, "on": True,
    }  # fmt: skip
    for wrong in (["track"], ["lidar=3", "lidar.noise=2"]):
        with pytest.raises(ConfigError, match="--set"):
            parse_options(wrong)
