"""Design rules on single nodes: their kind, the parameters of neurons, kernels and weights."""

from collections.abc import Iterator, Sequence

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.chip import READOUTS
from spikedeploy.runtime.design_rules.rule import (
    PlacedNetwork,
    RuleResult,
    Status,
    allowed,
    at_most,
)
from spikedeploy.runtime.graph.neurons import SPIKING
from spikedeploy.runtime.graph.order import delay_timesteps
from spikedeploy.runtime.graph.shapes import CONVOLUTIONS, DENSE, convolution_window

Floats = NDArray[np.float64]

# a decay or mantissa that is a limit itself may come out a last bit beyond it
_HAIR = 1e-9
# of the smallest mantissa: what is no more becomes 0 when it is rounded
_HALF = 0.5


def primitive(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Each node is of a kind that the chip has; what the host computes may be any."""
    for name, node in sorted(design.graph.nodes.items()):
        kind = type(node).__name__
        if name in design.network.host:
            yield RuleResult("primitive", name, "pass", kind, note="computed by the host")
        else:
            remedy = "Replace the node, or run the network in float."
            possible: tuple[str, ...] = design.limits.primitives
            spikes = name in design.artifact.sigma_delta
            if kind in READOUTS and not spikes and design.network.leaving(name):
                kind = f"{kind} before neurons"
                possible = tuple(each for each in possible if each not in READOUTS)
            yield allowed("primitive", name, kind, possible, remedy)


def reset(design: PlacedNetwork) -> Iterator[RuleResult]:
    """A spike does to the membrane what the convention says, from 0."""
    for name, node in sorted(design.graph.nodes.items()):
        if not isinstance(node, SPIKING):
            continue
        if node.v_reset.any():
            found = f"v_reset {float(node.v_reset.flat[np.abs(node.v_reset).argmax()]):g}"
            remedy = "Shift the membrane so that it resets to 0, or run the network in float."
            yield RuleResult("reset", name, "fail", found, "v_reset 0", "", remedy)
        else:
            reset_of = design.artifact.convention.reset
            remedy = _reset_remedy(reset_of, type(node).__name__, design.chip.resets)
            if trained_for := design.artifact.trained_for:
                remedy = f"Run it on {trained_for}, in whose integers it was trained."
            found = f"reset {design.artifact.convention.reset!r}"
            possible = tuple(f"reset {each!r}" for each in design.chip.resets)
            yield allowed("reset", name, found, possible, remedy)


def _reset_remedy(reset: str, kind: str, resets: Sequence[str]) -> str:
    """What to do about a reset that a chip does not have, with neurons of this kind."""
    if reset == "zero-delayed" and kind in ("LIF", "IF"):
        return "Give --reset zero, with which these neurons spike alike."
    if reset == "subtract-delayed" and kind == "IF":
        return "Give --reset subtract, with which neurons without a leak spike alike."
    if reset in ("zero", "subtract"):
        options = " or ".join(f"--reset {each}" for each in resets)
        return f"Train with that reset, give it ({options}), or run the network in float."
    return (
        "Train with one of those (snnTorch: reset_mechanism, and reset_delay=False), or run the "
        "network in float."
    )


def graded(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Sigma-delta neurons only where neurons send graded spikes to neurons."""
    bits = design.chip.arithmetic.graded_bits
    possible = () if bits is None else ("graded spikes",)
    remedy = "Choose loihi2 or ideal, or run the network in float."
    for name in sorted(design.artifact.sigma_delta):
        yield allowed("graded", name, "graded spikes", possible, remedy)


def delay(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Delays fit into the chip's."""
    remedy = "Shorten the delay."
    for name, node in sorted(design.graph.nodes.items()):
        if isinstance(node, nir.Delay):
            steps = int(delay_timesteps(name, node, design.artifact.convention).max())
            yield at_most("delay", name, steps, design.chip.delay_max, "timesteps", remedy)


def recurrence(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Loops only where neurons can be presynaptic to themselves."""
    for population in design.network.populations:
        if not population.recurrent:
            continue
        if design.limits.recurrence is None:
            yield RuleResult("recurrence", population.name, "unknown", "a loop")
        else:
            possible = ("a loop",) if design.limits.recurrence else ()
            remedy = "Take the loop out, or run the network in float."
            yield allowed("recurrence", population.name, "a loop", possible, remedy)


def decay_range(design: PlacedNetwork) -> Iterator[RuleResult]:
    """What a current and a membrane lose in a timestep is rounded to what the registers hold."""
    for name, neuron in sorted(design.neurons.items()):
        if name in design.network.host:
            continue
        losses = {"membrane": (1 - neuron.membrane_decay, design.limits.membrane_loss)}
        if neuron.current_decay is not None:
            losses["current"] = (1 - neuron.current_decay, design.limits.current_loss)
        yield RuleResult(
            rule="decay-range",
            node=name,
            status=_within([(loss, span) for loss, span in losses.values()]),
            found="a loss of " + ", ".join(f"{s} {_span(x)}" for s, (x, _) in losses.items()),
            limit=", ".join(f"{s} {_span(np.array(y))}" for s, (_, y) in losses.items() if y)
            or None,
            unit="of 1 in a timestep",
            remedy="Choose another time constant.",
        )


def _within(losses: list[tuple[Floats, tuple[float, float] | None]]) -> Status:
    if any(span is not None and not _holds(span, loss) for loss, span in losses):
        return "fail"
    return "unknown" if any(span is None for _, span in losses) else "pass"


def _holds(span: tuple[float, float], loss: Floats) -> bool:
    """Whether each loss is at most half a step outside; next to an end the step is as it is."""
    least, most = span[0] / 2, span[1] + (1 - span[1]) / 2 * (span[1] > span[0])
    return bool(loss.min() >= least - _HAIR and loss.max() <= most + _HAIR)


def _span(values: Floats) -> str:
    least, most = float(values.min()), float(values.max())
    return f"{least:.4g}" if least == most else f"{least:.4g} to {most:.4g}"


def threshold_range(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Thresholds are whole numbers within their register when the largest weight fills its own."""
    most, widest = design.limits.threshold_max, design.limits.weight_max
    for population in filter(design.spikes, design.network.populations):
        threshold = design.graph.nodes[population.name].v_threshold
        largest = design.largest(population)
        if widest is None or most is None or not largest:
            yield RuleResult("threshold-range", population.name, "unknown")
            continue
        found = float(threshold.min()) * widest / largest
        dead = found < 0 or 0 < found <= _HALF
        yield RuleResult(
            rule="threshold-range",
            node=population.name,
            status="fail" if dead else "pass",
            found=found,
            limit=f"thresholds above {_HALF}, to {most}",
            unit="units of the smallest weight",
            remedy="Raise the threshold, or clip the weights.",
            note="thresholds above the range scale the weights down" if found > most else "",
        )


def weight_bits(design: PlacedNetwork) -> Iterator[RuleResult]:
    """The largest weight is not 0 beside the largest threshold."""
    most, widest = design.limits.threshold_max, design.limits.weight_max
    for population in filter(design.spikes, design.network.populations):
        threshold = float(design.graph.nodes[population.name].v_threshold.max())
        largest = design.largest(population)
        if widest is None or most is None or not largest:
            yield RuleResult("weight-bits", population.name, "unknown")
            continue
        found = min(float(widest), largest * most / threshold if threshold > 0 else widest)
        yield RuleResult(
            rule="weight-bits",
            node=population.name,
            status="pass" if found > _HALF else "fail",
            found=found,
            limit=f"weights above {_HALF}, to {widest}",
            unit="mantissa of the largest weight",
            remedy="Scale the weights up, or the threshold down.",
        )


def kernel(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Kernels and strides of convolutions."""
    limits = design.limits.convolutions
    for name, node in sorted(design.graph.nodes.items()):
        if limits is None or not isinstance(node, CONVOLUTIONS) or name in design.network.host:
            continue
        window = convolution_window(name, node)
        fits = max(window.kernel) <= limits.kernel and {*window.stride} <= {*limits.strides}
        yield RuleResult(
            rule="kernel",
            node=name,
            status="pass" if fits else "fail",
            found=f"a kernel of {_by(window.kernel)}, stride {_by(window.stride)}",
            limit=f"kernels to {limits.kernel}, strides {', '.join(map(str, limits.strides))}",
            remedy="Train with such a kernel.",
        )


def weight_values(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Different weights of a neuron, where a chip has a table of few."""
    remedy = "Quantise to so few weights, or double sources so that each has one more."
    limit = design.limits.weight_values
    for name, node in sorted(design.graph.nodes.items()):
        if limit is not None and isinstance(node, DENSE) and name not in design.network.host:
            rows = node.weight.reshape(-1, node.weight.shape[-1])
            found = max(len(np.unique(row[row != 0])) for row in rows)
            yield at_most("axon-types", name, found, limit, "weights of a neuron", remedy)


def axon_signs(design: PlacedNetwork) -> Iterator[RuleResult]:
    """Sources excite all that they reach, or inhibit all, where a chip keeps signs by source."""
    if not design.limits.axon_signs:
        return
    remedy = "Train with sources of one sign, or double them."
    for name in (*design.network.inputs, *(p.name for p in design.network.populations)):
        fans = [projection.fan for projection in design.network.leaving(name)]
        weights = [fan.weight for fan in fans if fan.weight is not None]
        if weights:
            up, down = (_any(weights, sign) for sign in (1, -1))
            found, unit = int((up & down).sum()), "sources with weights of both signs"
            yield at_most("sign", name, found, 0, unit, remedy)


def _any(weights: list[NDArray[np.float64]], sign: int) -> NDArray[np.bool_]:
    """(M,) whether a source has weights of this sign."""
    return np.asarray(np.any([(sign * weight > 0).any(axis=1) for weight in weights], axis=0))


def _by(extents: tuple[int, ...]) -> str:
    return " x ".join(map(str, extents))
