"""The tables of tools: how each reads a NIR file, and what it means by one that it wrote.

A `Preset` translates a graph into one that means here what the original means in the tool that
reads it. It refuses what the tool refuses, and what NIR cannot express. A `Writer` translates a
graph into one with its author's meaning; some of what a network does is in no file, so its
convention names what was assumed.
"""

import copy
import difflib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any, NamedTuple, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.graph.neurons import CURRENT_BASED, ROUNDING, SPIKING, rounded_timestep

Nodes: TypeAlias = dict[str, nir.NIRNode]
Edges: TypeAlias = set[tuple[str, str]]
Values = NDArray[np.float64]

PRESETS: dict[str, str] = {
    "lava": "spikedeploy.runtime.dialects.lava:PRESET",
    "nengo": "spikedeploy.runtime.dialects.nengo:PRESET",
    "norse": "spikedeploy.runtime.dialects.norse:PRESET",
    "rockpool": "spikedeploy.runtime.dialects.rockpool:PRESET",
    "sinabs": "spikedeploy.runtime.dialects.sinabs:PRESET",
    "snntorch": "spikedeploy.runtime.dialects.snntorch:PRESET",
    "spikingjelly": "spikedeploy.runtime.dialects.spikingjelly:PRESET",
}
WRITERS: dict[str, str] = {
    "lava": "spikedeploy.runtime.dialects.lava:WRITER",
    "norse": "spikedeploy.runtime.dialects.norse:WRITER",
    "rockpool": "spikedeploy.runtime.dialects.rockpool:WRITER",
    "sinabs": "spikedeploy.runtime.dialects.sinabs:WRITER",
    "snntorch": "spikedeploy.runtime.dialects.snntorch:WRITER",
    "spikingjelly": "spikedeploy.runtime.dialects.spikingjelly:WRITER",
}


@dataclass(frozen=True, eq=False)
class Preset:
    """The import of NIR of one tool.

    tool: name and version.
    kinds: primitives that it reads, besides Input and Output.
    convention: of the nodes of a graph.
    translate: (name, node, convention) to the node that the tool makes of it.
    source: the code in which that can be seen.
    options: of Convention, those that its importer lets a caller choose.
    remark: where the convention comes from, if it is no constant.
    wire: (nodes, edges, convention), changed in place to what the tool puts between nodes.
    """

    tool: str
    kinds: tuple[type[nir.NIRNode], ...]
    convention: Callable[[Nodes], Convention]
    translate: Callable[[str, nir.NIRNode, Convention], nir.NIRNode]
    source: str
    options: tuple[str, ...] = ()
    remark: str = ""
    wire: Callable[[Nodes, Edges, Convention], None] = lambda nodes, edges, convention: None


class Assumption(NamedTuple):
    """An option that the tool's files leave open.

    choices: its values, the tool's default first.
    words: the default in words, and when to choose another.
    """

    choices: tuple[str | int, ...]
    words: str


@dataclass(frozen=True, eq=False)
class Writer:
    """The export of NIR of one tool.

    tool: name and version.
    kinds: primitives that it writes, besides Input and Output.
    timestep: (name, node) to the dt [s] of each of its elements that the file states, or None.
    translate: (name, node, convention) to the node that it is in the tool.
    source: the code in which that can be seen.
    default_timestep: the dt [s] where no node states one, and words for it; None where it must.
    tolerance: relative, within which nodes agree on dt.
    contradiction: why no other dt than the stated one can be given.
    fixed: options of Convention that are the same in all its files.
    open: options that its files do not say.
    always: what else its files do not say, and no option chooses.
    convention: (convention, nodes) to what the options mean for these nodes.
    """

    tool: str
    kinds: tuple[type[nir.NIRNode], ...]
    timestep: Callable[[str, nir.NIRNode], Any]
    translate: Callable[[str, nir.NIRNode, Convention], nir.NIRNode]
    source: str
    default_timestep: tuple[float, str] | None = None
    tolerance: float = 1e-5
    contradiction: str = ""
    fixed: Mapping[str, Any] = field(default_factory=dict)
    open: Mapping[str, Assumption] = field(default_factory=dict)
    always: tuple[str, ...] = ()
    convention: Callable[[Convention, Nodes], Convention] = lambda convention, nodes: convention


