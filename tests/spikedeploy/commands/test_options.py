"""Options of commands: their words, their panels, their help."""

from collections import Counter
from pathlib import Path

import pytest
from typer.main import get_command

from spikedeploy import cli

VERBS = [
    verb
    for verb in (verb for verbs in cli.COMMANDS.values() for verb in verbs)
    if any("--chip" in each.opts for each in get_command(cli.app).commands[verb].params)
]


@pytest.mark.parametrize("verb", VERBS)
def test_chips_is_the_same_word_as_chip_and_help_has_one(verb, command):
    words = (verb, *[Path(__file__)] * 3, "--chips")
    assert "No such option" not in command(*words, "--json", "nothing")[2]
    _, out, _ = command(verb, "--help")
    assert "--chip " in out
    assert "--chips" not in out


def test_commands_that_name_a_chip_are_known():
    assert {"run", "compare", "serve", "emulate", "check", "drift", "verify"} <= set(VERBS)
    assert {"export", "tune"} <= set(VERBS)


@pytest.mark.parametrize("verb", [verb for verbs in cli.COMMANDS.values() for verb in verbs])
def test_options_stand_in_few_panels_of_few(verb):
    parameters = get_command(cli.app).commands[verb].params
    options = [each for each in parameters if each.param_type_name == "option"]
    sizes = Counter(each.rich_help_panel for each in options)
    assert len(sizes) <= 7
    assert max(sizes.values()) <= 13
    if verb in ("run", "compare", "emulate", "drift"):
        assert sizes["Output"] >= 4
        assert sizes[None] <= 11


@pytest.mark.parametrize("name", ["success", "disturb"])
def test_set_does_not_take_what_has_an_option_of_its_own(name, command):
    code, _, err = command("run", "kart-grid/snn", "--set", f"{name}=np", "--episodes", 1)
    assert code == 2
    assert f"{name} is given with --{name}" in err


@pytest.mark.parametrize("verb", [verb for verbs in cli.COMMANDS.values() for verb in verbs])
def test_every_option_has_help(verb):
    parameters = get_command(cli.app).commands[verb].params
    assert [each.name for each in parameters if not each.help] == []
