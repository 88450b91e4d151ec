"""Presets: what other tools make of the same file.

NIR leaves dt, reset, integrator and delays open, and each tool fills them in on its own; some also
ignore parameters. A preset turns a graph into one that means here what the original means there.
Where a tool would refuse the file, or does what cannot be said in NIR, the preset refuses too.
"""

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, TypeAlias

import nir

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError

Nodes: TypeAlias = dict[str, nir.NIRNode]
Edges: TypeAlias = set[tuple[str, str]]
# change nodes and edges of a graph into those that the tool understands
Reading: TypeAlias = Callable[[Nodes, Edges, Convention], None]

PRESETS: dict[str, str] = {
    "lava": "spikedeploy.runtime.artifact.presets.lava:LAVA",
    "nengo": "spikedeploy.runtime.artifact.presets.nengo:NENGO",
    "norse": "spikedeploy.runtime.artifact.presets.norse:NORSE",
    "rockpool": "spikedeploy.runtime.artifact.presets.rockpool:ROCKPOOL",
    "sinabs": "spikedeploy.runtime.artifact.presets.sinabs:SINABS",
    "snntorch": "spikedeploy.runtime.artifact.presets.snntorch:SNNTORCH",
    "spikingjelly": "spikedeploy.runtime.artifact.presets.spikingjelly:SPIKINGJELLY",
}


@dataclass(frozen=True, eq=False)
class Preset:
    """How one tool reads NIR.

    tool: its name and the version that was looked at.
    kinds: nodes that it reads; Input and Output are understood.
    convention: from the nodes and a dt that was given, or None.
    options: of `Convention` that its importer lets a caller choose.
    reading: of the nodes.
    source: where that can be seen.
    """

    tool: str
    kinds: tuple[type[nir.NIRNode], ...]
    convention: Callable[[Nodes, float | None], Convention]
    options: tuple[str, ...]
    reading: Reading
    source: str


def preset(name: str) -> Preset:
    """The preset called `name`."""
    if name not in PRESETS:
        near = difflib.get_close_matches(name, PRESETS, n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ConventionError(
            f"there is no preset {name!r}.{hint} Choose one of {', '.join(PRESETS)}."
        )
    module, attribute = PRESETS[name].split(":")
    found: Preset = getattr(import_module(module), attribute)
    return found


def read_like(
    graph: nir.NIRGraph, name: str, given: Mapping[str, Any] | None = None
) -> tuple[nir.NIRGraph, Convention]:
    """The graph as the tool called `name` understands it, and the convention to step it by.

    given: options of the convention; those that the tool does not offer are refused.
    """
    tool, options = preset(name), dict(given or {})
    for option in sorted(set(options) - {*tool.options, "state"}):
        offered = ", ".join(tool.options) or "none"
        raise ConventionError(
            f"{tool.tool} lets nobody choose {option}; its options are: {offered}. Leave {option} "
            "away, or read the file without the preset."
        )
    nodes = dict(graph.nodes)
    _check_kinds(tool, nodes)
    convention = tool.convention(nodes, options.pop("dt", None)).with_options(options)
    edges = set(graph.edges)
    tool.reading(nodes, edges, convention)
    changed = nir.NIRGraph(nodes, sorted(edges), metadata=graph.metadata, type_check=False)
    return changed, convention


def _check_kinds(tool: Preset, nodes: Nodes) -> None:
    for name, node in sorted(nodes.items()):
        if not isinstance(node, (nir.Input, nir.Output, *tool.kinds)):
            kinds = ", ".join(kind.__name__ for kind in tool.kinds)
            raise ConventionError(
                f"node {name!r}: {tool.tool} reads no {type(node).__name__}, only {kinds}. Read "
                "the file without the preset."
            )
