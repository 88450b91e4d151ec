"""A page in Markdown as HTML beside it, its pictures drawn in the colours of the page."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from spikedeploy.files import write_text
from spikedeploy.pages.page import cell_class, column_classes, figure, folded, page
from spikedeploy.pages.svg import svg

if TYPE_CHECKING:
    from markdown_it import MarkdownIt
    from markdown_it.token import Token
    from matplotlib.figure import Figure

_COMMENT = re.compile(r"<!--.*?-->\n?")
_FOLDED = "h3"  # heads whose sections are folded


def write_beside(path: Path, text: str, figures: "Mapping[str, Figure]") -> list[Path]:
    """Write the text, and the same as HTML with the ending .html; return both.

    figures  address of a picture in the text -> what is drawn in its place
    """
    return [write_text(path, text), write_text(path.with_suffix(".html"), html_of(text, figures))]


def html_of(text: str, figures: "Mapping[str, Figure]") -> str:
    """The page of a text whose first line is its title; sections of the third level are folded."""
    from markdown_it import MarkdownIt

    # what looks like HTML in the text is a name that a user chose, and is escaped
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    title, _, body = _COMMENT.sub("", text).partition("\n")
    tokens = list(_tables(list(_pictures(parser.parse(body), figures))))
    return page(title.lstrip("# "), "", _sections(parser, tokens))


def _sections(parser: "MarkdownIt", tokens: "Sequence[Token]") -> Iterator[str]:
    """The HTML up to each head, and below it."""
    starts = [place for place, each in enumerate(tokens) if each.type == "heading_open"]
    for first, last in zip([0, *starts], [*starts, len(tokens)], strict=True):
        part = tokens[first:last]
        if part and part[0].tag == _FOLDED and part[0].type == "heading_open":
            yield folded(part[1].content, _rendered(parser, part[3:]))
        else:
            yield _rendered(parser, part)


def _rendered(parser: "MarkdownIt", tokens: "Sequence[Token]") -> str:
    return str(parser.renderer.render(tokens, parser.options, {}))


def _pictures(tokens: "Sequence[Token]", figures: "Mapping[str, Figure]") -> "Iterator[Token]":
    """The tokens with a drawing in place of each paragraph that is a picture."""
    skipped = 0
    for place, each in enumerate(tokens):
        picture = _picture(tokens[place + 1]) if each.type == "paragraph_open" else None
        if skipped:
            skipped -= 1
        elif picture is not None:
            address = str(picture.attrs["src"])
            alt = picture.content
            yield _html(figure(svg(figures[address], alt)) if address in figures else "")
            skipped = 2
        else:
            yield each


def _picture(inline: "Token") -> "Token | None":
    """The picture that is all of a paragraph."""
    children = inline.children or []
    return children[0] if len(children) == 1 and children[0].type == "image" else None


def _tables(tokens: "Sequence[Token]") -> "Iterator[Token]":
    """The tokens with every table in a card of its own, and columns of words at the left."""
    classes: list[str] = []
    column = 0
    for place, each in enumerate(tokens):
        if each.type == "table_open":
            classes = _classes(tokens[place:])
            yield _html('<div class="card">')
        if each.type == "tr_open":
            column = 0
        if each.type in ("th_open", "td_open"):
            kind = cell_class(tokens[place + 1].content, classes[column])
            each.attrs = {"class": kind} if kind else {}
            column += 1
        yield each
        if each.type == "table_close":
            yield _html("</div>")


def _classes(tokens: "Sequence[Token]") -> list[str]:
    """The classes of the columns of the table that begins here."""
    rows: list[list[str]] = []
    for place, each in enumerate(tokens):
        if each.type == "table_close":
            break
        if each.type == "tr_open":
            rows.append([])
        if each.type in ("th_open", "td_open"):
            rows[-1].append(tokens[place + 1].content)
    return column_classes(rows[1:], len(rows[0]))


def _html(text: str) -> "Token":
    from markdown_it.token import Token

    return Token("html_block", "", 0, content=text)
