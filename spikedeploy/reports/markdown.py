"""Tables in Markdown."""

import re
from collections.abc import Sequence


def markdown_name(name: str) -> str:
    """A name that somebody else chose, shown as it is: no markup, no end of a cell or line."""
    return re.sub(r"([\\`*_\[\]<>|#])", r"\\\1", " ".join(name.split()))


def markdown_table(lines: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table whose first line is its head."""
    rows = [lines[0], ["---"] * len(lines[0]), *lines[1:]]
    return [f"| {' | '.join(row)} |" for row in rows]


def markdown_text(lines: Sequence[Sequence[str]]) -> str:
    """The same in one text."""
    return "\n".join(markdown_table(lines))
