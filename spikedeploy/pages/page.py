"""A page as one HTML file that needs nothing else, and what stands on it.

Words are escaped here; what takes `html` takes the output of these functions.
"""

import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from string import Template

from spikedeploy.reports.cells import ABSENT
from spikedeploy.reports.headline import HeadlineNumber

# a head, or a head and what its cells mean
Head = str | tuple[str, str]
_LONG = 44  # letters that do not break
_NUMBER = re.compile(r"[-−+±≥≤<>≈*\[( ]*\d")


def page(title: str, lead: str, html: Iterable[str], scripts: str = "", reload: int = 0) -> str:
    """The file.

    lead     sentence below the title; may be empty
    html     its parts, in their order
    scripts  elements at its end
    reload   [s] until a browser reads the file again; 0 for one that is complete
    """
    return Template(part("page.html")).substitute(
        title=escape(title),
        lead=f'<p class="meaning">{escape(lead)}</p>\n' if lead else "",
        style=part("page.css"),
        head=f'\n<meta http-equiv="refresh" content="{reload}">' if reload else "",
        body="\n".join(filter(None, html)),
        scripts=scripts,
    )


def part(name: str) -> str:
    """A template, style or script of the pages."""
    return files("spikedeploy.pages").joinpath(name).read_text(encoding="utf-8")


def big_numbers(numbers: Iterable[HeadlineNumber]) -> str:
    """The numbers that a page leads with; each thing beside one has a line of its own."""
    cells = (
        f'<div><dt>{escape(each.title)}</dt><dd class="big">{escape(each.number)}</dd>'
        + "".join(f'<dd class="beside">{escape(part)}</dd>' for part in each.beside)
        + "</div>"
        for each in numbers
    )
    return f'<dl class="figures">{"".join(cells)}</dl>'


def heading(text: str) -> str:
    """The head of what follows."""
    return f"<h2>{escape(text)}</h2>"


def table(heads: Sequence[Head], rows: Sequence[Sequence[str]], kinds: Iterable[str] = ()) -> str:
    """A table that scrolls by itself where the screen is narrow; numbers stand at the right.

    kinds  CSS class of each row
    """
    named = [head if isinstance(head, tuple) else (head, "") for head in heads]
    classes = column_classes(rows, len(named))
    top = "".join(
        f"<th{_attribute('class', kind)}{_attribute('title', meaning)}>{escape(title)}</th>"
        for kind, (title, meaning) in zip(classes, named, strict=True)
    )
    marks = iter(kinds)
    body = "".join(
        f"<tr{_attribute('class', next(marks, ''))}>{_cells(row, classes)}</tr>" for row in rows
    )
    return (
        f'<div class="card"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def column_classes(rows: Sequence[Sequence[str]], count: int) -> list[str]:
    """`words` for each column of words, which stand at the left; `` for one of numbers."""
    columns = [[row[place] for row in rows if place < len(row)] for place in range(count)]
    return ["words" if place == 0 or _words(column) else "" for place, column in enumerate(columns)]


def cell_class(text: str, column: str) -> str:
    """The class of a cell in a column of that class; `text` breaks its lines."""
    return "text" if len(text) > _LONG else column


def _words(cells: Sequence[str]) -> bool:
    """Whether most cells that say anything are no numbers."""
    told = [cell for cell in cells if cell not in ("", ABSENT)]
    return sum(_NUMBER.match(cell) is not None for cell in told) * 2 < len(told)


def _cells(row: Sequence[str], classes: Sequence[str]) -> str:
    return "".join(
        f"<td{_attribute('class', cell_class(cell, column))}>{escape(cell)}</td>"
        for cell, column in zip(row, classes, strict=True)
    )


def _attribute(name: str, value: str) -> str:
    return f' {name}="{escape(value)}"' if value else ""


def folded(title: str, html: str) -> str:
    """What a line opens."""
    return f"<details><summary>{escape(title)}</summary>{html}</details>"


def facts(items: Iterable[tuple[str, str]]) -> str:
    """Names and what is said of them."""
    pairs = (f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in items)
    return f'<dl class="facts">{"".join(pairs)}</dl>'


def figure(html: str, caption: str = "") -> str:
    """A drawing, an SVG with an alternative text; empty without one."""
    said = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure>{html}{said}</figure>" if html else ""


def said(*sentences: str) -> str:
    """Paragraphs; empty ones are left out."""
    return "".join(f'<p class="more">{escape(each)}</p>' for each in sentences if each)


def hint(text: str) -> str:
    """A remark in small letters; empty without one."""
    return f'<p class="hint">{escape(text)}</p>' if text else ""


def commands(lines: Iterable[tuple[str, str]]) -> str:
    """Command lines, each with what it does."""
    pairs = (
        f"<dt>{escape(meaning)}</dt><dd><code>{escape(line)}</code></dd>" for line, meaning in lines
    )
    return f'<div class="card"><dl class="facts next">{"".join(pairs)}</dl></div>'