def preset(name: str) -> Preset:
    """The preset called `name`; ConventionError where there is none."""
    found: Preset = _entry(PRESETS, name, f"there is no preset {name!r}")
    return found


def writer(name: str) -> Writer:
    """The writer called `name`; ConventionError where there is none."""
    found: Writer = _entry(WRITERS, name, f"no tool {name!r} is known that writes NIR")
    return found


def _entry(table: Mapping[str, str], name: str, refusal: str) -> Any:  # noqa: ANN401
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
    nodes, edges = dict(graph.nodes), set(graph.edges)
    with _refusals(tool.tool, "Change the node, or read the file without the preset."):
        check_kinds(nodes, tool.kinds, "reads")
        source = f"as {tool.tool} reads it" + (f": {tool.remark}" if tool.remark else "")
        convention = replace(tool.convention(nodes), source=source).with_options(options)
        for each in nodes:
            nodes[each] = tool.translate(each, nodes[each], convention)
        tool.wire(nodes, edges, convention)
    translated = nir.NIRGraph(nodes, sorted(edges), metadata=graph.metadata, type_check=False)
    return translated, convention


def read_as_written(
    graph: nir.NIRGraph, name: str, given: Mapping[str, Any] | None = None
) -> tuple[nir.NIRGraph, Convention]:
    """The graph and convention that mean here what the author's network does in the tool `name`.

    given: options of the convention that the file does not say; ConventionError for others. The
        source of the convention names those that were assumed.
    """
    tool, options = writer(name), dict(given or {})
    _check_options(tool, options)
    nodes = dict(graph.nodes)
    with _refusals(tool.tool, "Name the tool that wrote the file, or read it without --from."):
        check_kinds(nodes, tool.kinds, "writes")
        dt, assumed = _timestep(tool, nodes, options.pop("dt", None))
        assumed += [each.words for option, each in tool.open.items() if option not in options]
        defaults = {option: each.choices[0] for option, each in tool.open.items()}
        convention = Convention(dt, **{**tool.fixed, **defaults, **options})
        for each in nodes:
            nodes[each] = tool.translate(each, nodes[each], convention)
    source = f"as {tool.tool} writes it"
    if assumed := [*assumed, *tool.always]:
        source += f"; not in the file, so assumed: {'; '.join(assumed)}"
    stated = replace(tool.convention(convention, nodes), source=source)
    translated = nir.NIRGraph(nodes, sorted(graph.edges), metadata=graph.metadata, type_check=False)
    return translated, stated.with_options({option: getattr(stated, option) for option in options})


def _check_options(tool: Writer, options: Mapping[str, Any]) -> None:
    for option in sorted(set(options) - {*tool.open, "dt", "state"}):
        raise ConventionError(
            f"{option} is no choice in {tool.tool}, or stands in its files; choices are: "
            f"{', '.join(('dt', *tool.open))}. Leave {option} away, or read the file without "
            "--from."
        )
    for option, assumption in tool.open.items():
        if options.get(option, assumption.choices[0]) not in assumption.choices:
            choices = ", ".join(map(repr, assumption.choices))
            raise ConventionError(
                f"{option} {options[option]!r} is nothing that {tool.tool} does. Choose one of "
                f"{choices}, or read the file without --from."
            )


def _timestep(tool: Writer, nodes: Nodes, given: float | None) -> tuple[float, list[str]]:
    """The dt [s] of a file, and what was assumed for it."""
    stated = _stated_timestep(tool, nodes)
    if stated is None and tool.default_timestep is None:
        raise ConventionError(
            f"{tool.tool} writes its dt into the gains of CubaLIF nodes, and there are none. Name "
            "the tool that wrote the file, or read it without --from."
        )
    if stated is None:
        default, words = tool.default_timestep or (0.0, "")
        return (given, []) if given is not None else (default, [words] if words else [])
    if given is not None and not np.isclose(given, stated, rtol=1e-3):
        raise ConventionError(
            f"dt = {given:g} s: the gains of the file say {stated:g} s{tool.contradiction}. Leave "
            "dt away."
        )
    return stated, []


