"""A chip of a known arithmetic is a file; what is wrong with it is said in a sentence."""

import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.errors import ChipError

MINE = """
summary = "4-bit weights, 16-bit membranes"
[like]
chip = "int"
source = "{source}, as on int"
[references]
RTL = "RTL of July (read)"
[fields]
weight_bits = { value = 4, source = "{RTL}" }
membrane = { value = "16-saturate", source = "{RTL}: 16 bits" }
[limits]
primitives = { value = ["Input", "Output", "Affine", "Linear", "CubaLIF"], source = "assumed" }
neurons = { value = 1024, source = "assumed" }
memory = { value = { size = 8192, cost = "bits", weight_bits = 4 }, source = "assumed" }
"""


@pytest.fixture
def write(tmp_path):
    def write(text, name="mine.toml"):
        (tmp_path / name).write_text(text)
        return str(tmp_path / name)

    return write


def test_a_file_of_ones_own_is_a_chip_with_options(write):
    mine = chip(write(MINE))
    assert (mine.name, mine.summary) == ("mine", "4-bit weights, 16-bit membranes")
    assert mine.arithmetic.membrane == Register(16, "saturate")
    assert mine.limits.memory.size == 8192
    assert mine.sources["membrane"] == "RTL of July (read): 16 bits"
    assert mine.sources["delay_max"] == "by definition; free, as on int"
    other = chip(f"{write(MINE)}:weight_bits=5,current=20")
    assert (other.arithmetic.weight_bits, other.arithmetic.current) == (5, Register(20, "clip"))


def test_a_file_that_has_changed_is_read_again(write):
    chip(write(MINE))
    assert chip(write(MINE.replace("1024", "512"))).limits.neurons == 512


def changed(old, new):
    assert old in MINE
    return MINE.replace(old, new)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("summary = ", "invalid TOML"),
        (changed("summary", "title"), "no table 'title'"),
        (changed("[fields]", "[field]"), "no table 'field'; did you mean 'fields'"),
        (changed("weight_bits = { value", "weight_bit = { value"), "did you mean 'weight_bits'"),
        (changed('value = 4, source = "{RTL}"', "value = 4"), "weight_bits has no source"),
        (changed('{ value = 4, source = "{RTL}" }', "4"), "weight_bits has no source"),
        (changed("value = 4,", 'value = "four",'), "weight_bits must be a whole number"),
        (changed("value = 4,", "value = true,"), "weight_bits must be a whole number"),
        (changed("value = 4,", "value = 40,"), "weight_bits is 40"),
        (changed("16-saturate", "16"), "overflows in an unknown way"),
        (changed("16-saturate", "wide-clip"), "membrane must be a whole number, found 'wide'"),
        (changed("RTL = ", "VHDL = "), "names {RTL}, which is not among its references"),
        (changed('"RTL of July (read)"', '"{RTL}"'), "in a circle"),
        (changed('chip = "int"', 'chip = "inf"'), "like.chip is 'inf'; did you mean 'int'"),
        (changed("neurons =", "neuron ="), "no limit 'neuron'; did you mean 'neurons'"),
        (changed("value = 1024", 'value = "many"'), "neurons must be a whole number"),
        (changed("size = 8192, ", ""), "size has no value"),
        (changed("[like]\n", '[like]\nfrom = "x"\n'), "no entry of like 'from'"),
        ('arithmetic = "cuba-fixed"', "arithmetic 'cuba-fixed' is unknown; did you mean 'cuba-"),
        ('arithmetic = "xylo"', "weight_bits has no value"),
        ("fields = 3", "fields is 3; it must be a dict"),
        ("a" + ".a" * (1 << 14) + " = 1", "more than 32768 bytes"),
    ],
)
def test_what_is_wrong_with_a_file_is_a_sentence(text, message, write):
    with pytest.raises(ChipError) as error:
        chip(write(text))
    assert message in str(error.value)
    assert "mine" in str(error.value)


def test_a_file_that_is_not_there_and_the_name_of_another_chip_are_refused(write):
    with pytest.raises(ChipError, match="cannot be read"):
        chip("missing.toml")
    with pytest.raises(ChipError, match="'int' is the name of another chip"):
        chip(write(MINE, "int.toml"))


def test_commands_take_a_file_where_they_take_a_chip(write, command):
    mine = write(MINE)
    assert "RTL of July (read): 16 bits" in command("chips", mine)[1].replace("\n", " ")
    words = ("check", "examples/net.nir", "--json", "--chip", f"{mine}:membrane=10-saturate")
    code, out, err = command(*words)
    assert (code, err) == (0, "")
    assert "mine" in out
