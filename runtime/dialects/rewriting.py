"""A network in the scaling that the import of another tool accepts; refused where there is none.

Importers fix dt and gains, and ignore or refuse what they do not expect: snnTorch 1.0.0 takes a
CubaLIF with r = tau_mem/dt at dt = 0.1 ms only, Norse ignores r of a LIF. The difference equation
(runtime.graph.discretisation) leaves a choice that they do not see. With s > 0 for each neuron,

    V' = s V,  threshold' = s threshold,  v_reset' = s v_reset,  leak' = s leak
    W' = W s gain / gain of the tool

has the same spikes, and tau' = dt'/(1 - decay) gives the same decay factors at the dt of the tool.
s = gain of the tool / gain leaves all weights as they are; only where a tool wants one threshold
for all neurons of a layer, and they differ, weights are scaled. A constant `leak` of a LIF or IF
moves into the bias before it. A threshold that is to be exceeded becomes the next float32, for
tools where neurons spike when they reach it, and the reverse.

What comes out is read as the tool would (`read_like`), and compared with the network.
"""

from collections.abc import Iterator
from dataclasses import replace

import nir
import numpy as np

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.dialect import (
    EdgeList,
    Importer,
    Nodes,
    Values,
    is_uniform,
    with_parameters,
)
from spikedeploy.runtime.dialects.reading import preset, read_like
from spikedeploy.runtime.dialects.tools import IMPORTERS
from spikedeploy.runtime.errors import ConfigError, ConventionError
from spikedeploy.runtime.graph.discretisation import SPIKING, DiscreteNeuron, discretise
from spikedeploy.runtime.graph.shapes import DENSE

_ROUNDED = 1e-9  # relative difference of numbers that only rounding distinguishes


def rewrite_for(graph: nir.NIRGraph, own: Convention, name: str) -> tuple[nir.NIRGraph, Convention]:
    """The graph and convention that a tool reads as this network; ConventionError if it cannot."""
    tool = _importer(name)
    try:
        nodes, edges, theirs = dict(graph.nodes), sorted(graph.edges), _convention(own, name)
        for each in sorted(n for n, node in nodes.items() if isinstance(node, SPIKING)):
            _rewrite(each, nodes, edges, own, theirs, tool)
            _check_decays(each, graph.nodes[each], own, nodes[each], theirs)
        nodes, edges = tool.arrange(nodes, edges)
        again = nir.NIRGraph(nodes, edges, metadata=graph.metadata, type_check=False)
        _check_as_read(again, theirs, name)
    except ConventionError as error:
        # what follows the first sentence tells what to do with a file that is read
        reason = str(error).partition(". ")[0]
        raise ConventionError(
            f"--for {name}: {reason}. Without --for the network is written as it is."
        ) from error
    return again, theirs


def arguments(convention: Convention, name: str) -> dict[str, str]:
    """Arguments that the importer needs besides the file."""
    told = convention.reset != _importer(name).resets[0]
    return {"reset": convention.reset} if told else {}


def _importer(name: str) -> Importer:
    if name not in IMPORTERS:
        raise ConfigError(f"--for {name}: choose one of {', '.join(IMPORTERS)}")
    return IMPORTERS[name]


def _convention(own: Convention, name: str) -> Convention:
    """Return the tool's convention; refuse parts of ours that it cannot express."""
    tool, read_by = _importer(name), preset(name)
    if own.reset not in tool.resets:
        known = " or ".join(tool.resets)
        raise ConventionError(f"its neurons reset by {known!r}, and these by {own.reset!r}")
    theirs = tool.convention(own) if tool.convention else read_by.convention({})
    differ = [f for f in ("delay", "floor") if getattr(own, f) != getattr(theirs, f)]
    if "many" in (own.spikes, theirs.spikes) and own.spikes != theirs.spikes:
        differ.append("spikes")
    for field in differ:
        ours, given = getattr(own, field), getattr(theirs, field)
        raise ConventionError(f"its {field} is {given!r}, that of the network {ours!r}")
    source = f"as {read_by.tool} reads it"
    return replace(theirs, reset=own.reset, state=own.state, source=source)


def _rewrite(
    name: str, nodes: Nodes, edges: EdgeList, own: Convention, theirs: Convention, tool: Importer
) -> None:
    """Put the tool's neurons in the place of ours, and scale the weights before them."""
    neuron, kind = discretise(name, nodes[name], own), type(nodes[name])
    gain = tool.gain(kind, neuron)
    if not ((neuron.gain > 0) & (gain > 0)).all():
        raise ConventionError(f"node {name!r}: its gains must be above 0")
    if neuron.v_reset.any() and not tool.v_reset:
        raise ConventionError(f"node {name!r}: v_reset is not 0, to which it resets membranes")
    scale, threshold = _scale(neuron, gain, tool.uniform), np.asarray(neuron.threshold)
    # SpikingJelly's LIF leaks to v_reset; Norse's starts at v_leak, and ours at 0
    v_leak = neuron.v_reset * scale if kind is nir.LIF else np.zeros_like(neuron.leak)
    rest = neuron.leak * scale - (1 - neuron.membrane_decay) * v_leak
    rest = np.where(np.abs(rest) <= _ROUNDED * np.abs(scale * threshold), 0.0, rest)
    if rest.any() and kind is nir.CubaLIF:
        nothing = "nothing adds v_leak to the membrane behind a synaptic current"
        raise ConventionError(f"node {name!r}: {nothing}")
    moved = _moved_threshold(threshold * scale, own, theirs)
    ends = {"v_threshold": moved, "v_reset": neuron.v_reset * scale}
    nodes[name] = tool.finish(_neurons(kind, neuron, theirs, v_leak, ends), neuron)
    factor, offset = scale * neuron.gain / gain, rest / gain
    if np.abs(factor - 1).max() > _ROUNDED or offset.any():
        for source in _sources(name, nodes, edges):
            nodes[source] = _scaled_weights(source, nodes[source], factor, offset)
            offset = np.zeros_like(offset)  # of several sources the first adds it


