"""Options of commands: their words, their panels, their help."""

import re
from collections import Counter
from pathlib import Path

import pytest
from typer.main import get_command

from spikedeploy import cli

VERBS = [verb for verbs in cli.COMMANDS.values() for verb in verbs]


@pytest.mark.parametrize("verb", VERBS)
def test_a_command_explains_every_option_in_few_panels(verb, command):
    parameters = get_command(cli.app).commands[verb].params
    assert [each.name for each in parameters if not each.help] == []
    options = [each for each in parameters if each.param_type_name == "option"]
    sizes = Counter(each.rich_help_panel for each in options)
    assert len(sizes) <= 7
    assert max(sizes.values()) <= 13
    if verb in ("run", "compare", "emulate", "drift"):
        assert sizes["Output"] >= 3
        assert sizes[None] <= 11
    code, out, _ = command(verb, "--help")
    assert (code, "--json" in out, "--chips" in out) == (0, True, False)
    brackets = {text for each in options for text in re.findall(r"\[\w+\]", each.help)}
    assert [text for text in brackets if text not in out] == []


@pytest.mark.parametrize(
    "verb", ["run", "compare", "serve", "emulate", "check", "drift", "verify", "export", "tune"]
)
def test_chips_is_the_same_word_as_chip(verb, command):
    words = (verb, *[Path(__file__)] * 3, "--chips")
    assert "No such option" not in command(*words, "--json", "nothing")[2]
