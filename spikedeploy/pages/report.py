"""The report of a comparison: report.json for machines, report.html and report.md for people."""

from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from spikedeploy import envs, zoo
from spikedeploy.comparison.comparison import Comparison
from spikedeploy.comparison.summary import summary
from spikedeploy.envs.disturbances import disturbances
from spikedeploy.files import as_text, write_text
from spikedeploy.outputs import marked
from spikedeploy.pages.comparison import comparison_page
from spikedeploy.pages.written import command_line
from spikedeploy.policies.registry import Candidate
from spikedeploy.recordings.recorded import of_comparison
from spikedeploy.reports.columns import COST, Row, markdown, tables
from spikedeploy.reports.energy_columns import COMMON_TABLE
from spikedeploy.reports.headline import disturbed, main_row
from spikedeploy.reports.markdown import markdown_name
from spikedeploy.reports.plots import draw_energy, draw_returns
from spikedeploy.reports.short_table import quoted_table
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.quantisation import PLAIN
from spikedeploy.runtime.metrics.energy import describe_table, energy_table
from spikedeploy.trainers.versions import own, versions

Document = Mapping[str, Any]


def document(comparison: Comparison) -> dict[str, Any]:
    """The report as plain data; one of its `rows` for each policy and chip."""
    rows = comparison.as_json()
    return {
        "env": envs.spec(comparison.env).short,
        "env_id": comparison.env,
        "seeds": {"first": comparison.seeds[0], "count": len(comparison.seeds)},
        "command": command_line(),
        "version": own(),
        "versions": versions(),
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "meaning": summary(rows),
        "env_remark": envs.spec(comparison.env).remark,
        "conventions": _conventions(comparison),
        "remarks": _remarks(comparison, rows),
        "disturbances": _disturbances(comparison),
        "energy_tables": _energy_tables(rows),
        "sha256": zoo.hashes(row["file"] for row in rows),
        "rows": rows,
    }


def recordings(
    comparison: Comparison, rows: Sequence[Row], options: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Episodes for the page, played once more: of the row that it is about and its references.

    rows     of the document
    options  of the environment
    """
    main = main_row(rows)
    table = quoted_table([main]) or COMMON_TABLE
    return of_comparison(comparison, list(rows).index(main), options, table)


def _conventions(comparison: Comparison) -> dict[str, str]:
    """Policy -> its convention, and its quantisation on chips."""
    candidates = {row.entry.candidate.name: row.entry.candidate for row in comparison.rows}
    return {name: _convention(c) for name, c in candidates.items() if c.format == ".nir"}


def _disturbances(comparison: Comparison) -> list[dict[str, Any]]:
    """What the world was disturbed by."""
    world = envs.spec(comparison.env).world
    found = disturbances(comparison.disturb, world) if comparison.disturb else []
    return [
        {"text": d.text, "name": d.name, "number": d.number, "unit": d.kind.unit,
         "meaning": d.kind.meaning}
        for d in found
    ]  # fmt: skip


def _hit(fault: Mapping[str, Any]) -> str:
    """`fault dead-neurons:2 (0.05) hits 60 of 1,204 neurons`."""
    hit, of = f"{fault['hit']:,}", f"{fault['of']:,}"
    return f"fault {fault['text']} ({fault['number']:g}) hits {hit} of {of} {fault['what']}"


def _remarks(comparison: Comparison, rows: Sequence[Row]) -> dict[str, list[str]]:
    """Label of a row -> remarks of the compiler, and what faults of the chip hit."""
    remarks = {
        row.entry.label: [*row.episodes[0].remarks, *map(_hit, found.get("faults", ()))]
        for row, found in zip(comparison.rows, rows, strict=True)
    }
    return {label: said for label, said in remarks.items() if said}


def _convention(candidate: Candidate) -> str:
    said = load(candidate.path).convention.describe()
    plain = candidate.quantisation == PLAIN
    return said if plain else f"{said}; on chips {candidate.quantisation.describe()}"


def _energy_tables(rows: Sequence[Row]) -> dict[str, str]:
    """Energy table -> its source."""
    names = dict.fromkeys(name for row in rows for name in row["energy_per_inference_j"])
    tables = [energy_table(name) for name in names]
    return {table.name: describe_table(table) for table in tables}


# of a folder with a report
FILES = ("report.html", "report.json", "report.md", "returns.png", "energy.png")


def is_report(folder: Path) -> bool:
    """Whether a comparison was written into the folder."""
    numbers = folder / "report.json"
    return numbers.is_file() and marked(numbers, '"command": "spikedeploy ')


def write(
    document: Document, folder: Path, video: Path | None = None, episodes: Sequence[Document] = ()
) -> list[Path]:
    """Write page, numbers, Markdown and plots into the folder; return the files in that order.

    episodes  of `recordings`, which the page alone has
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows = document["rows"]
    shown = tables(rows)
    pictures = {next(iter(shown)): draw_returns(rows, folder / "returns.png")}
    if COST in shown:
        pictures[COST] = draw_energy(rows, folder / "energy.png")
    numbers = write_text(folder / "report.json", as_text(document))
    text = comparison_page(document, _facts(document), _stepped(document), episodes, video)
    page = write_text(folder / "report.html", text)
    plain = write_text(folder / "report.md", _page_of_text(document))
    return [page, numbers, plain, *pictures.values(), *([video] if video else [])]


def _page_of_text(document: Document) -> str:
    """The tables in Markdown, under the command that made them."""
    steps = [f"* {markdown_name(name)}: {said}" for name, said in _stepped(document)]
    lines = [f"    {document['command']}", "", document["meaning"], "", *markdown(document["rows"])]
    if remark := document.get("env_remark"):
        lines[4:4] = [remark, ""]
    if said := disturbed(document):
        lines[2:2] = [f"Disturbed by {said}.", ""]
    if steps:
        lines += ["How the networks are stepped:", "", *steps, ""]
    return "\n".join(lines)


def _stepped(document: Document) -> list[tuple[str, str]]:
    """How the networks are stepped: conventions, then remarks on chips."""
    remarks = [(label, said) for label, each in document["remarks"].items() for said in each]
    return [*document["conventions"].items(), *remarks]


def _facts(document: Document) -> dict[str, str]:
    """How the report was made."""
    first, count = document["seeds"]["first"], document["seeds"]["count"]
    facts = {
        "environment": document["env_id"],
        "episodes": f"{count} each, seeds {first} to {first + count - 1}",
        "made by": f"spikedeploy {document['version']}, {document['created']}",
        "command": document["command"],
    }
    if said := disturbed(document):
        facts["disturbed by"] = said
    return facts
