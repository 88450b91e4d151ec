"""Figures of matplotlib as SVG in the colours of the page, light or dark."""

import re
from collections.abc import Sequence
from html import escape
from io import StringIO
from typing import TYPE_CHECKING

from spikedeploy.pages.page import part
from spikedeploy.reports.cells import Row
from spikedeploy.reports.plots import energy_figure, returns_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH = re.compile(r'viewBox="0 0 ([\d.]+) ')  # [pt]
# colours of the plots -> those of page.css
_COLOURS = {
    "#0072b2": "var(--ann)",
    "#94469b": "var(--snn)",
    "#e69f00": "var(--snn)",
    "#d55e00": "var(--chip)",
    "#7b848e": "var(--control)",
    "#8a939e": "var(--control)",
    "#009e73": "var(--green)",
    "#cc79a7": "var(--pink)",
    "#56b4e9": "var(--sky)",
    "#f0e442": "var(--yellow)",
    "#e6e8eb": "var(--line)",
    "#000000": "var(--ink)",
    "#222222": "var(--ink)",
    "#333333": "var(--ink)",
    "#555555": "var(--soft)",
}


def returns_svg(rows: Sequence[Row]) -> str:
    """Returns of all episodes, means and any intervals."""
    return svg(
        returns_figure(rows), "Return of each episode, mean and any 95% interval of each row"
    )


def energy_svg(rows: Sequence[Row]) -> str:
    """Joules per inference by each table; empty where none prices a row."""
    if not any(row["energy_per_inference_j"] for row in rows):
        return ""
    return svg(energy_figure(rows), "Energy of an inference by each table, on a logarithmic axis")


def standalone(drawn: str) -> str:
    """An SVG of `svg` as a file of its own, light or dark as its reader is."""
    colours = part("page.css").partition("* {")[0]
    head, _, rest = drawn.partition(">")
    own = "svg { background: var(--card); } text { fill: var(--ink); }"
    return f"{head}><style>{colours}{own}</style>{rest}"


def svg(figure: "Figure", alt: str) -> str:
    """A figure with its alternative text."""
    from matplotlib import rc_context

    text = StringIO()
    # text as text; ids that do not differ from call to call
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": alt}):
        figure.savefig(
            text, format="svg", bbox_inches="tight", transparent=True, metadata={"Date": None}
        )
    drawn = text.getvalue()
    drawn = drawn[drawn.index("<svg") :]
    for colour, name in _COLOURS.items():
        drawn = drawn.replace(colour, name)
    width = float(_WIDTH.search(drawn)[1])  # type: ignore[index]  # matplotlib writes it
    head = f'<svg role="img" aria-label="{escape(alt)}" style="--wide: {width:.0f}px"'
    return drawn.replace("<svg", head, 1)
