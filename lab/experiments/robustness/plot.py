"""Curves of the robustness experiment: a panel for each disturbance and fault."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lab.experiments.robustness.design import UNDISTURBED
from lab.experiments.robustness.tables import ENOUGH, Record, policies
from spikedeploy.reports.plots import BLUE, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 5
_FLOATS = (BLUE, "#56B4E9", "#009E73", "#8A939E", "#000000")  # Okabe and Ito 2008
_SPIKING = (VERMILION, "#E69F00", "#CC79A7", "#F0E442")
_MARKERS = "os^Dv"


def levels_figure(rows: Sequence[Record]) -> "Figure":
    """% of the undisturbed return against the level."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row["name"] for row in rows if row["part"] != UNDISTURBED))
    lines = max(1, -(-len(names) // _COLUMNS))
    figure = Figure(figsize=(12, 2.3 * lines + 0.6), layout="constrained")
    panels = figure.subplots(lines, _COLUMNS, sharex=True, sharey=True, squeeze=False).flat
    looks = _looks(rows)
    for name, axes in zip(names, panels, strict=False):
        _panel(axes, name, [row for row in rows if row["name"] == name], looks)
    for axes in list(panels):
        axes.axis("off")
    handles = [
        figure.axes[0].plot([], [], color=colour, marker=marker, label=policy)[0]
        for policy, (colour, marker) in looks.items()
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, frameon=False)
    figure.supxlabel("level")
    figure.supylabel("% of the undisturbed return")
    return figure


def _looks(rows: Sequence[Record]) -> dict[str, tuple[str, str]]:
    """Policy -> colour and marker: warm colours spike."""
    kinds = {row["policy"]: row["kind"] for row in rows}
    found, counts = {}, {True: 0, False: 0}
    for place, policy in enumerate(policies(rows)):
        spikes = kinds[policy] == "snn"
        colours = _SPIKING if spikes else _FLOATS
        found[policy] = colours[counts[spikes] % len(colours)], _MARKERS[place % len(_MARKERS)]
        counts[spikes] += 1
    return found


def _panel(
    axes: "Axes", name: str, rows: Sequence[Record], looks: dict[str, tuple[str, str]]
) -> None:
    axes.set_title(name, fontsize=9)
    for policy, (colour, marker) in looks.items():
        of = [row for row in rows if row["policy"] == policy and row.get("kept") is not None]
        if not of:
            continue
        kept = [100.0, *(100 * row["kept"] for row in of)]
        # a bootstrap of few episodes may leave its own mean outside by rounding
        low = [0.0, *(max(0.0, 100 * (row["kept"] - row["kept_low"])) for row in of)]
        high = [0.0, *(max(0.0, 100 * (row["kept_high"] - row["kept"])) for row in of)]
        axes.errorbar(
            [0, *(row["level"] for row in of)], kept, (low, high), color=colour, marker=marker,
            markersize=4, linewidth=1.2, capsize=2,
        )  # fmt: skip
    axes.axhline(100 * ENOUGH, color="#8A939E", linewidth=0.8, linestyle=":")
    axes.set_ylim(0, 115)
    axes.set_xticks(range(4))
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#E6E8EB")
    axes.set_axisbelow(True)
