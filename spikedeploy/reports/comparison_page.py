"""The report of a comparison: report.json for machines, report.html and report.md for people."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from markupsafe import Markup

from spikedeploy import envs, zoo
from spikedeploy.comparison.comparison import Comparison
from spikedeploy.envs.disturbances import disturbances
from spikedeploy.outputs import has_text
from spikedeploy.recordings import record_comparison
from spikedeploy.reports.columns import (
    COST,
    energy_hint,
    label,
    markdown_tables,
    quoted_table,
    short_columns,
    short_label,
    tables,
)
from spikedeploy.reports.page import command_line, render
from spikedeploy.reports.plots import energy_figure, returns_figure, save, svg
from spikedeploy.reports.summary import (
    describe_disturbances,
    energy_verdict,
    headline,
    main_row,
    sentences_of,
    summary,
    verdict,
)
from spikedeploy.reports.table import COMMON_TABLE, Column, Row, Table, escape_markdown
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.quantisation import PLAIN
from spikedeploy.runtime.files import as_text, write_text
from spikedeploy.runtime.metrics.energy import energy_table
from spikedeploy.trainers.versions import own, versions

Document = Mapping[str, Any]
FILES = ("report.html", "report.json", "report.md", "returns.png", "energy.png")


def document(comparison: Comparison) -> dict[str, Any]:
    """The report as plain data; one of its `rows` for each policy and chip."""
    rows = comparison.as_json()
    played = [row.entry.candidate for row in comparison.rows]
    teachers = [each.path for each in played if each.format in ("teacher", "function")]
    return {
        "env": envs.spec(comparison.env).short,
        "env_id": comparison.env,
        "seeds": {"first": comparison.seeds[0], "count": len(comparison.seeds)},
        "command": command_line(),
        "version": own(),
        "versions": versions(),
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "meaning": summary(rows),
        "energy": energy_verdict(rows),
        "env_remark": envs.spec(comparison.env).remark,
        "conventions": _conventions(comparison),
        "remarks": _remarks(comparison, rows),
        "disturbances": _disturbances(comparison),
        "energy_tables": _energy_tables(rows),
        "sha256": zoo.hashes(row["file"] for row in rows),
        "rows": rows,
        "setup": comparison.setup.as_json(),
        **({"teachers": teachers} if teachers else {}),
    }


def _conventions(comparison: Comparison) -> dict[str, str]:
    """Policy -> its convention, and its quantisation on chips."""
    quantisation = comparison.setup.quantisation
    on_chips = "" if quantisation == PLAIN else f"; on chips {quantisation.describe()}"
    candidates = {row.entry.candidate.name: row.entry.candidate for row in comparison.rows}
    return {
        name: f"{load(each.path).convention.describe()}{on_chips}"
        for name, each in candidates.items()
        if each.format == ".nir"
    }


def _remarks(comparison: Comparison, rows: Sequence[Row]) -> dict[str, list[str]]:
    """Label of a row -> remarks of the compiler, and what faults of the chip hit."""
    remarks = {
        row.entry.label: [*row.episodes[0].remarks, *map(_describe_hit, found.get("faults", ()))]
        for row, found in zip(comparison.rows, rows, strict=True)
    }
    return {label: lines for label, lines in remarks.items() if lines}


def _describe_hit(fault: Mapping[str, Any]) -> str:
    """`fault dead-neurons:2 (0.05) hits 60 of 1,204 neurons`."""
    hit, of = f"{fault['hit']:,}", f"{fault['of']:,}"
    return f"fault {fault['text']} ({fault['number']:g}) hits {hit} of {of} {fault['what']}"


def _disturbances(comparison: Comparison) -> list[dict[str, Any]]:
    world = envs.spec(comparison.env).world
    found = disturbances(comparison.setup.disturb, world)
    return [
        {"text": d.text, "name": d.name, "number": d.number, "unit": d.kind.unit,
         "meaning": d.kind.meaning}
        for d in found
    ]  # fmt: skip


def _energy_tables(rows: Sequence[Row]) -> dict[str, str]:
    names = dict.fromkeys(name for row in rows for name in row["energy_per_inference_j"])
    return {name: energy_table(name).describe() for name in names}


def recordings(
    comparison: Comparison, rows: Sequence[Row], options: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Episodes for the page, played once more: of the row that it is about and its references.

    rows: rows of the document
    options: options of the environment
    """
    main = main_row(rows)
    table = quoted_table([main]) or COMMON_TABLE
    return record_comparison(comparison, list(rows).index(main), options, table)


def is_report(folder: Path) -> bool:
    """True if a comparison was written into the folder."""
    return has_text(folder / "report.json", '"command": "spikedeploy ')


