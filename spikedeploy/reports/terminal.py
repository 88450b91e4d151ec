"""Terminal output of comparisons, emulations, checks of files, and traces."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from spikedeploy.console import print_list, print_text
from spikedeploy.emulation.verification import Verification
from spikedeploy.exporters.check import ParityCheck
from spikedeploy.reports.columns import (
    WIDTH,
    describe_run,
    energy_hint,
    label,
    short_columns,
    tables,
)
from spikedeploy.reports.summary import describe_disturbances, headline, sentences_of, verdict
from spikedeploy.reports.table import Row, Table


def print_checks(checks: Iterable[ParityCheck]) -> None:
    """Print a line for each check: ✓ or ✗, what was compared, the numbers."""
    for check in checks:
        print_text(f"{'✓' if check.passed else '✗'} {check.name}: {check.detail}")


def print_verifications(found: Iterable[Verification]) -> None:
    """Print a line for each trace or recorded layer: ✓ or ✗, the result, what was not compared."""
    for each in found:
        result, *remarks = each.lines
        print(f"{'✓' if each.equal else '✗'} {each.path}: {result}")
        for remark in remarks:
            print(f"    {remark}")


def print_comparison(document: Mapping[str, Any], everything: bool = True) -> None:
    """Print the tables of a comparison and its summary.

    everything: else one table of at most 80 columns and the summary
    """
    rows = document["rows"]
    _print_head(document)
    if not everything:
        print_rows("", rows, document["env_id"])
        _print_sentences(document, "meaning", "energy")
        print_text("Agreement, sizes, operations, other energies: --tables all")
        return
    for title, columns in tables(rows).items():
        Table.from_records(columns, rows, title).print()
    for name, convention in document["conventions"].items():
        print_text(f"{name} is stepped with {convention}")
    for policy, remarks in document["remarks"].items():
        for remark in remarks:
            print_text(f"{policy}: {remark}")
    _print_sentences(document, "meaning", "energy", "env_remark")


def _print_sentences(document: Mapping[str, Any], *names: str) -> None:
    for name in names:
        if document.get(name):
            print_list(sentences_of(document[name]))


def _print_head(document: Mapping[str, Any]) -> None:
    episodes = document["rows"][0]["episodes"]
    print_text(f"{document['env_id']}, episodes of each policy: {episodes}\n")
    if disturbances := describe_disturbances(document):
        print_text(f"Disturbed by {disturbances}.\n")


def print_headline(document: Mapping[str, Any]) -> None:
    """Print the first sentence of a comparison and the numbers that its page leads with."""
    print_text(f"{document['env']}: {verdict(document)[0]}")
    for each in headline(document["rows"], document["env_id"]):
        beside = f"  ({'; '.join(each.beside)})" if each.beside else ""
        print_text(f"  {each.number}  {each.title}{beside}")
    print_text("")


def print_rows(title: str, rows: Sequence[Row], env: str = "") -> None:
    """Print one table of rows of a comparison, and which of their energies to quote."""
    Table.from_records(short_columns(rows, env), rows, title).print(WIDTH)
    _print_clocks(rows)
    if hint := energy_hint(rows):
        print_text(hint)


def _print_clocks(rows: Sequence[Row]) -> None:
    clocks: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.get("clock") and row["chip"] not in (None, "float"):
            clocks.setdefault((row["clock"], _describe_delay(row)), []).append(label(row))
    if clocks:
        each = (f"{clock} ({', '.join(names)}){late}" for (clock, late), names in clocks.items())
        print_text(f"Clock: {'; '.join(each)}.")


def _describe_delay(row: Row) -> str:
    """`: an observation acts 1 to 2 control steps later (20 to 40 ms)`; empty where it does not."""
    steps, seconds = row.get("control_steps_late"), row.get("late_s")
    if not steps:
        return ""
    in_time = f" ({_span([1e3 * each for each in seconds])} ms)" if seconds else ""
    unit = "control step" if steps == [1, 1] else "control steps"
    return f": an observation acts {_span(steps)} {unit} later{in_time}"


def _span(ends: Sequence[float]) -> str:
    """`1 to 2`, or `2` where both are equal."""
    least, most = (f"{each:.3g}" for each in ends)
    return least if least == most else f"{least} to {most}"


def print_run(document: Mapping[str, Any], everything: bool = False) -> None:
    """Print a run in one line, and which of its energies to quote; or all tables before that."""
    if everything:
        print_comparison(document)
    else:
        _print_head(document)
        for remarks in document["remarks"].values():
            for remark in remarks:
                if remark.startswith("fault "):  # what was asked for; the rest is in the tables
                    print_text(remark)
    if "real_time" in document:
        print_real_time(document["real_time"])
    print_text(describe_run(document))
    _print_clocks(document["rows"])
    if hint := energy_hint(document["rows"]):
        print_text(hint)
    if not everything:
        print_text("Sizes, operations, other energies, remarks: --tables all")


def print_real_time(found: Mapping[str, Any]) -> None:
    """Print what a paced loop measured: times of a control step, deadlines, periods."""
    rows = [
        (_TIMES[name], *(f"{1e3 * value:.3f}" for value in times.values()))
        for name, times in found["times_s"].items()
    ]
    title = f"{found['steps']:,} control steps at {found['rate_hz']:g} Hz; times in ms"
    heads = ("of a control step", "p50", "p95", "p99", "max")
    Table(heads, rows, title, numbers=True).print()
    missed = found["missed"]
    print_text(
        f"Deadlines of {1e3 * found['deadline_s']:g} ms missed: {missed['policy']:,} by the policy "
        f"({missed['policy_cpu']:,} by its own computation), {missed['step']:,} by the whole step. "
        f"Periods skipped: {found['skipped_periods']:,}."
    )


# names of RealTime.times
_TIMES = {
    "late": "woken late",
    "policy": "policy",
    "policy_cpu": "policy, its own computation",
    "step": "whole step",
}