def _scale(neuron: DiscreteNeuron, gain: Values, uniform: bool) -> Values:
    """The scale s of each neuron: one that keeps the weights, or else one threshold for all."""
    scale, threshold = np.asarray(gain / neuron.gain), np.asarray(neuron.threshold)
    if not uniform or is_uniform(scale * threshold):
        return scale
    first = scale.flat[0] * threshold.flat[0]
    if np.allclose(scale * threshold, first, rtol=_ROUNDED, atol=0):
        return np.full_like(scale, scale.flat[0]) if is_uniform(threshold) else first / threshold
    return np.asarray(threshold.flat[0] / threshold)


def _neurons(
    kind: type[nir.NIRNode],
    neuron: DiscreteNeuron,
    theirs: Convention,
    v_leak: Values,
    ends: dict[str, Values],
) -> nir.NIRNode:
    """The node with time constants and gains of 1 at the dt of the tool."""

    def time_constant(decay: Values) -> Values:
        with np.errstate(divide="ignore"):
            if theirs.integrator == "exponential":
                return np.asarray(-theirs.dt / np.log(decay))
            return np.asarray(theirs.dt / (1 - decay))

    dt, tau = theirs.dt, time_constant(neuron.membrane_decay)
    if kind is nir.IF:
        return nir.IF(r=np.full(tau.shape, 1 / dt), **ends)
    if neuron.current_decay is None:
        return nir.LIF(tau=tau, r=tau / dt, v_leak=v_leak, **ends)
    tau_syn = time_constant(neuron.current_decay)
    synapse = {"tau_syn": tau_syn, "w_in": tau_syn / dt}
    return nir.CubaLIF(tau_mem=tau, r=tau / dt, v_leak=v_leak, **synapse, **ends)


def _moved_threshold(threshold: Values, own: Convention, theirs: Convention) -> Values:
    """Thresholds by the tool's rule, above or reached, in its float32."""
    if own.spikes == theirs.spikes:
        return threshold
    single, up = threshold.astype(np.float32), theirs.spikes == "reached"
    beyond = single > threshold if up else single < threshold
    moved = np.nextafter(single, np.float32(np.inf if up else -np.inf))
    return np.where(beyond, single, moved).astype(np.float64)


def _sources(name: str, nodes: Nodes, edges: EdgeList) -> Iterator[str]:
    """Nodes with weights for this one only; refuses others."""
    for source in sorted(source for source, target in edges if target == name):
        is_own = [target for first, target in edges if first == source] == [name]
        if not is_own or not isinstance(nodes[source], (*DENSE, nir.Conv1d, nir.Conv2d)):
            raise ConventionError(
                f"node {name!r} must be scaled by its weights, and {source!r} has none for it"
            )
        yield source


def _scaled_weights(name: str, node: nir.NIRNode, factor: Values, offset: Values) -> nir.NIRNode:
    if not isinstance(node, DENSE):
        channels = factor.reshape(len(factor), -1), offset.reshape(len(offset), -1)
        if not all(is_uniform(each) for pair in channels for each in pair):
            raise ConventionError(f"node {name!r} has one weight for neurons that need different")
        factor, offset = (each[:, 0] for each in channels)
    weight = node.weight * factor.reshape(-1, *[1] * (node.weight.ndim - 1))
    bias = getattr(node, "bias", 0.0) * factor + offset
    if isinstance(node, nir.Linear):
        return nir.Affine(weight, bias) if offset.any() else nir.Linear(weight)
    return with_parameters(node, weight=weight, bias=bias)


def _check_decays(
    name: str, before: nir.NIRNode, own: Convention, after: nir.NIRNode, theirs: Convention
) -> None:
    times = [getattr(after, f) for f in ("tau", "tau_mem", "tau_syn") if hasattr(after, f)]
    if not all(np.isfinite(tau).all() and (tau > 0).all() for tau in times):
        raise ConventionError(f"node {name!r}: a decay factor of 0 or 1 has no time constant there")
    one, other = discretise(name, before, own), discretise(name, after, theirs)
    for field in ("current_decay", "membrane_decay"):
        old, new = getattr(one, field), getattr(other, field)
        if old is not None and not np.allclose(old, new, rtol=0, atol=_ROUNDED):
            raise ConventionError(f"node {name!r}: its {field} would become another")


def _check_as_read(graph: nir.NIRGraph, theirs: Convention, name: str) -> None:
    """Refuse what the tool would refuse, or read as other neurons."""
    read, convention = read_like(graph, name, arguments(theirs, name))
    for each, node in sorted(graph.nodes.items()):
        if isinstance(node, SPIKING):
            ours = discretise(each, node, theirs)
            other = discretise(each, read.nodes[each], convention)
            pairs = zip(vars(ours).values(), vars(other).values(), strict=True)
            if not all(
                (a is None and b is None) or np.allclose(a, b, rtol=_ROUNDED, atol=1e-12)
                for a, b in pairs
            ):
                raise ConventionError(f"node {each!r}: it would read other neurons")
