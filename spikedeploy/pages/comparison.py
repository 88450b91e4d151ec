"""The page of a comparison, which replays recorded episodes."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

from spikedeploy.pages.page import (
    big_numbers,
    facts,
    figure,
    folded,
    heading,
    hint,
    page,
    part,
    said,
    table,
)
from spikedeploy.pages.svg import energy_svg, returns_svg
from spikedeploy.reports.columns import COST, Column, Row, label, tables
from spikedeploy.reports.headline import headline, verdict
from spikedeploy.reports.short_table import energy_hint, short_columns, short_label

SCRIPTS = ("unpack.js", "bodies.js", "track.js", "strips.js", "instrument.js")
_LEGEND = (
    "Spikes, membranes, actions and operations are those of the last policy in the list above the "
    "curves; the others are drawn as ghosts. Colours of maps: orange positive, blue negative."
)


def comparison_page(
    document: Mapping[str, Any],
    made: Mapping[str, str],
    stepped: Sequence[tuple[str, str]],
    episodes: Sequence[Mapping[str, Any]] = (),
    video: Path | None = None,
) -> str:
    """The page as one file, recorded episodes and video embedded.

    made     how it was made
    stepped  how the networks are stepped: name and convention, or remark
    """
    rows = document["rows"]
    first, more = verdict(document)
    instrument, scripts = replay(document, episodes)
    several = f"{document['env']}: {len(rows)} policies on the same seeds"
    return page(
        several if len(rows) > 1 else f"{document['env']}: {rows[0]['policy']}",
        " ".join(filter(None, (first, _disturbed(made)))),
        [
            big_numbers(headline(rows, document["env_id"])),
            instrument,
            _video(video) if video else "",
            heading("All policies"),
            policy_table(rows, document["env_id"]),
            hint(energy_hint(rows)),
            said(more, document.get("env_remark", "")),
            *_folded(document, made, stepped),
        ],
        scripts,
    )


def replay(document: Mapping[str, Any], episodes: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """What replays recorded episodes on a page: its section, and scripts at the page's end.

    Both are empty without episodes. A page holds one.
    """
    if not episodes:
        return "", ""
    section = Template(part("instrument.html")).substitute(legend=_LEGEND)
    return section, _data(_renamed(episodes, document))


def policy_table(rows: Sequence[Row], env: str) -> str:
    """Some rows of a comparison, in the few columns that everybody reads.

    env  id of the environment
    """
    return _table(short_columns(rows, env), rows)


def _disturbed(made: Mapping[str, str]) -> str:
    return f"Disturbed by {made['disturbed by']}." if "disturbed by" in made else ""


def _folded(
    document: Mapping[str, Any], made: Mapping[str, str], stepped: Sequence[tuple[str, str]]
) -> Iterable[str]:
    """Everything else, each under a line that opens it."""
    rows, shown = document["rows"], tables(document["rows"])
    plots = {next(iter(shown)): returns_svg(rows), COST: energy_svg(rows)}
    for title, columns in shown.items():
        yield folded(title, _table(columns, rows) + figure(plots.get(title, "")))
    meanings = {column.title: column.meaning for columns in shown.values() for column in columns}
    yield folded("What the columns mean", facts(meanings.items()))
    yield folded("Where the energies come from", facts(document["energy_tables"].items()))
    if stepped:
        yield folded("How the spiking networks are stepped", facts(stepped))
    versions = document.get("versions", {})
    yield folded("How this was made", facts([*made.items(), *_versions(versions)]))


def _versions(versions: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [(name, str(number)) for name, number in versions.items() if number]


def _table(columns: Sequence[Column], rows: Sequence[Row]) -> str:
    cells = [[column.cell(row) for column in columns] for row in rows]
    return table([(c.title, c.meaning) for c in columns], cells, map(_class, rows))


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
