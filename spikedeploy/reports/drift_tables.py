"""The tables of a drift, for terminal and Markdown alike."""

from collections.abc import Iterator, Sequence
from typing import TypeAlias

from spikedeploy.emulation.drift import DriftReport
from spikedeploy.emulation.open_loop import SILENT
from spikedeploy.reports.markdown import markdown_table
from spikedeploy.runtime.analysis.drift import Drift, OutputDrift

# title, heads, rows
Table: TypeAlias = tuple[str, Sequence[str], Sequence[Sequence[str]]]

ABLATION_STEPS = {
    "clock": "layers that run on (clock free)",
    "weights": "weights rounded",
    "thresholds": "+ thresholds and biases",
    "decays": "+ decays",
    "states": "+ states, overflow: the chip",
}


def tables(report: DriftReport) -> Iterator[Table]:
    """Summary, layers, the contribution of each rounding, and dead or saturated layers."""
    drift = report.drift
    yield f"Drift of {report.policy} on {drift.chip}", ("what", "found"), _summary(report)
    yield "Layers", _LAYER_HEADS, _layers(drift)
    if drift.readouts:
        yield "Readouts", _READOUT_HEADS, _readouts(drift)
    if drift.ablation:
        yield (
            "Which rounding costs what",
            ("rounding", *_names(drift), output_name(drift.output)),
            [
                (
                    ABLATION_STEPS[step.name],
                    *(f"{step.distance[name]:.4f}" for name in _names(drift)),
                    _size(step.output),
                )
                for step in drift.ablation
            ],
        )
    if drift.findings:
        rows = [(f.layer, f.health, f.cause, f.detail) for f in drift.findings]
        yield "Dead and saturated layers", ("layer", "is", "cause", "detail"), rows


_LAYER_HEADS = (
    "layer",
    "neurons",
    "rate, float",
    "rate, chip",
    "differ",
    "distance",
    "lost",
    "woken",
    "saturations",
    "first difference",
)


_READOUT_HEADS = ("readout", "neurons", "error, rms", "range, float", "register", "saturations")


def _readouts(drift: Drift) -> list[tuple[str, ...]]:
    return [
        (
            each.name,
            f"{each.neurons:,}",
            f"{each.rms:.4g}",
            f"{each.range:.4g}",
            "–" if each.filled is None else f"{each.filled:.1%} filled",
            f"{each.saturations:,}",
        )
        for each in drift.readouts
    ]


def markdown(report: DriftReport) -> str:
    """The tables as Markdown."""
    parts = []
    for title, heads, rows in tables(report):
        table = "\n".join(markdown_table([heads, *rows]))
        parts.append(f"## {title}\n\n{table}\n")
    return "\n".join(parts)


def _summary(report: DriftReport) -> list[tuple[str, str]]:
    drift = report.drift
    where = drift.first.describe() if drift.first else "nowhere: every spike is equal"
    return [
        ("convention", report.convention.describe()),
        ("quantisation", drift.quantisation),
        *([("calibrated on", report.calibrated)] if report.calibrated else []),
        ("inputs", report.inputs),
        ("inferences that differ", f"{drift.diverged} of {drift.inferences}"),
        ("first difference", where),
        *([("remark", SILENT)] if _silent(drift) else []),
        (output_name(drift.output), _size(drift.output)),
        *_fullest(drift),
        ("distance", f"van Rossum, {drift.tau:g} timesteps; a spike more or less is 0.5"),
    ]


def _silent(drift: Drift) -> bool:
    """Whether no layer spikes, in float and on the chip."""
    return not any(layer.float_rate or layer.chip_rate for layer in drift.layers)


def _fullest(drift: Drift) -> list[tuple[str, str]]:
    """The layer whose registers are filled most."""
    filled = [(each.filled, each.name) for each in drift.layers if each.filled]
    filled += [(each.filled, each.name) for each in drift.readouts if each.filled]
    return [("fullest register", "{:.1%}, in {!r}".format(*max(filled)))] if filled else []


def _layers(drift: Drift) -> list[tuple[str, ...]]:
    return [
        (
            layer.name,
            f"{layer.neurons:,}",
            f"{layer.float_rate:.4f}",
            f"{layer.chip_rate:.4f}",
            f"{layer.differing:.2%}",
            f"{layer.distance:.4f}",
            str(layer.lost),
            str(layer.woken),
            f"{layer.saturations:,}",
            _place(layer.first),
        )
        for layer in drift.layers
    ]


def _place(first: tuple[int, int, int] | None) -> str:
    return "–" if first is None else "inference {}, timestep {}, neuron {}".format(*first)


def _names(drift: Drift) -> list[str]:
    return [layer.name for layer in drift.layers]


def output_name(output: OutputDrift) -> str:
    """What is said of the outputs: action error, other choices, output error."""
    return {"action": "action error", "choice": "other choices", "output": "output error"}[
        output.kind
    ]


def _size(output: OutputDrift) -> str:
    if output.kind == "choice":
        return f"{output.rms:.1%}"
    return f"{output.rms:.4f} rms, {output.largest:.4f} at most"
