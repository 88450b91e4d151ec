"""Pages: HTML files that need nothing else, in light and dark, on phones and on paper.

`templates` has a template of each page and of its parts; `assets` their style and scripts.
"""

import re
import shlex
import sys
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime, timezone
from functools import cache
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from spikedeploy.files import as_text, write_text
from spikedeploy.outputs import marked
from spikedeploy.reports.plots import svg
from spikedeploy.reports.table import Table
from spikedeploy.trainers.versions import own

if TYPE_CHECKING:
    from jinja2 import Environment
    from markdown_it.token import Token
    from matplotlib.figure import Figure

# what replays recorded episodes
REPLAY_ASSETS = ("unpack.js", "bodies.js", "track.js", "strips.js", "instrument.js")
FILES = ("report.html", "report.json")
_COMMENT = re.compile(r"<!--.*?-->\n?")
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
    made.globals.update(asset=asset, replay_assets=REPLAY_ASSETS, lead="", reload=0)
    made.policies["json.dumps_kwargs"] = {"allow_nan": False}
    return made


def standalone_svg(drawn: str) -> str:
    """An SVG of a page as a file of its own, light or dark as its reader is."""
    colours = asset("page.css").partition("* {")[0]
    head, _, rest = drawn.partition(">")
    own = "svg { background: var(--card); } text { fill: var(--ink); }"
    return f"{head}><style>{colours}{own}</style>{rest}"


# the folder of a page


def command_line() -> str:
    """The command that this process runs, as it can be typed again."""
    return shlex.join(["spikedeploy", *sys.argv[1:]])


def provenance() -> list[tuple[str, str]]:
    """How a page is made: version, time, command line."""
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
    return lambda folder: marked(folder / "report.json", f'"report_of": "{command}"')


# Markdown


def write_beside(path: Path, text: str, figures: "Mapping[str, Figure]") -> list[Path]:
    """Write the text, and the same as HTML with the ending .html; return both.

    figures  address of a picture in the text -> what is drawn in its place
    """
    page = render_markdown(text, figures)
    return [write_text(path, text), write_text(path.with_suffix(".html"), page)]


def render_markdown(text: str, figures: "Mapping[str, Figure]") -> str:
    """The page of a text whose first line is its title; sections of the third level are folded."""
    from markdown_it import MarkdownIt

    # what looks like HTML in the text is a name that a user chose, and is escaped
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    title, _, body = _COMMENT.sub("", text).partition("\n")
    tokens = list(_align_tables(list(_draw_pictures(parser.parse(body), figures))))
    html = parser.renderer.render(tokens, parser.options, {})
    return render("text", title=title.lstrip("# "), sections=map(_section, _HEADS.split(html)))


def _section(html: str) -> tuple[Markup, Markup]:
    """Title, which is empty where the section is not folded, and content."""
    head = _FOLDED.match(html)
    return (Markup(head[1]), Markup(html[head.end() :])) if head else (Markup(), Markup(html))


def _draw_pictures(tokens: "Sequence[Token]", figures: "Mapping[str, Figure]") -> "Iterator[Token]":
    """The tokens with a drawing in place of each paragraph that is a picture."""
    waiting = iter(enumerate(tokens))
    for place, each in waiting:
        picture = _picture(tokens[place + 1]) if each.type == "paragraph_open" else None
        if picture is None:
            yield each
            continue
        drawing = figures.get(str(picture.attrs["src"]))
        yield _html(f"<figure>{svg(drawing, picture.content)}</figure>" if drawing else "")
        next(waiting), next(waiting)  # the picture, and the end of its paragraph


def _picture(inline: "Token") -> "Token | None":
    """The picture that is all of a paragraph."""
    children = inline.children or []
    return children[0] if len(children) == 1 and children[0].type == "image" else None


def _align_tables(tokens: "Sequence[Token]") -> "Iterator[Token]":
    """The tokens with every table in a card of its own, and columns of words at the left."""
    column = 0
    for place, each in enumerate(tokens):
        if each.type == "table_open":
            table = _table(tokens[place:])
            yield _html('<div class="card">')
        elif each.type == "tr_open":
            column = 0
        elif each.type in ("th_open", "td_open"):
            kind = table.cell_class(column, tokens[place + 1].content)
            each.attrs = {"class": kind} if kind else {}
            column += 1
        yield each
        if each.type == "table_close":
            yield _html("</div>")


def _table(tokens: "Sequence[Token]") -> Table:
    """The table that begins here."""
    rows: list[list[str]] = []
    for place, each in enumerate(tokens):
        if each.type == "table_close":
            break
        if each.type == "tr_open":
            rows.append([])
        elif each.type in ("th_open", "td_open"):
            rows[-1].append(tokens[place + 1].content)
    return Table(rows[0], rows[1:])


def _html(text: str) -> "Token":
    from markdown_it.token import Token

    return Token("html_block", "", 0, content=text)


# notebooks


def notebook_card(title: str, facts: Mapping[str, str]) -> str:
    """HTML of a title, and names with values."""
    return render("notebook", title=title, facts=facts.items(), table=None, text="")


def notebook_table(table: Table, text: str) -> str:
    """HTML of a table, and a text below it."""
    return render("notebook", title="", facts=(), table=table, text=text)


def notebook_picture(figure: "Figure") -> str:
    """HTML of a figure as a PNG."""
    memory = BytesIO()
    figure.savefig(memory, format="png", dpi=80, bbox_inches="tight")
    return f'<img src="data:image/png;base64,{b64encode(memory.getvalue()).decode()}">'
