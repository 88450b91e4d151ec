"""A NIR file interpreted as another tool reads it, or as the tool that wrote it means it."""

import difflib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import nir
import numpy as np

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.dialects.dialect import (
    Edges,
    Kinds,
    Nodes,
    Preset,
    Writer,
    refusals,
    require,
)
from spikedeploy.runtime.dialects.tools import PRESETS, WRITERS
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.graph.discretisation import float64, rounded_timestep

_T = TypeVar("_T")


def preset(name: str) -> Preset:
    """The preset called `name`; ConventionError where there is none."""
    return _entry(PRESETS, name, f"there is no preset {name!r}")


def writer(name: str) -> Writer:
    """The writer called `name`; ConventionError where there is none."""
    return _entry(WRITERS, name, f"no tool {name!r} is known that writes NIR")


def _entry(table: Mapping[str, _T], name: str, refusal: str) -> _T:
    if name not in table:
        near = difflib.get_close_matches(name, table, n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ConventionError(f"{refusal}.{hint} Choose one of {', '.join(table)}.")
    return table[name]


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
    with refusals(tool.tool, "Change the node, or read the file without the preset."):
        _check_kinds(nodes, tool.kinds, "reads")
        source = f"as {tool.tool} reads it" + (f": {tool.remark}" if tool.remark else "")
        convention = replace(tool.convention(nodes), source=source).with_options(options)
        nodes = {each: tool.translate(each, node, convention) for each, node in nodes.items()}
        tool.wire(nodes, edges, convention)
    return _with_nodes(graph, nodes, edges), convention


def finite_nodes(graph: nir.NIRGraph, name: str) -> nir.NIRGraph:
    """The graph without the infinite numbers that the tool `name` writes; before it is checked."""
    nodes = {each: writer(name).finite(node) for each, node in graph.nodes.items()}
    return _with_nodes(graph, nodes, set(graph.edges))


def read_as_written(
    graph: nir.NIRGraph, name: str, given: Mapping[str, Any] | None = None
) -> tuple[nir.NIRGraph, Convention]:
    """The graph and convention that mean here what the author's network does in the tool `name`.

    given: options of the convention that the file does not say; ConventionError for others. The
        source of the convention names those that were assumed.
    """
    tool, options = writer(name), dict(given or {})
    _check_options(tool, options)
    nodes, edges = dict(graph.nodes), set(graph.edges)
    with refusals(tool.tool, "Name the tool that wrote the file, or read it without --from."):
        _check_kinds(nodes, tool.kinds, "writes")
        gains_say = _stated_timestep(tool, nodes)
        dt, assumed = _timestep(tool, gains_say, options.pop("dt", None))
        assumed += [each.words for option, each in tool.open.items() if option not in options]
        defaults = {option: each.choices[0] for option, each in tool.open.items()}
        convention = Convention(dt, **{**tool.fixed, **defaults, **options})
        nodes = {each: tool.translate(each, node, convention) for each, node in nodes.items()}
        convention = tool.wire(nodes, edges, convention)
    source = f"as {tool.tool} writes it"
    default, words = tool.default_timestep or (dt, "")
    if gains_say is not None and not words and not np.isclose(dt, default, rtol=1e-3):
        source += (
            f", but for gains that say dt = {dt:g} s, where it writes {default:g} s into all its "
            "files: was the file written by another tool?"
        )
    if assumed := [*assumed, *tool.always]:
        source += f"; not in the file, so assumed: {'; '.join(assumed)}"
    stated = replace(convention, source=source)
    told = {option: getattr(stated, option) for option in options}
    return _with_nodes(graph, nodes, edges), stated.with_options(told)


def _with_nodes(graph: nir.NIRGraph, nodes: Nodes, edges: Edges) -> nir.NIRGraph:
    return nir.NIRGraph(nodes, sorted(edges), metadata=graph.metadata, type_check=False)


def _check_kinds(nodes: Nodes, known: Kinds, verb: str) -> None:
    kinds = ", ".join(kind.__name__ for kind in known)
    for name, node in sorted(nodes.items()):
        is_known = isinstance(node, (nir.Input, nir.Output, *known))
        require(is_known, name, f"{verb} no {type(node).__name__}, only {kinds}")


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


def _timestep(tool: Writer, stated: float | None, given: float | None) -> tuple[float, list[str]]:
    """The dt [s] of a file, of which its nodes may state one, and what was assumed for it."""
    if stated is not None:
        if given is not None and not np.isclose(given, stated, rtol=1e-3):
            raise ConventionError(
                f"dt = {given:g} s: the gains of the file say {stated:g} s{tool.contradiction}. "
                "Leave dt away."
            )
        return stated, []
    if tool.default_timestep is None:
        raise ConventionError(
            f"{tool.tool} writes its dt into the gains of CubaLIF nodes, and there are none. Name "
            "the tool that wrote the file, or read it without --from."
        )
    default, words = tool.default_timestep
    return (given, []) if given is not None else (default, [words] if words else [])


def _stated_timestep(tool: Writer, nodes: Nodes) -> float | None:
    """The dt [s] on which the nodes agree; None where none states it."""
    with np.errstate(divide="ignore", invalid="ignore"):  # of gains of 0
        stated = {name: tool.timestep(name, node) for name, node in sorted(nodes.items())}
    found = {name: float64(np.ravel(dt)) for name, dt in stated.items() if dt is not None}
    if not found:
        return None
    for name, dt in found.items():
        for none in dt[~(np.isfinite(dt) & (dt > 0))][:1]:
            gains = f"writes one dt above 0 into all gains; here they say {none:g} s"
            require(False, name, gains)
    middle = float(np.median(np.concatenate(list(found.values()))))
    for name, dt in found.items():
        far = np.abs(dt / middle - 1) > tool.tolerance
        for other in dt[far][:1]:
            one = f"writes one dt into all gains; here it is {other:g} s, not {middle:g} s as "
            require(False, name, f"{one}elsewhere")
    return rounded_timestep(middle, tool.tolerance)
