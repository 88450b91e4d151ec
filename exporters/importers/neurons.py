"""A layer of neurons with the gains of an importer, and the weights before it.

s = gain of the tool / gain leaves all weights as they are; only where a tool wants one threshold
for all neurons of a layer, and they differ, weights are scaled. A constant `leak` of a LIF or IF
moves into the bias before it. A threshold that is to be exceeded becomes the next float32, for
tools where neurons spike when they reach it, and the other way round.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.presets.preset import is_uniform, with_parameters
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.graph.neurons import DiscreteNeuron, discretise

Array = NDArray[np.float64]

ROUNDED = 1e-9  # relative difference of numbers that only rounding distinguishes
_WEIGHTS = (nir.Affine, nir.Linear, nir.Conv1d, nir.Conv2d)


@dataclass(frozen=True)
class Importer:
    """What the import of a tool leaves no choice in.

    name: of its preset, which holds how it reads a file.
    uniform: whether all neurons of a layer have one threshold.
    resets: that it can be told to use; the first is its default.
    v_reset: whether it reads v_reset; else membranes are reset to 0.
    """

    name: str
    uniform: bool = True
    resets: tuple[str, ...] = ("zero",)
    v_reset: bool = False


def refusal(tool: Importer, reason: str) -> ConventionError:
    """What a tool cannot express."""
    return ConventionError(
        f"--for {tool.name}: {reason}. Without --for the network is written as it is."
    )


@dataclass(frozen=True, eq=False)
class _Layer:
    """Neurons of one node, and what becomes of them.

    name, kind: of the node.
    neuron: its difference equation.
    tool: that is to read it.
    gain: (*N) that the tool multiplies the input by.
    scale: (*N) s.
    """

    name: str
    kind: type[nir.NIRNode]
    neuron: DiscreteNeuron
    tool: Importer
    gain: Array
    scale: Array


def rewrite(
    name: str,
    nodes: dict[str, nir.NIRNode],
    edges: list[tuple[str, str]],
    own: Convention,
    theirs: Convention,
    tool: Importer,
) -> None:
    """Put the tool's neurons in the place of ours, and scale the weights before them.

    own, theirs: convention of the nodes, and of the tool.
    """
    layer = _layer(name, nodes[name], own, tool)
    v_leak, rest = _leak(layer)
    nodes[name] = _node(layer, own, theirs, v_leak)
    factor, offset = layer.scale * layer.neuron.gain / layer.gain, rest / layer.gain
    if np.abs(factor - 1).max() > ROUNDED or offset.any():
        for source in _sources(name, nodes, edges, tool):
            nodes[source] = _scaled_weights(source, nodes[source], factor, offset, tool)
            offset = np.zeros_like(offset)  # of several sources the first adds it


def _layer(name: str, node: nir.NIRNode, own: Convention, tool: Importer) -> _Layer:
    neuron, kind = discretise(name, node, own), type(node)
    gain = _gain(kind, neuron, tool)
    if not ((neuron.gain > 0) & (gain > 0)).all():
        raise refusal(tool, f"node {name!r}: its gains must be above 0")
    if neuron.v_reset.any() and not tool.v_reset:
        raise refusal(tool, f"node {name!r}: v_reset is not 0, to which it resets membranes")
    return _Layer(name, kind, neuron, tool, gain, _scale(neuron, gain, tool.uniform))


def _gain(kind: type[nir.NIRNode], neuron: DiscreteNeuron, tool: Importer) -> Array:
    """What the tool multiplies a neuron's input by."""
    if tool.name == "norse" and kind is nir.LIF:
        return 1 - neuron.membrane_decay  # r = 1, which is all that it knows
    if tool.name == "rockpool" and neuron.current_decay is not None:
        return neuron.current_decay  # I = a (I + x)
    return np.ones_like(neuron.gain)


def _scale(neuron: DiscreteNeuron, gain: Array, uniform: bool) -> Array:
    """The scale s of each neuron: one that keeps the weights, or else one threshold for all."""
    scale, threshold = np.asarray(gain / neuron.gain), _threshold_of(neuron)
    if not uniform or is_uniform(scale * threshold):
        return scale
    first = scale.flat[0] * threshold.flat[0]
    if np.allclose(scale * threshold, first, rtol=ROUNDED, atol=0):
        return np.full_like(scale, scale.flat[0]) if is_uniform(threshold) else first / threshold
    return np.asarray(threshold.flat[0] / threshold)


def _threshold_of(neuron: DiscreteNeuron) -> Array:
    if neuron.threshold is None:
        raise TypeError("neurons that do not spike have no threshold")
    return neuron.threshold


