"""Pages: HTML files that need nothing else, in light and dark, on phones and on paper.

`templates` has a template of each page and of its parts; `assets` their style and scripts.
"""

import re
import shlex
import sys
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from functools import cache, partial
from html import unescape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from spikedeploy.outputs import has_text
from spikedeploy.reports.plots import svg
from spikedeploy.reports.table import Table
from spikedeploy.runtime.files import as_text, write_text
from spikedeploy.trainers.versions import own

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure

# what replays recorded episodes
REPLAY_ASSETS = ("unpack.js", "bodies.js", "track.js", "maps.js", "film.js", "strips.js",
                 "instrument.js")  # fmt: skip
FILES = ("report.html", "report.json")
_COMMENT = re.compile(r"<!--.*?-->\n?")
_PICTURE = re.compile(r'<p><img src="(?P<source>[^"]*)" alt="(?P<alt>[^"]*)" /></p>')
_TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
_CELLS = re.compile(r"<t[hd]>(.*?)</t[hd]>", re.DOTALL)
_HEADS = re.compile(r"(?=<h\d>)")
_FOLDED = re.compile(r"<h3>(.*?)</h3>\n?", re.DOTALL)  # head of a section that is folded


def render(template: str, **content: Any) -> str:  # noqa: ANN401
    """The page of a template; text in `content` is escaped, Markup is not."""
    return _environment().get_template(f"{template}.html.j2").render(content)


def asset(name: str) -> str:
    """A style or script of the pages."""
    return files("spikedeploy.reports").joinpath("assets").joinpath(name).read_text("utf-8")


@cache
def _environment() -> "Environment":
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("spikedeploy.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals.update(asset=asset, replay_assets=REPLAY_ASSETS, lead="", reload=0, poster=0)
    made.policies["json.dumps_kwargs"] = {"allow_nan": False}
    return made


# the folder of a page


def command_line() -> str:
    """The command that this process runs, as it can be typed again."""
    return shlex.join(["spikedeploy", *sys.argv[1:]])


def provenance() -> list[tuple[str, str]]:
    """The origin of a page: version, time, command line."""
    now = datetime.now(timezone.utc).isoformat(timespec="seconds")
    return [("made by", f"spikedeploy {own()}, {now}"), ("command line", command_line())]


def write_page(command: str, html: str, numbers: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the page of a command and its numbers; return both files."""
    made = {"report_of": command, **dict(provenance()), **numbers}
    return [
        write_text(folder / "report.html", html),
        write_text(folder / "report.json", as_text(made)),
    ]


def is_page_of(command: str) -> Callable[[Path], bool]:
    """A test of folders: whether an earlier run of this command wrote its page there."""
    return lambda folder: has_text(folder / "report.json", f'"report_of": "{command}"')


# Markdown


def write_beside(path: Path, text: str, figures: "Mapping[str, Figure]") -> list[Path]:
    """Write the text, and the same as HTML with the ending .html; return both.

    figures: address of a picture in the text -> what is drawn in its place
    """
    page = render_markdown(text, figures)
    return [write_text(path, text), write_text(path.with_suffix(".html"), page)]


def render_markdown(text: str, figures: "Mapping[str, Figure]") -> str:
    """The page of a text whose first line is its title; sections of the third level are folded."""
    from markdown_it import MarkdownIt

    # what looks like HTML in the text is a name that a user chose, and is escaped
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    title, _, body = _COMMENT.sub("", text).partition("\n")
    html = _PICTURE.sub(partial(_draw, figures), _TABLE.sub(_table, parser.render(body)))
    return render("text", title=title.lstrip("# "), sections=map(_section, _HEADS.split(html)))


def _section(html: str) -> tuple[Markup, Markup]:
    """Title, which is empty where the section is not folded, and content."""
    head = _FOLDED.match(html)
    return (Markup(head[1]), Markup(html[head.end() :])) if head else (Markup(), Markup(html))


def _draw(figures: "Mapping[str, Figure]", picture: re.Match[str]) -> str:
    drawing = figures.get(picture["source"])
    return f"<figure>{svg(drawing, unescape(picture['alt']))}</figure>" if drawing else ""


def _table(found: re.Match[str]) -> str:
    """A table of Markdown as other tables of pages."""
    lines = found[0].split("</tr>")[:-1]
    heads, *rows = ([Markup(cell) for cell in _CELLS.findall(row)] for row in lines)
    parts: Any = _environment().get_template("parts.html.j2").module
    return str(parts.table(Table(heads, rows)))
