"""Presets: how other tools read the same file.

NIR leaves dt, reset, integrator and delays open; each tool fills them in on its own, and some
ignore parameters. A preset translates a graph into one that means here what the original means in
that tool. It refuses what the tool refuses, and what NIR cannot express.
"""

import copy
import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.graph.neurons import ROUNDING

Nodes: TypeAlias = dict[str, nir.NIRNode]
Edges: TypeAlias = set[tuple[str, str]]
Values = NDArray[np.float64]

PRESETS: dict[str, str] = {
    "lava": "spikedeploy.runtime.artifact.presets.nir_paper:LAVA",
    "nengo": "spikedeploy.runtime.artifact.presets.nir_paper:NENGO",
    "norse": "spikedeploy.runtime.artifact.presets.torch_tools:NORSE",
    "rockpool": "spikedeploy.runtime.artifact.presets.synsense:ROCKPOOL",
    "sinabs": "spikedeploy.runtime.artifact.presets.synsense:SINABS",
    "snntorch": "spikedeploy.runtime.artifact.presets.torch_tools:SNNTORCH",
    "spikingjelly": "spikedeploy.runtime.artifact.presets.torch_tools:SPIKINGJELLY",
}


@dataclass(frozen=True, eq=False)
class Preset:
    """How one tool reads NIR.

    tool: name and version.
    kinds: primitives that it reads, besides Input and Output.
    convention: (nodes, given dt [s] or None) to the convention.
    options: of Convention, those that its importer lets a caller choose.
    translate: changes nodes and edges in place to what the tool makes of them.
    source: the code in which that can be seen.
    """

    tool: str
    kinds: tuple[type[nir.NIRNode], ...]
    convention: Callable[[Nodes, float | None], Convention]
    options: tuple[str, ...]
    translate: Callable[[Nodes, Edges, Convention], None]
    source: str


def preset(name: str) -> Preset:
    """The preset called `name`; ConventionError where there is none."""
    found: Preset = tool_of(PRESETS, name, f"there is no preset {name!r}")
    return found


def tool_of(table: Mapping[str, str], name: str, refusal: str) -> Any:  # noqa: ANN401
    """What a table of "module:name" has for a tool; ConventionError where it has nothing."""
    if name not in table:
        near = difflib.get_close_matches(name, table, n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ConventionError(f"{refusal}.{hint} Choose one of {', '.join(table)}.")
    module, attribute = table[name].split(":")
    return getattr(import_module(module), attribute)


def read_like(
    graph: nir.NIRGraph, name: str, given: Mapping[str, Any] | None = None
) -> tuple[nir.NIRGraph, Convention]:
    """The graph and convention that have here the meaning of `graph` in the tool called `name`.

    given: options of the convention; ConventionError for those that the tool does not offer.
    """
    tool, options = preset(name), dict(given or {})
    for option in sorted(set(options) - {*tool.options, "state"}):
        offered = ", ".join(tool.options) or "none"
        raise ConventionError(
            f"{tool.tool} does not let {option} be chosen; its options are: {offered}. Leave "
            f"{option} away, or read the file without the preset."
        )
    nodes = dict(graph.nodes)
    check_kinds(nodes, tool.kinds, f"{tool.tool} reads", "Read the file without the preset.")
    convention = tool.convention(nodes, options.pop("dt", None)).with_options(options)
    edges = set(graph.edges)
    tool.translate(nodes, edges, convention)
    translated = nir.NIRGraph(nodes, sorted(edges), metadata=graph.metadata, type_check=False)
    return translated, convention


def default_convention(
    tool: str,
    default: float,
    **options: Any,  # noqa: ANN401
) -> Callable[[object, float | None], Convention]:
    """The convention of a tool with a default dt [s], which a given dt replaces."""

    def convention(_: object, dt: float | None) -> Convention:
        source = f"as {tool} reads it" if dt is None else f"dt given, otherwise as {tool} reads it"
        return Convention(default if dt is None else dt, source=source, **options)

    return convention


def require(condition: object, name: str, tool: str, requirement: str) -> None:
    """Raise ConventionError for the node `name` where some value of `condition` is false."""
    if not np.all(np.asarray(condition)):
        raise ConventionError(
            f"node {name!r}: {tool} {requirement}. Change the node, or read the file without the "
            "preset."
        )


def float64(field: NDArray[Any]) -> Values:
    """A parameter in float64, in which products of float32 do not round visibly."""
    return field.astype(np.float64)


def is_close(
    found: NDArray[Any], wanted: Values | float, relative: float = ROUNDING[np.float32]
) -> NDArray[np.bool_]:
    """Whether values agree but for the rounding of float32."""
    return np.asarray(np.isclose(float64(found), wanted, rtol=relative, atol=1e-12))


def is_uniform(field: NDArray[Any]) -> bool:
    """Whether all neurons of a layer have the same value."""
    return np.unique(field).size == 1


def one_minus_decay(tau: NDArray[Any], convention: Convention) -> Values:
    """1 minus the decay factor of a time constant [s]."""
    step = convention.dt / float64(tau)
    return -np.expm1(-step) if convention.integrator == "exponential" else step


def with_parameters(node: nir.NIRNode, **parameters: object) -> nir.NIRNode:
    """A copy of the node with other parameters."""
    other = copy.copy(node)
    for name, value in parameters.items():
        setattr(other, name, value)
    return other


def with_gain(node: nir.NIRNode, convention: Convention, gain: Values | float = 1.0) -> nir.NIRNode:
    """The neuron whose input is multiplied by this gain, once discretised."""
    if isinstance(node, (nir.IF, nir.I)):
        return with_parameters(node, r=np.full(node.r.shape, 1.0) * gain / convention.dt)
    if isinstance(node, (nir.LIF, nir.LI)):
        return with_parameters(node, r=gain / one_minus_decay(node.tau, convention))
    return with_parameters(
        node,
        r=1 / one_minus_decay(node.tau_mem, convention),
        w_in=gain / one_minus_decay(node.tau_syn, convention),
    )


def with_zero_reset(node: nir.NIRNode) -> nir.NIRNode:
    """The neuron with v_reset = 0, as tools read it that ignore v_reset."""
    return with_parameters(node, v_reset=np.zeros(node.v_threshold.shape))


def with_batch_axis(node: nir.Flatten) -> nir.NIRNode:
    """The Flatten of a tool that counts the batch as axis 0."""
    start, end = int(node.start_dim), int(node.end_dim)
    return with_parameters(node, start_dim=max(start - 1, 0), end_dim=end - 1 if end > 0 else end)


def check_kinds(
    nodes: Nodes, known: tuple[type[nir.NIRNode], ...], handles: str, remedy: str
) -> None:
    """Refuse primitives, besides Input and Output, that a tool does not know.

    handles: whose they are, such as "Norse reads".
    """
    for name, node in sorted(nodes.items()):
        if not isinstance(node, (nir.Input, nir.Output, *known)):
            kinds = ", ".join(kind.__name__ for kind in known)
            raise ConventionError(
                f"node {name!r}: {handles} no {type(node).__name__}, only {kinds}. {remedy}"
            )
