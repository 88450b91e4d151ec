"""The demo: shipped policies on two tasks, a page of each with its episodes, and an index."""

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from spikedeploy import zoo
from spikedeploy.comparison.lineup import line_up
from spikedeploy.comparison.rounds import compare_policies
from spikedeploy.console import say
from spikedeploy.files import write_text
from spikedeploy.pages import report
from spikedeploy.pages.page import big_numbers, page, said
from spikedeploy.policies.interface import DEFAULT_CHIP
from spikedeploy.reports.headline import headline, verdict
from spikedeploy.reports.terminal import print_comparison, print_headline
from spikedeploy.seeds import EVALUATION

FOLDER = Path("reports/demo")
# task -> episodes of each policy; a walk takes some seconds, a lap a tenth of that
_TASKS = {"hexapod-command": 2, "kart-steer": 5}
_TITLE = "Spiking policies on an emulated chip"


def write_demo(
    folder: Path = FOLDER, quiet: bool = False, everything: bool = True
) -> list[dict[str, Any]]:
    """Compare the shipped policies of every task; return the reports as data.

    folder  for index.html, and a folder for each task
    quiet   write nothing to stdout
    everything  print all tables, else the numbers that a page leads with
    """
    documents: list[dict[str, Any]] = []
    for env, episodes in _TASKS.items():
        if not zoo.policies(env):
            say(f"{env}: no policies are shipped yet")
            continue
        document = _compared(env, episodes, folder / env)
        documents.append(document)
        if not quiet:
            show = print_comparison if everything else print_headline
            show(document)
    if documents:
        write_text(folder / "index.html", _index(documents))
    return documents


def _compared(env: str, episodes: int, folder: Path) -> dict[str, Any]:
    entries = line_up(env, (), (DEFAULT_CHIP,))
    comparison = compare_policies(env, entries, range(EVALUATION, EVALUATION + episodes))
    document = report.document(comparison)
    recorded = report.recordings(comparison, document["rows"], {})
    report.write(document, folder, episodes=recorded)
    return document


def _index(documents: list[dict[str, Any]]) -> str:
    """A page that leads to those of the tasks."""
    lead = (
        "Each page replays recorded episodes beside the spikes, membranes and energy of the "
        "network on the chip."
    )
    return page(_TITLE, lead, map(_card, documents))


def _card(document: Mapping[str, Any]) -> str:
    env = escape(document["env"])
    numbers = big_numbers(headline(document["rows"], document["env_id"]))
    return f'<h2><a href="{env}/report.html">{env}</a></h2>{said(verdict(document)[0])}{numbers}'