def _stated_timestep(tool: Writer, nodes: Nodes) -> float | None:
    """The dt [s] on which the nodes agree; None where none states it."""
    stated = {name: tool.timestep(name, node) for name, node in sorted(nodes.items())}
    found = {name: float64(np.ravel(dt)) for name, dt in stated.items() if dt is not None}
    if not found:
        return None
    middle = float(np.median(np.concatenate(list(found.values()))))
    for name, dt in found.items():
        near = np.isfinite(dt) & (np.abs(dt / middle - 1) <= tool.tolerance) & (dt > 0)
        one = f"writes one dt into all gains; here it is {dt[0]:g} s, not {middle:g} s as elsewhere"
        require(near, name, one)
    return rounded_timestep(middle, tool.tolerance)


class _RefusedError(Exception):
    """The name of a node, and what the tool needs there."""


@contextmanager
def _refusals(tool: str, remedy: str) -> Iterator[None]:
    """Raise ConventionError for what `require` refuses."""
    try:
        yield
    except _RefusedError as error:
        name, requirement = error.args
        raise ConventionError(f"node {name!r}: {tool} {requirement}. {remedy}") from None


def require(condition: object, name: str, requirement: str) -> None:
    """Refuse the node `name` where some value of `condition` is false.

    requirement: a sentence without its subject, the tool.
    """
    if not np.all(np.asarray(condition)):
        raise _RefusedError(name, requirement)


def check_kinds(nodes: Nodes, known: tuple[type[nir.NIRNode], ...], verb: str) -> None:
    """Refuse primitives, besides Input and Output, that a tool does not know."""
    kinds = ", ".join(kind.__name__ for kind in known)
    for name, node in sorted(nodes.items()):
        is_known = isinstance(node, (nir.Input, nir.Output, *known))
        require(is_known, name, f"{verb} no {type(node).__name__}, only {kinds}")


def are_integrators(nodes: Nodes, mixture: str) -> bool:
    """True if the spiking neurons are IF, False if none is; refuse a mixture."""
    spiking = {name: node for name, node in sorted(nodes.items()) if isinstance(node, SPIKING)}
    integrators = [name for name, node in spiking.items() if isinstance(node, nir.IF)]
    if integrators:
        require(len(integrators) == len(spiking), integrators[0], mixture)
    return bool(integrators)


def float64(values: NDArray[Any]) -> Values:
    """A parameter in float64, in which products of float32 do not round visibly."""
    return values.astype(np.float64)


def is_close(
    found: NDArray[Any], wanted: Values | float, relative: float = ROUNDING[np.float32]
) -> NDArray[np.bool_]:
    """True where values agree but for the rounding of float32."""
    return np.asarray(np.isclose(float64(found), wanted, rtol=relative, atol=1e-12))


def is_uniform(values: NDArray[Any]) -> bool:
    """True if all neurons of a layer have the same value."""
    return np.unique(values).size == 1


def tau_over_r(name: str, node: nir.NIRNode) -> Any:  # noqa: ANN401
    """The dt [s] of tools that write r = tau/dt; None for what has no tau."""
    if isinstance(node, CURRENT_BASED):
        return float64(node.tau_mem) / float64(node.r)
    if isinstance(node, nir.LIF):
        return float64(node.tau) / float64(node.r)
    return None


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


def with_zero_reset(node: nir.NIRNode, **parameters: object) -> nir.NIRNode:
    """The neuron with v_reset = 0, as tools read it that ignore v_reset, and other parameters."""
    return with_parameters(node, v_reset=np.zeros(node.v_threshold.shape), **parameters)


def with_batch_axis(node: nir.Flatten) -> nir.NIRNode:
    """The Flatten of a tool that counts the batch as axis 0."""
    start, end = int(node.start_dim), int(node.end_dim)
    return with_parameters(node, start_dim=max(start - 1, 0), end_dim=end - 1 if end > 0 else end)


def without_padding(node: nir.SumPool2d) -> nir.NIRNode:
    """The pool of a tool that ignores its padding."""
    return with_parameters(node, padding=np.zeros(2, int))
