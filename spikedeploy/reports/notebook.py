"""HTML that notebooks show for networks, runs and comparisons."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def card(title: str, facts: Mapping[str, str]) -> str:
    """A title, and names with values."""
    rows = "".join(f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in facts.items())
    return f"<b>{escape(title)}</b><table>{rows}</table>"


def table(cells: Sequence[Sequence[str]], text: str) -> str:
    """Heads, then rows, and a text below them."""
    head, *rows = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in cells)
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    shown = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f"{shown}<p>{escape(text)}</p>"


def picture(figure: "Figure") -> str:
    """A figure of matplotlib as a PNG in the page."""
    memory = BytesIO()
    figure.savefig(memory, format="png", dpi=80, bbox_inches="tight")
    return f'<img src="data:image/png;base64,{b64encode(memory.getvalue()).decode()}">'
