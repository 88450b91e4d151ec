"""Tables in Markdown."""

from collections.abc import Sequence


def markdown_table(lines: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table whose first line is its head."""
    rows = [lines[0], ["---"] * len(lines[0]), *lines[1:]]
    return [f"| {' | '.join(row)} |" for row in rows]


def markdown_text(lines: Sequence[Sequence[str]]) -> str:
    """The same in one text."""
    return "\n".join(markdown_table(lines))