def _leak(layer: _Layer) -> tuple[Array, Array]:
    """v_leak of the tool's node, and what a bias has to add to the membrane beside it."""
    neuron, scale = layer.neuron, layer.scale
    leak, complement = neuron.leak * scale, 1 - neuron.membrane_decay
    # SpikingJelly's LIF leaks to v_reset; Norse's starts at v_leak, and ours at 0
    at_rest = neuron.v_reset * scale if layer.kind is nir.LIF else np.zeros_like(leak)
    rest = leak - complement * at_rest
    rest = np.where(np.abs(rest) <= ROUNDED * np.abs(scale * _threshold_of(neuron)), 0.0, rest)
    if rest.any() and layer.kind is nir.CubaLIF:
        reason = "nothing adds v_leak to the membrane behind a synaptic current"
        raise refusal(layer.tool, f"node {layer.name!r}: {reason}")
    return at_rest, rest


def _node(layer: _Layer, own: Convention, theirs: Convention, v_leak: Array) -> nir.NIRNode:
    """The neurons with the tool's dt and gains."""
    threshold = _reached(_threshold_of(layer.neuron) * layer.scale, own, theirs)
    ends = {"v_threshold": threshold, "v_reset": layer.neuron.v_reset * layer.scale}
    if layer.kind is nir.IF:
        return nir.IF(r=np.full(threshold.shape, 1 / theirs.dt), **ends)
    tau = _tau(layer.neuron.membrane_decay, theirs)
    if layer.kind is nir.LIF:
        r = np.ones_like(tau) if layer.tool.name == "norse" else tau / theirs.dt
        return nir.LIF(tau=tau, r=r, v_leak=v_leak, **ends)
    if layer.neuron.current_decay is None:
        raise TypeError("a CubaLIF has a current")
    tau_syn = _tau(layer.neuron.current_decay, theirs)
    r, w_in = tau / theirs.dt, tau_syn / theirs.dt
    if layer.tool.name == "rockpool":
        a, b = layer.neuron.current_decay, layer.neuron.membrane_decay
        r = r - 1  # from which it takes dt
        w_in = a / ((1 - a) * (1 - b) * r)  # which it ignores, and we do not
    return nir.CubaLIF(tau_syn=tau_syn, tau_mem=tau, r=r, v_leak=v_leak, w_in=w_in, **ends)


def _reached(threshold: Array, own: Convention, theirs: Convention) -> Array:
    """Thresholds by the tool's rule, above or reached, in its float32."""
    if own.spikes == theirs.spikes:
        return threshold
    single, up = threshold.astype(np.float32), theirs.spikes == "reached"
    beyond = single > threshold if up else single < threshold
    moved = np.nextafter(single, np.float32(np.inf if up else -np.inf))
    return np.where(beyond, single, moved).astype(np.float64)


def _tau(decay: Array, theirs: Convention) -> Array:
    """Time constants [s] with these decay factors."""
    with np.errstate(divide="ignore"):
        if theirs.integrator == "exponential":
            return np.asarray(-theirs.dt / np.log(decay))
        return np.asarray(theirs.dt / (1 - decay))


def _sources(
    name: str, nodes: dict[str, nir.NIRNode], edges: list[tuple[str, str]], tool: Importer
) -> Iterator[str]:
    """Nodes with weights for this one only; refuses others."""
    for source in sorted(source for source, target in edges if target == name):
        own = [target for first, target in edges if first == source] == [name]
        if not own or not isinstance(nodes[source], _WEIGHTS):
            raise refusal(
                tool, f"node {name!r} must be scaled by its weights, and {source!r} has none for it"
            )
        yield source


def _scaled_weights(
    name: str, node: nir.NIRNode, factor: Array, offset: Array, tool: Importer
) -> nir.NIRNode:
    """The node with its output multiplied by a factor, and an offset added."""
    if not isinstance(node, (nir.Affine, nir.Linear)):
        channels = factor.reshape(len(factor), -1), offset.reshape(len(offset), -1)
        if not all(is_uniform(each) for pair in channels for each in pair):
            raise refusal(tool, f"node {name!r} has one weight for neurons that need different")
        factor, offset = (each[:, 0] for each in channels)
    weight = node.weight * factor.reshape(-1, *[1] * (node.weight.ndim - 1))
    bias = getattr(node, "bias", 0.0) * factor + offset
    if isinstance(node, nir.Linear):
        return nir.Affine(weight, bias) if offset.any() else nir.Linear(weight)
    return with_parameters(node, weight=weight, bias=bias)
