import nir
import numpy as np
import pytest

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError, ConventionError
from spikedeploy.runtime.graph.discretisation import discretise
from spikedeploy.runtime.metadata import Record


def test_a_convention_describes_itself_in_one_line():
    line = Convention(1e-3, reset="subtract", source="as trained").describe()
    assert line == (
        "dt=0.001 s, reset=subtract, integrator=euler, delay=0, state=reset, "
        "clock=gated (as trained)"
    )


@pytest.mark.parametrize("dt", [0.0, -1e-3, float("nan"), float("inf")])
def test_a_timestep_that_is_no_duration_is_refused(dt):
    with pytest.raises(ConventionError, match="above 0"):
        Convention(dt)


@pytest.mark.parametrize(
    ("option", "value", "choices"),
    [
        ("reset", "soft", "'zero', 'subtract'"),
        ("integrator", "rk4", "'euler', 'exponential'"),
        ("delay", 2, "0, 1"),
        ("state", "random", "'reset', 'kept'"),
    ],
)
def test_an_unknown_option_is_refused_with_the_choices(option, value, choices):
    with pytest.raises(ConventionError, match=f"{option} .* Choose one of {choices}"):
        Convention(1e-3, **{option: value})


def test_who_says_so_is_no_part_of_equality():
    assert Convention(1e-3, source="as trained") == Convention(1e-3, source="guessed")
    assert Convention(1e-3) != Convention(1e-3, delay=1)


def test_given_options_win_and_say_so():
    convention = Convention(1e-3, source="as trained").with_options(
        {"reset": "subtract", "delay": 1}
    )
    assert convention == Convention(1e-3, reset="subtract", delay=1)
    assert convention.source == "delay, reset given, otherwise as trained"


def test_a_convention_survives_its_record():
    before = Convention(2e-4, "subtract", "exponential", 1, "kept", source="as trained")
    after = Convention.from_record(Record(before.to_record(), "convention"))
    assert (after, after.source) == (before, before.source)


@pytest.mark.parametrize(
    ("field", "value", "wanted"),
    [("dt", "fast", "a finite number"), ("delay", 0.5, "a whole number"), ("reset", 1, "text")],
)
def test_a_field_of_the_wrong_type_is_named(field, value, wanted):
    record = {**Convention(1e-3).to_record(), field: value}
    with pytest.raises(ArtifactError, match=f"convention.{field} must be {wanted}"):
        Convention.from_record(Record(record, "convention"))


def test_a_field_from_the_future_is_refused():
    record = {**Convention(1e-3).to_record(), "refractory": 2}
    with pytest.raises(ArtifactError, match="unknown field 'refractory'"):
        Convention.from_record(Record(record, "convention"))


def test_a_field_that_is_missing_in_a_record_is_named():
    record = Convention(1e-3).to_record()
    del record["reset"]
    with pytest.raises(ArtifactError, match=r"convention\.reset is missing"):
        Convention.from_record(Record(record, "convention"))


@pytest.mark.parametrize(
    "options", [{"spikes": "many", "reset": "none"}, {"clock": "pipelined", "delay": 1}]
)
def test_choices_that_contradict_each_other_are_refused(options):
    with pytest.raises(ConventionError, match="contradict each other"):
        Convention(1e-3, **options)


def test_many_spikes_need_something_to_subtract():
    node = nir.IF(np.ones(1), np.zeros(1))
    with pytest.raises(ConventionError, match=r"'n1': its threshold is not above v_reset"):
        discretise("n1", node, Convention(1e-3, reset="subtract", spikes="many"))
