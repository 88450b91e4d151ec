"""What the NIR paper's import for Nengo makes of a NIR file; the package itself has none."""

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.nodes import at_rest, changed, demand, same, stated
from spikedeploy.runtime.artifact.presets.nodes import values as numbers
from spikedeploy.runtime.artifact.presets.preset import Edges, Nodes, Preset
from spikedeploy.runtime.convention import Convention

TOOL = "Nengo 4.1.0"


def _convention(nodes: Nodes, dt: float | None) -> Convention:
    """nengo.LIF holds its voltages at 0 or above; the paper's IF does not."""
    kinds = {type(node) for node in nodes.values()} & {nir.IF, nir.LIF, nir.CubaLIF}
    first = next((name for name, node in sorted(nodes.items()) if isinstance(node, nir.IF)), "")
    mixed = nir.IF in kinds and len(kinds) > 1
    demand(not mixed, first, TOOL, "floors the membranes of LIF and not those of IF, and both")
    floor = "none" if nir.IF in kinds else "zero"
    return stated(TOOL, 1e-3, integrator="exponential", floor=floor)(nodes, dt)


def _read(nodes: Nodes, edges: Edges, convention: Convention) -> None:
    for name, node in sorted(nodes.items()):
        if isinstance(node, (nir.LIF, nir.IF)):
            demand(node.r == 1, name, TOOL, "needs r = 1")
        if isinstance(node, (nir.LIF, nir.LI, nir.CubaLIF)):
            demand(node.v_leak == 0, name, TOOL, "needs v_leak = 0")
        if isinstance(node, nir.IF):
            # the gain is 1/dt, and the neuron multiplies by dt
            nodes[name] = at_rest(changed(node, r=np.full(node.r.shape, 1 / convention.dt)))
        if isinstance(node, nir.LIF):
            demand(same(node.tau), name, TOOL, "takes the tau of the first neuron for all")
            nodes[name] = at_rest(node)
            _amplify(name, nodes, edges, convention)
        if isinstance(node, nir.CubaLIF):
            nodes[name] = _current_based(name, node, convention)
            _wait(name, nodes, edges, convention)


def _current_based(name: str, node: nir.CubaLIF, convention: Convention) -> nir.NIRNode:
    """Its synapse is a lowpass whose decay is 1 - dt/tau_syn, its membrane exp(-dt/tau_mem)."""
    for field in ("r", "v_threshold", "tau_syn", "tau_mem"):
        demand(same(getattr(node, field)), name, TOOL, f"needs one {field} for all neurons")
    step = convention.dt / numbers(node.tau_syn)
    demand(step < 1, name, TOOL, "needs tau_syn above dt")
    return at_rest(changed(node, tau_syn=-convention.dt / np.log1p(-step)))


def _amplify(name: str, nodes: Nodes, edges: Edges, convention: Convention) -> None:
    """A spike of nengo.LIF is 1/dt high."""
    after = f"{name}.amplitude"
    nodes[after] = nir.Scale(np.full(nodes[name].r.shape, 1 / convention.dt))
    for source, target in [edge for edge in edges if edge[0] == name]:
        edges.remove((source, target))
        edges.add((after, target))
    edges.add((name, after))


def _wait(name: str, nodes: Nodes, edges: Edges, convention: Convention) -> None:
    """A lowpass puts out one timestep later."""
    before = f"{name}.synapse"
    nodes[before] = nir.Delay(np.full(nodes[name].r.shape, convention.dt))
    for source, target in [edge for edge in edges if edge[1] == name]:
        edges.remove((source, target))
        edges.add((source, before))
    edges.add((before, name))


NENGO = Preset(
    tool=TOOL,
    kinds=(nir.Affine, nir.Linear, nir.IF, nir.LIF, nir.CubaLIF),
    convention=_convention,
    options=("dt",),
    reading=_read,
    source="github.com/neuromorphs/NIR paper/03_rnn/nir_to_nengo.py; nengo 4.1.0, neurons.py",
)
