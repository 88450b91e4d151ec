"""Every file of results/ names the command that made it: today's, or that of a commit."""

import json
import re
import shlex
import subprocess
import sys
from functools import cache

import pytest
import typer

from spikedeploy import cli, envs
from spikedeploy.commands.options import one_word
from spikedeploy.runtime.chips.chip import split_names
from spikedeploy.shipping.reproduce import read_evaluation
from tests.paths import ROOT

RESULTS = ROOT / "results"
INDEX = (RESULTS / "README.md").read_text("utf-8")
REPORTS = sorted(RESULTS.glob("*/report.json"))
QUOTED = r"`((?:spikedeploy|python) [^`]+)`"


def command_of(path):
    """The command in a JSON file of results."""
    return json.loads(path.read_text("utf-8"))["command"]


def index():
    """(links, commands, whether they are of a commit) of every row of results/README.md."""
    for line in INDEX.splitlines():
        if line.startswith("| ["):
            yield re.findall(r"\]\(([^)]+)\)", line), re.findall(QUOTED, line), is_frozen(line)


def is_frozen(line):
    """Return whether a row of the index is of what a commit has made."""
    return bool(re.search(r"\| at [0-9a-f]{8}: ", line))


def shown(text):
    """Commands that pages of results show: indented, or in backticks after 'Written by'."""
    return re.findall(r"^    ((?:spikedeploy|python) .*)$", text, re.M) + re.findall(
        rf"Written by {QUOTED}", text
    )


PAGES = {page: shown(page.read_text("utf-8")) for page in RESULTS.rglob("*.md")}
COMMANDS = sorted(
    {command_of(path) for path in REPORTS}
    | {command for commands in PAGES.values() for command in commands}
    | {command for _, commands, frozen in index() for command in commands if not frozen}
)
IN_DOCS = {
    line.strip()
    for page in ROOT.glob("docs/**/*.md")
    for line in re.findall(r"^(?:    )?(python -m lab [^#\n]*)", page.read_text("utf-8"), re.M)
}


def parsed(words):
    """The parameters of a command of ours, whose options exist and whose choices are valid."""
    verb = typer.main.get_command(cli.app).commands[words[0]]
    needs_files = words[0] == "visualize"  # of run folders, which are not in the repository
    made = {"resilient_parsing": needs_files, "token_normalize_func": one_word}
    with verb.make_context(words[0], words[1:], **made) as context:
        if needs_files:
            verb.make_parser(context).parse_args(words[1:])
        return context.params


@pytest.mark.parametrize("line", [c for c in COMMANDS if c.startswith("spikedeploy ")])
def test_a_command_is_understood_today(line):
    words = shlex.split(line)[1:]
    given = parsed(words)
    if words[0] == "compare":
        envs.spec(given["env"])
        split_names(",".join(given["chip"] or ()))


@cache
def helped(name):
    """What a command of the lab says of its options."""
    command = [sys.executable, "-m", "lab", name, "--help"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("line", sorted({c for c in COMMANDS if c.startswith("python ")} | IN_DOCS))
def test_a_command_of_the_lab_has_the_options(line):
    _, _, lab, name, *words = shlex.split(line.replace("[", " ").replace("]", " "))
    assert lab == "lab"
    options = [word.partition("=")[0] for word in words if word.startswith("-")]
    assert [each for each in options if not re.search(rf"{each}\b", helped(name))] == []


def test_everything_in_results_stands_in_its_index_with_a_command():
    rows = list(index())
    assert len(rows) >= 7
    assert all(commands for _, commands, _ in rows)
    named = {link.partition("/")[0].partition(".")[0] for links, _, _ in rows for link in links}
    assert {path.stem for path in RESULTS.iterdir()} - {"README"} == named


@pytest.mark.parametrize("path", REPORTS, ids=lambda path: path.parent.name)
def test_a_report_can_be_reproduced(path):
    """Its command and its policies are read as `spikedeploy reproduce` reads them."""
    found = read_evaluation(str(path.parent))
    assert len(found.entries) == len(found.rows)
    assert parsed(shlex.split(command_of(path))[1:])["episodes"] == len(found.seeds)
