"""Norse: its import of NIR, what its export means, and networks written for its import.

Norse 1.1.0 (nirtorch.load) visits nodes depth first, along edges in the order of the file; the node
that it visits last is its output. A node with several sources runs when the first of them did.
"""

from collections.abc import Container

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
    require,
    with_batch_axis,
    with_parameters,
    with_zero_reset,
    without_padding,
)
from spikedeploy.runtime.dialects.rewriting import EdgeList, Importer
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.graph.neurons import DiscreteNeuron
from spikedeploy.runtime.graph.order import order

_TOOL = "Norse 1.1.0"
_KINDS = (
    nir.Affine, nir.Linear, nir.Conv2d, nir.Flatten, nir.SumPool2d, nir.IF, nir.LIF, nir.CubaLIF,
)  # fmt: skip


def _read(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    if isinstance(node, nir.Flatten):
        return with_batch_axis(node)
    if isinstance(node, nir.SumPool2d):
        return without_padding(node)
    if isinstance(node, (nir.IF, nir.LIF)):
        only = "subtracts after spikes of CubaLIF only"
        require(convention.reset == "zero", name, only)
        # it ignores r, with a warning; an IF adds its input whatever dt is
        r = 1 / convention.dt if isinstance(node, nir.IF) else 1.0
        return with_zero_reset(node, r=np.full(node.r.shape, r))
    if isinstance(node, nir.CubaLIF):
        require(node.v_leak == 0, name, "would add v_leak to the synapse as well")
        return with_zero_reset(node)
    return node


PRESET = Preset(
    tool=_TOOL,
    kinds=_KINDS,
    convention=lambda nodes: Convention(1e-3),
    options=("dt", "reset"),
    translate=_read,
    source="norse 1.1.0, torch/utils/import_nir.py and torch/functional/lif_box.py",
)


def _as_meant(name: str, node: nir.NIRNode, convention: Convention) -> nir.NIRNode:
    """The neuron with its own time constants; files hold dt/tau_inv, tau times the dt of to_nir."""
    dt = convention.dt
    if isinstance(node, (nir.LIF, nir.CubaLIF, nir.LI, nir.IF)):
        require(node.r == 1, name, "writes r = 1")
    if isinstance(node, (nir.LIF, nir.LI)):
        return with_parameters(node, tau=float64(node.tau) / dt)
    if isinstance(node, nir.CubaLIF):
        if convention.reset == "subtract":
            raise ConventionError(
                f"node {name!r}: reset 'subtract': an LIFCell of {_TOOL} resets to "
                "v_reset, only an LIFBoxCell can subtract. Leave --reset away."
            )
        tau_syn, tau_mem = float64(node.tau_syn) / dt, float64(node.tau_mem) / dt
        # the input is added to the current whole
        return with_parameters(node, tau_syn=tau_syn, tau_mem=tau_mem, w_in=tau_syn / dt)
    if isinstance(node, nir.IF):
        # the input is added whatever dt is
        return with_parameters(node, r=np.full(node.r.shape, 1 / dt))
    return node


WRITER = Writer(
    tool=_TOOL,
    kinds=(nir.Affine, nir.Conv2d, nir.LIF, nir.CubaLIF, nir.LI, nir.IF),
    timestep=lambda name, node: None,
    default_timestep=(
        1e-3,
        "dt = 0.001 s of neurons and of to_nir, Norse's default (--dt if yours was another)",
    ),
    translate=_as_meant,
    source="norse 1.1.0, torch/utils/export_nir.py, torch/functional/lif.py and lif_box.py",
    open={
        "reset": Assumption(
            ("zero", "subtract"),
            "reset to v_reset, Norse's default (--reset subtract if reset_method was "
            "reset_subtract)",
        )
    },
    always=("v_reset = 0, its default",),
)


def _import_gain(kind: type[nir.NIRNode], neuron: DiscreteNeuron) -> Values:
    """The gain that r = 1, which is all that it knows, gives a LIF."""
    return 1 - neuron.membrane_decay if kind is nir.LIF else np.ones_like(neuron.gain)


def _finish(node: nir.NIRNode, neuron: DiscreteNeuron) -> nir.NIRNode:
    """The neurons with the r that it ignores, and we do not."""
    return with_parameters(node, r=np.ones_like(node.tau)) if isinstance(node, nir.LIF) else node


def _in_visited_order(nodes: Nodes, edges: EdgeList) -> tuple[Nodes, EdgeList]:
    """The graph, if need be with names that sort as it must be visited: what returns comes first.

    Raises ConventionError where no names do.
    """
    if _is_right(visits(nodes, sorted(edges)), nodes, edges):
        return nodes, sorted(edges)
    output = next(name for name, node in nodes.items() if isinstance(node, nir.Output))
    wanted = visits(nodes, sorted(edges), output)
    if not _is_right(wanted, nodes, edges):
        raise ConventionError(
            "it runs a node when the first of its sources did, and a node here waits for more"
        )
    names = {name: f"n{index:03}_{name}" for index, name in enumerate(wanted)}
    again = {names[name]: nodes[name] for name in wanted}
    return again, sorted((names[source], names[target]) for source, target in edges)


def visits(nodes: Nodes, edges: EdgeList, output: str = "") -> list[str]:
    """Nodes as Norse runs them; with `output`, its branch is the last at each node."""
    found: dict[str, None] = {}
    waiting = [name for name, node in nodes.items() if isinstance(node, nir.Input)][:1]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found[name] = None
            targets = [target for source, target in edges if source == name]
            if output:
                targets.sort(key=lambda target: output in _reached(target, edges, found))
            waiting += reversed(targets)
    return list(found)


def _reached(name: str, edges: EdgeList, without: Container[str]) -> set[str]:
    """Nodes that paths from this one lead to, past those that are left out."""
    found: set[str] = set()
    new = {name}
    while new := {each for each in new if each not in without} - found:
        found |= new
        new = {target for source, target in edges if source in new}
    return found


def _is_right(visited: list[str], nodes: Nodes, edges: EdgeList) -> bool:
    """True if the Output comes last, and as many edges lead back as loops need."""
    at = {name: index for index, name in enumerate(visited)}
    if at.keys() != nodes.keys() or not isinstance(nodes[visited[-1]], nir.Output):
        return False
    back = sum(at[source] >= at[target] for source, target in edges)
    return back == len(order(nir.NIRGraph(nodes, edges, type_check=False)).late)


IMPORTER = Importer(
    uniform=False,
    resets=("zero", "subtract"),
    gain=_import_gain,
    finish=_finish,
    arrange=_in_visited_order,
)
