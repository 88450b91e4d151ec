"""The tables of results/firmware.md, from tables.md, and the options of all commands."""

import argparse
import json
from pathlib import Path

from jinja2 import Environment

from spikedeploy.reports.table import ABSENT
from spikedeploy.runtime.files import write_text

PAGE = Path(__file__).parents[2] / "results/firmware.md"
# places of the tables on the page
OWN, PEERS, NETWORKS, INTEGERS = "firmware", "peers", "networks", "integers"
_TEMPLATES = Environment(trim_blocks=True, lstrip_blocks=True, autoescape=False)
_TEMPLATES.filters |= {
    "form": format,
    # a dash where a tool was missing
    "kB": lambda value: f"{value / 1000:.1f}" if value else ABSENT,
    "count": lambda value: f"{value:,}" if isinstance(value, int) else ABSENT,
}


def table(place: str, rows: list[dict]) -> str:
    """Rows as the table of a place, in Markdown."""
    text = Path(__file__).with_name("tables.md").read_text(encoding="utf-8")
    return _TEMPLATES.from_string(text).render(place=place, rows=rows)


def options_of(doc: str, only: str) -> argparse.ArgumentParser:
    """The options that all of the commands have."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--only", default="", help=only)
    parser.add_argument("--write", action="store_true", help="the table into results/firmware.md")
    parser.add_argument("--json", action="store_true")
    return parser


def publish(options: argparse.Namespace, rows: list[dict], place: str, intro: str = "") -> None:
    """Print the rows or their table; with --write put it between the marks of its place."""
    text = table(place, rows)
    print(json.dumps(rows) if options.json else text)
    if options.write:
        start, end = f"<!-- {place} -->\n", f"<!-- end of {place} -->\n"
        head, rest = PAGE.read_text(encoding="utf-8").split(start)
        _, tail = rest.split(end)
        write_text(PAGE, f"{head}{start}{intro}{text}{end}{tail}")
