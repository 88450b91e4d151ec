"""The report of `drift`: where a chip leaves its float twin, and which rounding it is."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle

from markupsafe import Markup

from spikedeploy.emulation.drift_report import DriftReport
from spikedeploy.emulation.raster_emulation import SILENT
from spikedeploy.reports.page import provenance, render
from spikedeploy.reports.plots import (
    BLUE,
    LEGEND_ABOVE,
    VERMILION,
    framed_figure,
    svg,
    without_formulas,
)
from spikedeploy.reports.table import ABSENT, HeadlineNumber, Table
from spikedeploy.runtime.analysis.drift import Drift, OutputDrift

ABLATION_STEPS = {
    "clock": "layers that run on (clock free)",
    "weights": "weights rounded",
    "thresholds": "+ thresholds and biases",
    "decays": "+ decays",
    "states": "+ states, overflow: the chip",
}
_OUTPUTS = {"action": "action error", "choice": "other choices", "output": "output error"}
_MEANINGS = {
    "rate, float": "spikes for each neuron and timestep",
    "rate, chip": "spikes for each neuron and timestep",
    "differ": "part of neurons and timesteps in which the number of spikes differs",
    "lost": "neurons that spike in float and never on the chip",
    "woken": "neurons that spike on the chip and never in float",
    "saturations": "numbers that did not fit a register",
}
# head -> format of the fields
_LAYERS = {
    "layer": "{name}",
    "neurons": "{neurons:,}",
    "rate, float": "{float_rate:.4f}",
    "rate, chip": "{chip_rate:.4f}",
    "differ": "{differing:.2%}",
    "distance": "{distance:.4f}",
    "lost": "{lost}",
    "woken": "{woken}",
    "saturations": "{saturations:,}",
    "first difference": "{place}",
}
_READOUTS = {
    "readout": "{name}",
    "neurons": "{neurons:,}",
    "error, rms": "{rms:.4g}",
    "range, float": "{range:.4g}",
    "register": "{register}",
    "saturations": "{saturations:,}",
}
_COLOURS = (VERMILION, "#E69F00", BLUE, "#009E73", "#CC79A7", "#8A939E")
_MARKERS = "osvD^P"


def print_drift(report: DriftReport) -> None:
    """Print the tables."""
    for table in drift_tables(report):
        table.print()


def drift_page(report: DriftReport) -> str:
    """The page as one file."""
    drift = report.drift
    first, *shown = drift_tables(report)
    drawings = {"Layers": _rates(drift)} if drift.layers else {}
    if drift.layers and drift.ablation:
        drawings["Which rounding costs what"] = _ablation(drift)
    return render(
        "drift",
        title=f"{report.policy} on {drift.chip}, against its float twin",
        lead=f"The first spike that differs: {drift.first.describe()}."
        if drift.first
        else "Every spike of the chip is equal to that of the float twin.",
        numbers=list(_numbers(drift)),
        tables=[replace(table, meanings=_MEANINGS) for table in shown],
        drawings=drawings,
        findings=drift.findings,
        measured=[*first.rows, *provenance()],
    )


# tables


def drift_tables(report: DriftReport) -> Iterator[Table]:
    """Summary, layers, the contribution of each rounding, and dead or saturated layers."""
    drift = report.drift
    title = f"Drift of {report.policy} on {drift.chip}"
    yield Table(("what", "found"), _summary(report), title)
    place = "inference {}, timestep {}, neuron {}"
    layers = [
        {**vars(each), "place": place.format(*each.first) if each.first else ABSENT}
        for each in drift.layers
    ]
    yield Table.from_formats(_LAYERS, layers, "Layers")
    if drift.readouts:
        readouts = [
            {
                **vars(each),
                "register": ABSENT if each.filled is None else f"{each.filled:.1%} filled",
            }
            for each in drift.readouts
        ]
        yield Table.from_formats(_READOUTS, readouts, "Readouts")
    if drift.ablation:
        names = [layer.name for layer in drift.layers]
        rows = [
            (
                ABLATION_STEPS[step.name],
                *(f"{step.distance[name]:.4f}" for name in names),
                _error(step.output),
            )
            for step in drift.ablation
        ]
        heads = ("rounding", *names, _OUTPUTS[drift.output.kind])
        yield Table(heads, rows, "Which rounding costs what")
    if drift.findings:
        findings = [(f.layer, f.health, f.cause, f.detail) for f in drift.findings]
        yield Table(("layer", "is", "cause", "detail"), findings, "Dead and saturated layers")


def _summary(report: DriftReport) -> list[tuple[str, str]]:
    drift = report.drift
    is_silent = not any(layer.float_rate or layer.chip_rate for layer in drift.layers)
    return [
        ("convention", report.convention.describe()),
        ("quantisation", drift.quantisation),
        ("inputs", report.inputs),
        ("inferences that differ", f"{drift.diverged} of {drift.inferences}"),
        (
            "first difference",
            drift.first.describe() if drift.first else "nowhere: every spike is equal",
        ),
        *(("remark", remark) for remark in drift.remarks),
        *([("remark", SILENT)] if is_silent else []),
        (_OUTPUTS[drift.output.kind], _error(drift.output)),
        *_fullest_register(drift),
        ("distance", f"van Rossum, {drift.tau:g} timesteps; a spike more or less is 0.5"),
    ]


def _fullest_register(drift: Drift) -> list[tuple[str, str]]:
    filled = [(each.filled, each.name) for each in drift.layers if each.filled]
    filled += [(each.filled, each.name) for each in drift.readouts if each.filled]
    return [("fullest register", "{:.1%}, in {!r}".format(*max(filled)))] if filled else []


def _error(output: OutputDrift) -> str:
    if output.kind == "choice":
        return f"{output.rms:.1%}"
    return f"{output.rms:.4f} rms, {output.largest:.4f} at most"


# numbers and drawings of the page


def _numbers(drift: Drift) -> Iterator[HeadlineNumber]:
    output = drift.output
    kind = _OUTPUTS[output.kind]
    if output.kind == "choice":
        yield HeadlineNumber(kind, f"{output.rms:.1%}", ("of all inferences",))
    else:
        largest = (f"{output.largest:.3g} at most",)
        yield HeadlineNumber(f"{kind}, root mean square", f"{output.rms:.3g}", largest)
    share = drift.diverged / drift.inferences
    counts = f"{drift.diverged:,} of {drift.inferences:,}, timesteps in each: {drift.timesteps}"
    yield HeadlineNumber("inferences with a spike that differs", f"{share:.0%}", (counts,))
    if drift.layers:
        worst = max(drift.layers, key=lambda layer: layer.differing)
        beside = (f"{worst.name}: of neurons and timesteps", f"distance {worst.distance:.3g}")
        title = "spikes that differ, worst layer"
        yield HeadlineNumber(title, f"{worst.differing:.2%}", beside)


def _rates(drift: Drift) -> Markup:
    """Spike rates of the layers in float and on the chip, a line for each layer."""
    layers = drift.layers
    figure, axes = framed_figure(1.1 + 0.42 * len(layers))
    rates = [(layer.float_rate, layer.chip_rate) for layer in layers]
    axes.hlines(range(len(layers)), *zip(*map(sorted, rates), strict=True), color="#8A939E")
    for place, (colour, label) in enumerate(((BLUE, "float twin"), (VERMILION, drift.chip))):
        values = [pair[place] for pair in rates]
        look = {"markersize": 10, "fillstyle": "none"} if place == 0 else {"markersize": 6}
        axes.plot(values, range(len(layers)), "os"[place], color=colour, label=label, **look)
    axes.set_yticks(range(len(layers)), [without_formulas(layer.name) for layer in layers])
    axes.set_ylim(len(layers) - 0.5, -0.5)
    axes.set_xlim(0, 1.08 * max(max(pair) for pair in rates) or 1)
    axes.set_xlabel("spikes for each neuron and timestep")
    axes.legend(**LEGEND_ABOVE, ncols=4)
    return svg(figure, "Spike rates of the layers, of the float twin and on the chip")


def _ablation(drift: Drift) -> Markup:
    """Distance from the float twin after each kind of rounding, a line for each layer."""
    figure, axes = framed_figure(3.2)
    steps = range(len(drift.ablation))
    for layer, colour, marker in zip(drift.layers, cycle(_COLOURS), cycle(_MARKERS), strict=False):
        distances = [step.distance[layer.name] for step in drift.ablation]
        label = without_formulas(layer.name)
        axes.plot(steps, distances, color=colour, marker=marker, label=label)
    axes.set_xticks(steps, [_in_lines(ABLATION_STEPS[step.name]) for step in drift.ablation])
    axes.set_ylim(bottom=0)
    axes.set_ylabel("distance of the spikes")
    axes.legend(**LEGEND_ABOVE, ncols=4)
    return svg(figure, "Distance from the float twin after each kind of rounding")


def _in_lines(text: str) -> str:
    return text.replace(": ", ":\n").replace(" and ", "\nand ").replace(", ", ",\n")
