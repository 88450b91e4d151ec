"""An artifact as another tool's import reads the same network; refused where it cannot.

What comes out is read as the tool would (artifact.presets), and compared with the network.
"""

from collections.abc import Mapping
from dataclasses import replace

import nir
import numpy as np

from spikedeploy.exporters.importers.neurons import ROUNDED, Importer, refusal, rewrite
from spikedeploy.exporters.importers.visits import in_order
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.artifact.presets.preset import check_kinds, preset, read_like
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConfigError, ConventionError
from spikedeploy.runtime.graph.neurons import SPIKING, DiscreteNeuron, discretise

IMPORTERS = {
    tool.name: tool
    for tool in (
        Importer("norse", uniform=False, resets=("zero", "subtract")),
        Importer("rockpool", uniform=False, resets=("subtract",)),
        Importer("snntorch"),
        Importer("spikingjelly", v_reset=True),
    )
}


def for_importer(artifact: Artifact, name: str) -> Artifact:
    """The artifact that a tool reads as this one's network; ConventionError where it cannot."""
    if name not in IMPORTERS:
        raise ConfigError(f"--for {name}: choose one of {', '.join(IMPORTERS)}")
    tool, nodes = IMPORTERS[name], dict(artifact.graph.nodes)
    if artifact.sigma_delta:
        raise refusal(tool, "it would sum up what sigma-delta neurons rectify and round")
    _check_kinds(nodes, tool)
    own, theirs = artifact.convention, _convention(artifact.convention, tool)
    edges = sorted(artifact.graph.edges)
    for each in sorted(n for n, node in nodes.items() if isinstance(node, SPIKING)):
        rewrite(each, nodes, edges, own, theirs, tool)
        _check_decays(each, artifact, nodes[each], theirs, tool)
    nodes, edges = in_order(nodes, edges, tool)
    graph = nir.NIRGraph(nodes, edges, metadata=artifact.graph.metadata, type_check=False)
    _check_as_read(graph, theirs, tool)
    return replace(artifact, graph=graph, convention=theirs)


def arguments(convention: Convention, name: str) -> dict[str, str]:
    """What the importer must be told beside the file."""
    return {"reset": convention.reset} if convention.reset != IMPORTERS[name].resets[0] else {}


def _convention(own: Convention, tool: Importer) -> Convention:
    """The tool's convention; refuses what of ours it cannot be."""
    read_by = preset(tool.name)
    if own.reset not in tool.resets:
        known = " or ".join(tool.resets)
        raise refusal(tool, f"its neurons reset by {known!r}, and these by {own.reset!r}")
    if tool.name == "rockpool":
        theirs = Convention(own.dt, "subtract", "exponential", spikes="many")
    else:
        theirs = replace(read_by.convention({}, None), reset=own.reset)
    differ = [f for f in ("delay", "floor") if getattr(own, f) != getattr(theirs, f)]
    if "many" in (own.spikes, theirs.spikes) and own.spikes != theirs.spikes:
        differ.append("spikes")
    for field in differ:
        ours, given = getattr(own, field), getattr(theirs, field)
        raise refusal(tool, f"its {field} is {given!r}, that of the network {ours!r}")
    return replace(theirs, state=own.state, source=f"as {read_by.tool} reads it")


def _check_kinds(nodes: Mapping[str, nir.NIRNode], tool: Importer) -> None:
    read_by = preset(tool.name)
    try:
        check_kinds(dict(nodes), read_by.kinds, f"{read_by.tool} reads", "")
    except ConventionError as error:
        raise refusal(tool, str(error).rstrip(". ")) from error


def _check_decays(
    name: str, artifact: Artifact, node: nir.NIRNode, theirs: Convention, tool: Importer
) -> None:
    """Refuse decay factors that the tool has no time constant for, such as 1."""
    before = discretise(name, artifact.graph.nodes[name], artifact.convention)
    times = [getattr(node, f) for f in ("tau", "tau_mem", "tau_syn") if hasattr(node, f)]
    if not all(np.isfinite(tau).all() and (tau > 0).all() for tau in times):
        raise refusal(tool, f"node {name!r}: a decay factor of 0 or 1 has no time constant there")
    after = discretise(name, node, theirs)
    for field in ("current_decay", "membrane_decay"):
        old, new = getattr(before, field), getattr(after, field)
        if old is not None and not np.allclose(old, new, rtol=0, atol=ROUNDED):
            raise refusal(tool, f"node {name!r}: its {field} would become another")


def _check_as_read(graph: nir.NIRGraph, theirs: Convention, tool: Importer) -> None:
    """Refuse what the tool would refuse, or read as other neurons."""
    given = {"reset": theirs.reset} if len(tool.resets) > 1 else {}
    try:
        read, convention = read_like(graph, tool.name, given)
    except ConventionError as error:
        # what follows tells what to do with a file that is read
        raise refusal(tool, str(error).partition(". ")[0]) from error
    for name, node in sorted(graph.nodes.items()):
        if isinstance(node, SPIKING):
            ours = discretise(name, node, theirs)
            if not _equal(ours, discretise(name, read.nodes[name], convention)):
                raise refusal(tool, f"node {name!r}: it would read other neurons")


def _equal(one: DiscreteNeuron, other: DiscreteNeuron) -> bool:
    """Whether two difference equations are the same but for rounding."""
    return all(
        (a is None and b is None) or np.allclose(a, b, rtol=ROUNDED, atol=1e-12)
        for a, b in zip(vars(one).values(), vars(other).values(), strict=True)
    )
