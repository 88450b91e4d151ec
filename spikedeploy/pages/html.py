"""A comparison as one HTML file that needs nothing else."""

import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from spikedeploy.pages.svg import energy_svg, returns_svg
from spikedeploy.reports.columns import COST, Column, Row, label, tables
from spikedeploy.reports.headline import headline, verdict
from spikedeploy.reports.short_table import energy_hint, short_columns, short_label

SCRIPTS = ("unpack.js", "bodies.js", "track.js", "strips.js", "instrument.js")
_LEGEND = (
    "Spikes, membranes, actions and operations are those of the last policy in the list above the "
    "curves; the others are drawn as ghosts. Colours of maps: orange positive, blue negative."
)


def html(
    document: Mapping[str, Any],
    facts: Mapping[str, str],
    stepped: Sequence[tuple[str, str]],
    episodes: Sequence[Mapping[str, Any]] = (),
    video: Path | None = None,
) -> str:
    """The page as one file, recorded episodes and video embedded.

    facts    of how it was made
    stepped  how the networks are stepped: name and convention, or remark
    """
    rows = document["rows"]
    first, more = verdict(document)
    return Template(part("report.html")).substitute(
        title=escape(f"{document['env']}: {len(rows)} policies on the same seeds")
        if len(rows) > 1
        else escape(f"{document['env']}: {rows[0]['policy']}"),
        style=part("report.css"),
        verdict=escape(" ".join(filter(None, (first, _disturbed(facts))))),
        figures=figures(rows, document["env_id"]),
        instrument=Template(part("instrument.html")).substitute(legend=_LEGEND) if episodes else "",
        video=_video(video) if video else "",
        table=_main_table(document),
        said=_said(more, document.get("env_remark", "")),
        folded="".join(_folded(document, facts, stepped)),
        data=_data(_renamed(episodes, document)) if episodes else "",
    )


def _disturbed(facts: Mapping[str, str]) -> str:
    return f"Disturbed by {facts['disturbed by']}." if "disturbed by" in facts else ""


def part(name: str) -> str:
    """A template, style or script of the page."""
    return files("spikedeploy.pages").joinpath(name).read_text(encoding="utf-8")


def figures(rows: Sequence[Row], env: str) -> str:
    """The numbers that a page leads with."""
    cells = (
        f'<div><dt>{escape(each.title)}</dt><dd class="big">{escape(each.number)}</dd>'
        f'<dd class="beside">{escape(each.beside)}</dd></div>'
        for each in headline(rows, env)
    )
    return f'<dl class="figures">{"".join(cells)}</dl>'


def _main_table(document: Mapping[str, Any]) -> str:
    rows = document["rows"]
    columns = short_columns(rows, document["env_id"])
    hint = energy_hint(rows)
    said = f'<p class="hint">{escape(hint)}</p>' if hint else ""
    return f'<h2>All policies</h2><div class="card">{_table(columns, rows)}</div>{said}'


def _said(*sentences: str) -> str:
    return "".join(f'<p class="more">{escape(each)}</p>' for each in sentences if each)


def _folded(
    document: Mapping[str, Any], facts: Mapping[str, str], stepped: Sequence[tuple[str, str]]
) -> Iterable[str]:
    """Everything else, each under a line that opens it."""
    rows, shown = document["rows"], tables(document["rows"])
    plots = {next(iter(shown)): returns_svg(rows), COST: energy_svg(rows)}
    for title, columns in shown.items():
        plot = plots.get(title)
        figure = f"<figure>{plot}</figure>" if plot else ""
        yield _details(title, f'<div class="card">{_table(columns, rows)}</div>{figure}')
    meanings = {column.title: column.meaning for columns in shown.values() for column in columns}
    yield _details("What the columns mean", _list(meanings.items()))
    yield _details("Where the energies come from", _list(document["energy_tables"].items()))
    if stepped:
        yield _details("How the spiking networks are stepped", _list(stepped))
    versions = document.get("versions", {})
    yield _details("How this was made", _list([*facts.items(), *_versions(versions)]))


def _versions(versions: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [(name, str(number)) for name, number in versions.items() if number]


def _details(title: str, body: str) -> str:
    return f"<details><summary>{escape(title)}</summary>{body}</details>"


def _table(columns: Sequence[Column], rows: Sequence[Row]) -> str:
    head = "".join(f'<th title="{escape(c.meaning)}">{escape(c.title)}</th>' for c in columns)
    body = "".join(
        f'<tr class="{_class(row)}">'
        + "".join(f"<td>{escape(column.cell(row))}</td>" for column in columns)
        + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _class(row: Row) -> str:
    """The CSS class of a row: chip, or its kind."""
    return "chip" if row["kind"] == "snn" and row["chip"] != "float" else str(row["kind"])


def _video(path: Path) -> str:
    from base64 import b64encode

    source = f"data:video/mp4;base64,{b64encode(path.read_bytes()).decode()}"
    return f'<video controls muted loop src="{source}"></video>'


def _renamed(
    episodes: Sequence[Mapping[str, Any]], document: Mapping[str, Any]
) -> list[dict[str, Any]]:
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


def _data(episodes: Sequence[Mapping[str, Any]]) -> str:
    # "</script>" in a name would end the element
    text = json.dumps(episodes, allow_nan=False).replace("<", "\\u003c")
    scripts = "\n".join(part(name) for name in SCRIPTS)
    return (
        f'<script type="application/json" id="episodes-data">{text}</script>'
        f'<script type="module">\n{scripts}</script>'
    )


def _list(items: Iterable[tuple[str, str]]) -> str:
    pairs = (f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in items)
    return f'<dl class="facts">{"".join(pairs)}</dl>'
