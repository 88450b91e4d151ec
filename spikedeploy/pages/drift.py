"""The page of a drift: where a chip leaves its float twin, and which rounding it is."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from spikedeploy.emulation.drift import DriftReport
from spikedeploy.pages.page import big_numbers, facts, figure, folded, heading, page, said, table
from spikedeploy.pages.svg import svg
from spikedeploy.pages.written import made_by
from spikedeploy.reports.drift_tables import ABLATION_STEPS, Table, output_name, tables
from spikedeploy.reports.headline import HeadlineNumber
from spikedeploy.reports.plots import BLUE, VERMILION, plain
from spikedeploy.runtime.analysis.drift import Drift

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = (VERMILION, "#E69F00", BLUE, "#009E73", "#CC79A7", "#8A939E")
_MARKERS = "osvD^P"
_MEANINGS = {
    "rate, float": "spikes for each neuron and timestep",
    "rate, chip": "spikes for each neuron and timestep",
    "differ": "part of neurons and timesteps in which the number of spikes differs",
    "lost": "neurons that spike in float and never on the chip",
    "woken": "neurons that spike on the chip and never in float",
    "saturations": "numbers that did not fit a register",
}


def drift_page(report: DriftReport) -> str:
    """The page as one file."""
    drift = report.drift
    (_, _, summary), *shown = tables(report)
    measured = [(name, found) for name, found in summary]
    return page(
        f"{report.policy} on {drift.chip}, against its float twin",
        _lead(drift),
        [
            big_numbers(_numbers(drift)),
            *_sections(drift, shown),
            folded("How this was measured", facts([*measured, *made_by()])),
        ],
    )


def _lead(drift: Drift) -> str:
    if drift.first is None:
        return "Every spike of the chip is equal to that of the float twin."
    return f"The first spike that differs: {drift.first.describe()}."


def _numbers(drift: Drift) -> Iterator[HeadlineNumber]:
    kind = output_name(drift.output)
    if drift.output.kind == "choice":
        yield HeadlineNumber(kind, f"{drift.output.rms:.1%}", ("of all inferences",))
    else:
        yield HeadlineNumber(
            f"{kind}, root mean square",
            f"{drift.output.rms:.3g}",
            (f"{drift.output.largest:.3g} at most",),
        )
    share = drift.diverged / drift.inferences
    yield HeadlineNumber(
        "inferences with a spike that differs", f"{share:.0%}",
        (f"{drift.diverged:,} of {drift.inferences:,}, timesteps in each: {drift.timesteps}",),
    )  # fmt: skip
    if drift.layers:
        worst = max(drift.layers, key=lambda layer: layer.differing)
        yield HeadlineNumber(
            "spikes that differ, worst layer", f"{worst.differing:.2%}",
            (f"{worst.name}: of neurons and timesteps", f"distance {worst.distance:.3g}"),
        )  # fmt: skip


def _sections(drift: Drift, shown: list[Table]) -> Iterator[str]:
    """The tables, each after its drawing; readouts and findings only where there are any."""
    drawn = {"Layers": _rates, "Which rounding costs what": _ablation}
    for title, heads, rows in shown:
        yield heading(title)
        if title in drawn and drift.layers:
            yield figure(drawn[title](drift))
        yield table([(head, _MEANINGS.get(head, "")) for head in heads], rows)
    if not drift.findings:
        yield said("No layer is dead or saturated on the chip.")


def _rates(drift: Drift) -> str:
    from matplotlib.figure import Figure

    layers = drift.layers
    drawing = Figure(figsize=(8, 1.1 + 0.42 * len(layers)))
    axes = drawing.add_subplot()
    rates = [(layer.float_rate, layer.chip_rate) for layer in layers]
    axes.hlines(range(len(layers)), *zip(*map(sorted, rates), strict=True), color="#8A939E")
    for place, (colour, label) in enumerate(((BLUE, "float twin"), (VERMILION, drift.chip))):
        values = [pair[place] for pair in rates]
        look = {"markersize": 10, "fillstyle": "none"} if place == 0 else {"markersize": 6}
        axes.plot(values, range(len(layers)), "os"[place], color=colour, label=label, **look)
    axes.set_yticks(range(len(layers)), [plain(layer.name) for layer in layers])
    axes.set_ylim(len(layers) - 0.5, -0.5)
    axes.set_xlim(0, 1.08 * max(max(pair) for pair in rates) or 1)
    axes.set_xlabel("spikes for each neuron and timestep")
    return _finished(drawing, axes, "Spike rates of the layers, of the float twin and on the chip")


def _ablation(drift: Drift) -> str:
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(8, 3.2))
    axes = drawing.add_subplot()
    steps = range(len(drift.ablation))
    for place, layer in enumerate(drift.layers):
        distances = [step.distance[layer.name] for step in drift.ablation]
        look = _COLOURS[place % len(_COLOURS)], _MARKERS[place % len(_MARKERS)]
        axes.plot(steps, distances, color=look[0], marker=look[1], label=plain(layer.name))
    axes.set_xticks(steps, [_two_lines(ABLATION_STEPS[step.name]) for step in drift.ablation])
    axes.set_ylim(bottom=0)
    axes.set_ylabel("distance of the spikes")
    return _finished(drawing, axes, "Distance from the float twin after each kind of rounding")


def _two_lines(text: str) -> str:
    return text.replace(": ", ":\n").replace(" and ", "\nand ").replace(", ", ",\n")


def _finished(drawing: "Figure", axes: "Axes", alt: str) -> str:
    """The drawing with a light frame and its legend above."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#E6E8EB")
    axes.set_axisbelow(True)
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4, frameon=False)
    return svg(drawing, alt)