def write(
    document: Document, folder: Path, video: Path | None = None, episodes: Sequence[Document] = ()
) -> list[Path]:
    """Write page, numbers, Markdown and plots into the folder; return the files in that order.

    episodes: episodes of `recordings`, which the page alone has
    """
    rows = document["rows"]
    pictures = [save(returns_figure(rows), folder / "returns.png")]
    if COST in tables(rows):
        pictures.append(save(energy_figure(rows), folder / "energy.png"))
    numbers = write_text(folder / "report.json", as_text(document))
    page = write_text(folder / "report.html", comparison_page(document, episodes, video))
    text = write_text(folder / "report.md", _markdown(document))
    return [page, numbers, text, *pictures, *([video] if video else [])]


def _markdown(document: Document) -> str:
    """The tables in Markdown, under the command that made them."""
    disturbed = describe_disturbances(document)
    steps = [f"* {escape_markdown(name)}: {what}" for name, what in _steps(document)]
    paragraphs = [
        f"    {document['command']}",
        f"Disturbed by {disturbed}." if disturbed else None,
        document["meaning"],
        document.get("energy") or None,
        document.get("env_remark") or None,
        markdown_tables(document["rows"]).rstrip("\n"),
        *(["How the networks are stepped:", "\n".join(steps)] if steps else []),
    ]
    return "\n\n".join(each for each in paragraphs if each is not None) + "\n"


def comparison_page(
    document: Document, episodes: Sequence[Document] = (), video: Path | None = None
) -> str:
    """The page as one file, recorded episodes and video embedded."""
    rows, env = document["rows"], document["env"]
    first, more = verdict(document)
    shown = tables(rows)
    columns = [column for each in shown.values() for column in each]
    disturbed = describe_disturbances(document)
    return render(
        "comparison",
        title=f"{env}: {len(rows)} policies on the same seeds"
        if len(rows) > 1
        else f"{env}: {rows[0]['policy']}",
        lead=first + (f" Disturbed by {disturbed}." if disturbed else ""),
        numbers=headline(rows, document["env_id"]),
        episodes=name_players(episodes, document),
        video=b64encode(video.read_bytes()).decode() if video else "",
        policies=policy_table(rows, document["env_id"]),
        energy_hint=energy_hint(rows),
        remarks=[
            *sentences_of(more),
            *sentences_of(document.get("energy", "")),
            *sentences_of(document.get("env_remark", "")),
        ],
        tables={title: _table(columns, rows) for title, columns in shown.items()},
        drawings=_drawings(rows, shown),
        meanings={column.title: column.meaning for column in columns},
        energy_tables=document["energy_tables"],
        steps=_steps(document),
        made=_provenance(document),
    )


def policy_table(rows: Sequence[Row], env: str) -> Table:
    """Some rows of a comparison, in the few columns that everybody reads.

    env: id of the environment
    """
    return _table(short_columns(rows, env), rows)


def _table(columns: Sequence[Column], rows: Sequence[Row]) -> Table:
    kinds = [
        "chip" if row["kind"] == "snn" and row["chip"] != "float" else row["kind"] for row in rows
    ]
    return Table.from_records(columns, rows, kinds=kinds)


def _drawings(rows: Sequence[Row], shown: Mapping[str, Any]) -> dict[str, Markup]:
    alt = "Return of each episode, mean and any 95% interval of each row"
    drawings = {next(iter(shown)): svg(returns_figure(rows), alt)}
    if any(row["energy_per_inference_j"] for row in rows):
        alt = "Energy of an inference by each table, on a logarithmic axis"
        drawings[COST] = svg(energy_figure(rows), alt)
    return drawings


def name_players(episodes: Sequence[Document], document: Document) -> list[dict[str, Any]]:
    """The episodes with the names of policies that the tables have."""
    rows = document["rows"]
    short = short_label(rows, document["env_id"])
    names = {label(row): short(row) for row in rows}
    return [
        {
            **episode,
            "players": [
                {**player, "label": names.get(player["label"], player["label"])}
                for player in episode["players"]
            ],
        }
        for episode in episodes
    ]


def _steps(document: Document) -> list[tuple[str, str]]:
    """Sentences on how networks are stepped: conventions, then remarks on chips."""
    remarks = [(label, line) for label, lines in document["remarks"].items() for line in lines]
    return [*document["conventions"].items(), *remarks]


def _provenance(document: Document) -> list[tuple[str, str]]:
    first, count = document["seeds"]["first"], document["seeds"]["count"]
    facts = {
        "environment": document["env_id"],
        "episodes": f"{count} each, seeds {first} to {first + count - 1}",
        "made by": f"spikedeploy {document['version']}, {document['created']}",
        "command": document["command"],
        "disturbed by": describe_disturbances(document),
        **document.get("versions", {}),
    }
    return [(name, str(value)) for name, value in facts.items() if value]
