"""Nengo, as the NIR paper's import configures it; it has no import of its own, and no export."""

import nir
import numpy as np

from spikedeploy.runtime.convention import Convention, Floor
from spikedeploy.runtime.dialects.dialect import (
    Edges,
    Nodes,
    Preset,
    are_integrators,
    float64,
    is_uniform,
    require,
    with_zero_reset,
)


def _convention(nodes: Nodes) -> Convention:
    """nengo.LIF clips its membrane at 0; the paper's IF does not."""
    mixture = "floors the membranes of LIF and not those of IF, and the graph has both"
    floor: Floor = "none" if are_integrators(nodes, mixture) else "zero"
    return Convention(1e-3, integrator="exponential", floor=floor)


def _read(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, (nir.LIF, nir.IF)):
        require(node.r == 1, name, "needs r = 1")
    if isinstance(node, (nir.LIF, nir.LI, nir.CubaLIF)):
        require(node.v_leak == 0, name, "needs v_leak = 0")
    if isinstance(node, nir.IF):
        # its import writes a gain of 1/dt, which the neuron multiplies by dt
        return with_zero_reset(node, r=np.full(node.r.shape, 1 / convention.dt))
    if isinstance(node, nir.LIF):
        require(is_uniform(node.tau), name, "takes the tau of the first neuron for all")
        return with_zero_reset(node)
    return _current_based(name, node, convention) if isinstance(node, nir.CubaLIF) else node


def _current_based(name: str, node: nir.CubaLIF, convention: Convention) -> nir.NIRNode:
    """Its synapse decays by 1 - dt/tau_syn in a timestep, its membrane by exp(-dt/tau_mem)."""
    for field in ("r", "v_threshold", "tau_syn", "tau_mem"):
        require(is_uniform(getattr(node, field)), name, f"needs one {field} for all neurons")
    step = convention.dt / float64(node.tau_syn)
    require(step < 1, name, "needs tau_syn above dt")
    return with_zero_reset(node, tau_syn=-convention.dt / np.log1p(-step))


def _wire(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    """Amplify the spikes of a LIF by 1/dt, and delay the input of a CubaLIF, a lowpass, by dt."""
    for name, node in sorted(nodes.items()):
        if isinstance(node, nir.LIF):
            after = f"{name}.amplitude"
            nodes[after] = nir.Scale(np.full(node.r.shape, 1 / convention.dt))
            for edge in [edge for edge in edges if edge[0] == name]:
                edges.remove(edge)
                edges.add((after, edge[1]))
            edges.add((name, after))
        if isinstance(node, nir.CubaLIF):
            before = f"{name}.synapse"
            nodes[before] = nir.Delay(np.full(node.r.shape, convention.dt))
            for edge in [edge for edge in edges if edge[1] == name]:
                edges.remove(edge)
                edges.add((edge[0], before))
            edges.add((before, name))


PRESET = Preset(
    tool="Nengo 4.1.0",
    kinds=(nir.Affine, nir.Linear, nir.IF, nir.LIF, nir.CubaLIF),
    convention=_convention,
    options=("dt",),
    translate=_read,
    wire=_wire,
    source="github.com/neuromorphs/NIR paper/03_rnn/nir_to_nengo.py; nengo 4.1.0, neurons.py",
)
