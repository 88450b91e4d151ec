"""Options of a chip in a line of text mean what they mean in Python."""

import pytest

from spikedeploy.runtime.chips.chip import CHIPS, chip, split_names
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.errors import ChipError


@pytest.mark.parametrize("name", sorted(CHIPS))
def test_a_name_without_options_is_the_datasheet(name):
    assert chip(f"{name}:") == chip(name)


def test_text_and_python_give_the_same_chip():
    spelled = chip("int:weight_bits=4, decay_bits=6,membrane=12-wrap,current=14")
    given = chip(
        "int",
        weight_bits=4,
        decay_bits=6,
        membrane=Register(12, "wrap"),
        current=Register(14, "clip"),
    )
    assert spelled == given
    assert spelled != chip("int")


def test_what_python_gives_goes_before_the_text():
    assert chip("loihi1:weight_bits=4,sign_mode=mixed", weight_bits=5).arithmetic.weight_bits == 5
    assert chip("loihi1:weight_bits=4,sign_mode=mixed").arithmetic.sign_mode == "mixed"


def test_a_register_is_its_bits_and_overflows_as_before():
    assert chip("loihi1", membrane=20).arithmetic.membrane == Register(20, "clip")
    assert chip("loihi1:current=20").arithmetic.current == Register(20, "wrap-once")
    assert chip("loihi1:current=20-wrap-once").arithmetic.current == Register(20, "wrap-once")


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("loihi1", ["loihi1"]),
        (" loihi1, odin,", ["loihi1", "odin"]),
        (
            "loihi1:sign_mode=mixed,weight_bits=4,int:membrane=12,odin",
            ["loihi1:sign_mode=mixed,weight_bits=4", "int:membrane=12", "odin"],
        ),
        ("", []),
    ],
)
def test_a_comma_parts_options_and_chips(text, names):
    assert split_names(text) == names


def test_lists_and_nothing_have_a_spelling():
    assert chip("truenorth:resets=zero").resets == ("zero",)
    assert chip("spinnaker2:resets=zero/subtract").resets == ("zero", "subtract")
    assert chip("truenorth:floor=-100").arithmetic.floor == -100
    assert chip("odin:floor=none").arithmetic.floor is None
    assert chip("xylo-a2:events_max=3").arithmetic.events_max == 3
    assert chip("ideal:delay=1").delay == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("int:weight_bits", "option 'weight_bits' has no value. Write it as int:weight_bits=4"),
        ("int:=4", "option '=4' has no value|no option ''"),
        ("int:weight_bit=4", "no option 'weight_bit'; did you mean 'weight_bits'"),
        ("int:weight_bits=four", "weight_bits must be a whole number, found 'four'"),
        ("int:membrane=12-up", "membrane '12-up' overflows in an unknown way.*saturate"),
        ("int:membrane=wide", "membrane must be a whole number, found 'wide'"),
        ("loihi1:sign_mode=both", "sign_mode 'both' is unknown"),
        ("loihi1:weight_bits=7", "weight_bits"),
        ("loihi1:step_rounding=up", "step_rounding"),
        ("loihi1:exponents=up", "exponents"),
        ("loihi1:refractory=0", "refractory is 0; the least is 1"),
        ("loihi1:weight_bits=1,sign_mode=mixed", "nothing is left"),
        ("loihi1:membrane_output=shout", "membrane_output 'shout' is unknown"),
        ("loihi1:sources=x", "'sources' cannot be given as text"),
        ("ideal:weight_bits=4", "chip 'ideal': it has no option 'weight_bits'"),
        ("inf:weight_bits=4", "there is no chip 'inf'; did you mean 'int'"),
        ("loihi1:clock=", "option 'clock=' has no value. Write it as loihi1:clock=gated"),
        ("loihi1:clock=free,clock=gated", "option 'clock' is given twice"),
        ("int:weight_bits=4,weight_bits=4", "option 'weight_bits' is given twice"),
        ("loihi1:clock=Gated", "clock 'Gated' is unknown. Choose one of 'gated', 'pipelined'"),
        ("loihi1:delay=-1", "delay -1: no spike arrives before it was sent"),
    ],
)
def test_what_cannot_be_read_is_refused_by_name(text, message):
    with pytest.raises(ChipError, match=message):
        chip(text)


@pytest.mark.parametrize(("name", "widest", "highest", "bits"), [
    ("loihi1", 255, 131071, 8), ("loihi1:weight_bits=4", 240, 131071, 4),
    ("spinnaker2:weight_bits=4", None, None, 4), ("spinnaker2-lif:weight_bits=4", None, None, 16),
    ("xylo-a2", 127, 32767, None), ("xylo-a2:weight_bits=4", 7, 32767, None),
    ("xylo-a2:state=12", 127, 2047, None), ("odin:weight_bits=2", 3, 255, None),
])  # fmt: skip
def test_the_limits_of_weights_and_thresholds_follow_their_width(name, widest, highest, bits):
    limits = chip(name).limits
    assert (limits.weight_max, limits.threshold_max) == (widest, highest)
    assert (limits.memory and limits.memory.weight_bits) == bits


@pytest.mark.parametrize(("stated", "found"), [(5, 5), (300, 7)])
def test_a_datasheet_may_limit_weights_to_less_than_their_width(stated, found, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        f'[like]\nchip = "odin"\n[limits]\nweight_max = {{ value = {stated}, source = "a test" }}\n'
    )
    assert chip(str(path)).limits.weight_max == found
