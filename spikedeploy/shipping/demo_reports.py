"""The demo: shipped policies on two tasks, a page of each with its episodes, and an index."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from spikedeploy import zoo
from spikedeploy.comparison.evaluation import compare_policies, line_up
from spikedeploy.console import say
from spikedeploy.outputs import check_output, check_output_folder, has_text
from spikedeploy.policies.registry import DEFAULT_CHIP
from spikedeploy.reports import comparison_page as report
from spikedeploy.reports.columns import energy_hint
from spikedeploy.reports.page import render
from spikedeploy.reports.summary import ann_row, headline, main_row, smallest_baseline, verdict
from spikedeploy.reports.table import Row
from spikedeploy.reports.terminal import print_comparison, print_headline
from spikedeploy.runtime.files import write_text
from spikedeploy.seeds import EVALUATION

FOLDER = Path("reports/demo")
_INDEX = "index.html"
# task -> episodes of each policy; a walk takes some seconds, a lap a tenth of that
_TASKS = {"hexapod-command": 2, "kart-steer": 5}
_TITLE = "Spiking policies on an emulated chip"
_LEAD = "The robot is driven by spiking neurons in the integers of a neuromorphic chip."
_NOTES = (
    "The ghosts beside it are the same network in floating point and a float network.",
    "No chip took part: its arithmetic was emulated on this machine, and its operations were "
    "counted.",
)
_POSTER = 0.25  # of an episode: the robots move, and apart; the page opens there
_Episodes = Sequence[Mapping[str, Any]]


def write_demo(
    folder: Path = FOLDER, quiet: bool = False, everything: bool = True, force: bool = False
) -> list[dict[str, Any]]:
    """Compare the shipped policies of every task; return the reports as data.

    folder: for index.html, and a folder for each task
    quiet: write nothing to stdout
    everything: print all tables, else the numbers that a page leads with
    force: replace files that no demo wrote
    """
    _check(folder, force)
    documents: list[dict[str, Any]] = []
    shown: list[dict[str, Any]] = []
    for env, episodes in _TASKS.items():
        if not zoo.policies(env):
            say(f"{env}: no policies are shipped yet")
            continue
        document, recorded = _compared(env, episodes, folder / env)
        first, *_ = report.name_players(recorded, document)
        shown.append({**first, "title": document["env"]})
        documents.append(document)
        if not quiet:
            show = print_comparison if everything else print_headline
            show(document)
    if documents:
        write_text(folder / _INDEX, _index(documents, shown))
    return documents


def _check(folder: Path, force: bool) -> None:
    """Refuse to replace what is not of an earlier demo, and to write through links."""
    for env in filter(zoo.policies, _TASKS):
        check_output_folder("demo:", folder / env, report.FILES, (), force, report.is_report)
    check_output("demo:", folder / _INDEX, (), force, _is_index)


def _is_index(path: Path) -> bool:
    return not path.is_symlink() and has_text(path, f"<title>{_TITLE}</title>")


def _compared(env: str, episodes: int, folder: Path) -> tuple[dict[str, Any], _Episodes]:
    """The report of a task, and the episodes that its page replays."""
    entries = line_up(env, (), (DEFAULT_CHIP,))
    comparison = compare_policies(env, entries, range(EVALUATION, EVALUATION + episodes))
    document = report.document(comparison)
    recorded = report.recordings(comparison, document["rows"], {})
    report.write(document, folder, episodes=recorded)
    return document, recorded


def _index(documents: Sequence[Mapping[str, Any]], episodes: _Episodes) -> str:
    """A page that replays an episode of each task, and leads to the pages of all."""
    return render(
        "demo",
        title=_TITLE,
        lead=_LEAD,
        notes=_NOTES,
        episodes=episodes,
        poster=_POSTER,
        tasks=[_task(document) for document in documents],
    )


def _task(document: Mapping[str, Any]) -> dict[str, Any]:
    rows = list(_main_rows(document["rows"]))
    return {
        "env": document["env"],
        "verdict": verdict(document)[0],
        "numbers": headline(document["rows"], document["env_id"]),
        "policies": report.policy_table(rows, document["env_id"]),
        "remark": f"{rows[0]['episodes']} episodes of each policy. {energy_hint(rows)}",
    }


def _main_rows(rows: Sequence[Row]) -> Iterator[Row]:
    """The float ANN, the spiking policies on the chip, and the smallest float baseline."""
    main = main_row(rows)
    found = (ann_row(rows), smallest_baseline(main, rows))
    for row in rows:
        if row in found or (row["kind"] == "snn" and row["chip"] == main["chip"]):
            yield row
