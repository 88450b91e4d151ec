"""`submit`: a row of the public table, made of a report, or checked."""

from pathlib import Path

import typer

from spikedeploy.console import print_result
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix


def submit(
    *,
    report: Path | None = None,
    output: Path | None = None,
    policy: str | None = None,
    chip: str | None = None,
    rival: str | None = None,
    source: str = "not named",
    check: Path | None = None,
    force: bool = False,
    json: bool = False,
) -> None:
    """Make a row of the public table of a report, or check one; exit 1 where it is wrong.

    docs/leaderboard.md has the table. With REPORT, --check compares every number with it.
    """
    from spikedeploy.outputs import check_output, has_text
    from spikedeploy.shipping import leaderboard

    if check is not None:
        if output or policy or chip or rival:
            raise typer.BadParameter("--check writes nothing, and the row says of what it is")
        row = leaderboard.read_row(check)
        wrong = list(leaderboard.faults(row))
        if report is not None:
            wrong += leaderboard.differences(row, *_document(report))
        left = list(leaderboard.not_checked(row))
        lines = [f"\u2717 {each}" for each in wrong] or [f"\u2713 {check}: nothing is wrong"]
        record = {"passed": not wrong, "faults": wrong, "not_checked": left}
        print_result(json, record, *lines, *(f"    not checked: {each}" for each in left))
        raise typer.Exit(1 if wrong else 0)
    if report is None or output is None:
        raise ConfigError(
            "a row is made of a report: `spikedeploy compare ENV FILE --episodes 100 -o "
            "reports/mine`, then `spikedeploy submit reports/mine -o row.json`"
        )
    inputs = [report, report / "report.json"]
    check_output("-o", output, inputs, force, lambda path: has_text(path, '"over_trainings":'))
    row = leaderboard.row_of_report(*_document(report), policy, chip, rival, source)
    leaderboard.write_row(row, output)
    spiking, beside = row.spiking.name, row.rival.name if row.rival else "no float policy"
    line = f"wrote {output}: {spiking} on {row.chip} beside {beside}"
    print_result(json, {"path": str(output), "row": leaderboard.plain(row)}, line)


def _document(report: Path) -> tuple[dict[str, object], str]:
    """A report as data, and its name."""
    from spikedeploy.shipping.cards import REPORT, read_report

    path = report / REPORT if report.is_dir() or suffix(report) != ".json" else report
    return read_report(path)[0], str(report)
