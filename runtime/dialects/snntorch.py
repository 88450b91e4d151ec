"""snnTorch: its import of NIR, what its export means, and networks written for its import."""

from dataclasses import replace
from typing import Any

import nir
import numpy as np

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.dialect import (
    Assumption,
    Nodes,
    Preset,
    Values,
    Writer,
    float64,
    is_close,
    is_uniform,
    require,
    tau_over_r,
    with_batch_axis,
    with_gain,
    with_parameters,
    with_zero_reset,
)
from spikedeploy.runtime.dialects.rewriting import EdgeList, Importer
from spikedeploy.runtime.graph.neurons import SPIKING

_TOOL = "snnTorch 1.0.0"
_MAPS = (nir.Affine, nir.Linear, nir.Conv2d, nir.Flatten, nir.AvgPool2d)


def _read(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """The neuron with a gain of 1; another gain of the file divides the threshold instead."""
    if isinstance(node, nir.Flatten):
        return with_batch_axis(node)
    leaky = "reads IF as a leaky neuron of decay factor 0.9 (its issue 416)"
    require(not isinstance(node, nir.IF), name, leaky)
    if not isinstance(node, (nir.LIF, nir.CubaLIF)):
        return node
    require(node.v_leak == 0, name, "needs v_leak = 0")
    dt = convention.dt
    if isinstance(node, nir.CubaLIF):
        unit = is_close(node.r, float64(node.tau_mem) / dt)
        require(unit, name, f"needs r = tau_mem/dt, dt being {dt:g} s always")
        scale = float64(node.w_in) * dt / float64(node.tau_syn)
    else:
        scale = float64(node.r) * dt / float64(node.tau)
    threshold = float64(node.v_threshold)
    if not is_close(scale, 1.0).all():
        require(scale > 0, name, "needs gains above 0")
        threshold = threshold / scale
    one = is_uniform(np.round(threshold, 12))
    require(one, name, "needs one threshold for all neurons")
    return with_zero_reset(with_gain(node, convention), v_threshold=threshold)


PRESET = Preset(
    tool=_TOOL,
    kinds=(*_MAPS, nir.IF, nir.LIF, nir.CubaLIF),
    convention=lambda nodes: Convention(1e-4),
    translate=_read,
    source="snntorch 1.0.0, import_nir.py: dt, reset_mechanism and reset_delay are constants there",
)


def _as_meant(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """The neuron with time constants [s] of exactly its decay factors in float32."""
    if not isinstance(node, (nir.LIF, nir.CubaLIF)):
        return node
    require(node.v_leak == 0, name, "writes v_leak = 0")
    require(node.v_reset == 0, name, "writes v_reset = 0")
    taus = ("tau",) if isinstance(node, nir.LIF) else ("tau_syn", "tau_mem")
    exact = {tau: _exact(getattr(node, tau), convention.dt) for tau in taus}
    return with_gain(with_parameters(node, **exact), convention)


def _exact(written: Any, dt: float) -> Values:  # noqa: ANN401
    """dt/(1 - beta), beta as the network had it."""
    beta = 1 - dt / float64(written)
    return np.asarray(dt / (1 - (beta.astype(written.dtype).astype(np.float64))))


def _convention(convention: Convention, nodes: Nodes) -> Convention:
    # where the threshold is not below 0; reset_delay=False, see runtime.float_model
    if convention.reset == "subtract":
        return replace(convention, reset="subtract-ahead")
    # b V is 0 after either: a Leaky fires alike
    current_based = any(isinstance(node, nir.CubaLIF) for node in nodes.values())
    late = convention.reset == "zero-delayed"
    return replace(convention, reset="zero") if late and not current_based else convention


WRITER = Writer(
    tool=_TOOL,
    kinds=(*_MAPS, nir.LIF, nir.CubaLIF),
    # its neurons have decay factors and no dt; its export writes r = tau/dt with 1e-4
    timestep=tau_over_r,
    default_timestep=(1e-4, ""),
    contradiction=f", which {_TOOL} writes whatever its network was trained with; its decays count "
    "timesteps",
    translate=_as_meant,
    convention=_convention,
    source="snntorch 1.0.0, export_nir.py, _neurons/leaky.py and _neurons/synaptic.py",
    open={
        "reset": Assumption(
            ("subtract-delayed", "zero", "subtract", "zero-delayed", "none"),
            "reset by subtraction, delayed, snnTorch's default (--reset zero or subtract if yours "
            "had reset_delay=False, zero-delayed or none if it had that reset_mechanism)",
        )
    },
)


def _without_loops_of_two(nodes: Nodes, edges: EdgeList) -> tuple[Nodes, EdgeList]:
    """The graph with a node more, which changes nothing, in each loop of a neuron and weights.

    snnTorch 1.0.0 wraps such loops, and nirtorch 2.6 cannot run what comes of it; it runs a loop of
    three nodes.
    """
    nodes, kept = dict(nodes), set(edges)
    for source, target in sorted(edges):
        if isinstance(nodes[source], SPIKING) and (target, source) in edges:
            between = f"{target}_in"
            while between in nodes:
                between += "_"
            nodes[between] = nir.Linear(np.eye(nodes[source].v_threshold.size))
            kept = kept - {(source, target)} | {(source, between), (between, target)}
    return nodes, sorted(kept)


IMPORTER = Importer(arrange=_without_loops_of_two)
