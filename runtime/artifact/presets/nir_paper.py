"""Lava and Nengo, as the NIR paper's imports configure them.

Nengo itself has no import of NIR.
"""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.preset import (
    Edges,
    Nodes,
    Preset,
    default_convention,
    float64,
    is_close,
    is_uniform,
    require,
    with_parameters,
    with_zero_reset,
)
from spikedeploy.runtime.convention import Convention

_LAVA_TOOL = "Lava 0.10.0 (float)"


def _translate_lava(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in nodes.items():
        if isinstance(node, nir.Affine):
            require(np.abs(node.bias) <= 1e-8, name, _LAVA_TOOL, "reads no bias of an Affine")
        if isinstance(node, (nir.LIF, nir.CubaLIF)):
            require(node.v_leak == 0, name, _LAVA_TOOL, "needs v_leak = 0")
        if isinstance(node, nir.LIF):
            # the import scales the weights before it by dt/tau and ignores r
            nodes[name] = with_zero_reset(with_parameters(node, r=np.ones(node.r.shape)))
        if isinstance(node, nir.CubaLIF):
            close = is_close(node.r, float64(node.tau_mem) / convention.dt)
            require(close, name, _LAVA_TOOL, "needs r = tau_mem/dt")
            nodes[name] = with_zero_reset(node)


LAVA = Preset(
    tool=_LAVA_TOOL,
    kinds=(nir.Affine, nir.Linear, nir.LIF, nir.CubaLIF),
    convention=default_convention(_LAVA_TOOL, 1e-4, delay=1),
    options=("dt",),
    translate=_translate_lava,
    source="github.com/neuromorphs/NIR paper/nir_to_lava.py; a Dense has a delay of one timestep",
)


_NENGO_TOOL = "Nengo 4.1.0"


def _convention(nodes: Nodes, dt: float | None) -> Convention:
    """nengo.LIF clips its membrane at 0; the paper's IF does not."""
    kinds = {type(node) for node in nodes.values()} & {nir.IF, nir.LIF, nir.CubaLIF}
    first = next((name for name, node in sorted(nodes.items()) if isinstance(node, nir.IF)), "")
    mixed = nir.IF in kinds and len(kinds) > 1
    require(
        not mixed,
        first,
        _NENGO_TOOL,
        "floors the membranes of LIF and not those of IF, and the graph has both",
    )
    floor = "none" if nir.IF in kinds else "zero"
    return default_convention(_NENGO_TOOL, 1e-3, integrator="exponential", floor=floor)(nodes, dt)


def _translate_nengo(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in sorted(nodes.items()):
        if isinstance(node, (nir.LIF, nir.IF)):
            require(node.r == 1, name, _NENGO_TOOL, "needs r = 1")
        if isinstance(node, (nir.LIF, nir.LI, nir.CubaLIF)):
            require(node.v_leak == 0, name, _NENGO_TOOL, "needs v_leak = 0")
        if isinstance(node, nir.IF):
            # its import writes a gain of 1/dt, which the neuron multiplies by dt
            nodes[name] = with_zero_reset(
                with_parameters(node, r=np.full(node.r.shape, 1 / convention.dt))
            )
        if isinstance(node, nir.LIF):
            require(
                is_uniform(node.tau), name, _NENGO_TOOL, "takes the tau of the first neuron for all"
            )
            nodes[name] = with_zero_reset(node)
            _amplify(name, nodes, edges, convention)
        if isinstance(node, nir.CubaLIF):
            nodes[name] = _current_based(name, node, convention)
            _delay(name, nodes, edges, convention)


def _current_based(name: str, node: nir.CubaLIF, convention: Convention) -> nir.NIRNode:
    """Its synapse decays by 1 - dt/tau_syn in a timestep, its membrane by exp(-dt/tau_mem)."""
    for field in ("r", "v_threshold", "tau_syn", "tau_mem"):
        require(
            is_uniform(getattr(node, field)),
            name,
            _NENGO_TOOL,
            f"needs one {field} for all neurons",
        )
    step = convention.dt / float64(node.tau_syn)
    require(step < 1, name, _NENGO_TOOL, "needs tau_syn above dt")
    return with_zero_reset(with_parameters(node, tau_syn=-convention.dt / np.log1p(-step)))


def _amplify(name: str, nodes: Nodes, edges: Edges, convention: Convention) -> None:
    """A spike of nengo.LIF has amplitude 1/dt."""
    after = f"{name}.amplitude"
    nodes[after] = nir.Scale(np.full(nodes[name].r.shape, 1 / convention.dt))
    for source, target in [edge for edge in edges if edge[0] == name]:
        edges.remove((source, target))
        edges.add((after, target))
    edges.add((name, after))


def _delay(name: str, nodes: Nodes, edges: Edges, convention: Convention) -> None:
    """The output of a lowpass arrives one timestep later."""
    before = f"{name}.synapse"
    nodes[before] = nir.Delay(np.full(nodes[name].r.shape, convention.dt))
    for source, target in [edge for edge in edges if edge[1] == name]:
        edges.remove((source, target))
        edges.add((source, before))
    edges.add((before, name))


NENGO = Preset(
    tool=_NENGO_TOOL,
    kinds=(nir.Affine, nir.Linear, nir.IF, nir.LIF, nir.CubaLIF),
    convention=_convention,
    options=("dt",),
    translate=_translate_nengo,
    source="github.com/neuromorphs/NIR paper/03_rnn/nir_to_nengo.py; nengo 4.1.0, neurons.py",
)
