"""Writers: what other tools mean by the files that they write."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import nir
import numpy as np

from spikedeploy.runtime.artifact.presets.preset import Nodes, check_kinds, float64, tool_of
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.graph.neurons import CURRENT_BASED

WRITERS: dict[str, str] = {
    "lava": "spikedeploy.runtime.artifact.writers.chip_tools:LAVA",
    "norse": "spikedeploy.runtime.artifact.writers.torch_tools:NORSE",
    "rockpool": "spikedeploy.runtime.artifact.writers.chip_tools:ROCKPOOL",
    "sinabs": "spikedeploy.runtime.artifact.writers.chip_tools:SINABS",
    "snntorch": "spikedeploy.runtime.artifact.writers.torch_tools:SNNTORCH",
    "spikingjelly": "spikedeploy.runtime.artifact.writers.torch_tools:SPIKINGJELLY",
}


class Assumption(NamedTuple):
    """An option that the tool's files leave open.

    choices: its values, the tool's default first.
    words: the default in words, and when to choose another.
    """

    choices: tuple[str | int, ...]
    words: str


@dataclass(frozen=True, eq=False)
class Writer:
    """How one tool writes NIR.

    tool: name and version.
    kinds: primitives that it writes, besides Input and Output.
    timestep: (nodes, given dt [s] or None) to dt and what was assumed for it, or "".
    translate: changes nodes in place to what they are in the tool, and returns the convention.
    source: the code in which that can be seen.
    fixed: options of Convention that are the same in all its files.
    open: options that its files do not say.
    always: what else its files do not say, and no option chooses.
    """

    tool: str
    kinds: tuple[type[nir.NIRNode], ...]
    timestep: Callable[[Nodes, float | None], tuple[float, str]]
    translate: Callable[[Nodes, Convention], Convention]
    source: str
    fixed: Mapping[str, Any] = field(default_factory=dict)
    open: Mapping[str, Assumption] = field(default_factory=dict)
    always: tuple[str, ...] = ()


def writer(name: str) -> Writer:
    """The writer called `name`; ConventionError where there is none."""
    found: Writer = tool_of(WRITERS, name, f"no tool {name!r} is known that writes NIR")
    return found


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
    remedy = "Name the tool that wrote the file, or read it without --from."
    check_kinds(nodes, tool.kinds, f"{tool.tool} writes", remedy)
    dt, assumed = tool.timestep(nodes, options.pop("dt", None))
    said = [assumed] if assumed else []
    said += [each.words for option, each in tool.open.items() if option not in options]
    defaults = {option: each.choices[0] for option, each in tool.open.items()}
    chosen = {**tool.fixed, **defaults, **options}
    convention = tool.translate(nodes, Convention(dt, **chosen))
    translated = nir.NIRGraph(nodes, sorted(graph.edges), metadata=graph.metadata, type_check=False)
    return translated, _with_source(convention, tool, [*said, *tool.always], options)


def _with_source(
    convention: Convention, tool: Writer, assumed: list[str], given: Mapping[str, Any]
) -> Convention:
    """The same convention; its source says what the file does not."""
    source = f"as {tool.tool} writes it"
    if assumed:
        source += f"; not in the file, so assumed: {'; '.join(assumed)}"
    stated = replace(convention, source=source)
    return stated.with_options({name: getattr(stated, name) for name in given})


def _check_options(tool: Writer, options: Mapping[str, Any]) -> None:
    for option in sorted(set(options) - {*tool.open, "dt", "state"}):
        offered = ", ".join(("dt", *tool.open))
        raise ConventionError(
            f"{option} is no choice in {tool.tool}, or stands in its files; choices are: "
            f"{offered}. Leave {option} away, or read the file without --from."
        )
    for option, assumption in tool.open.items():
        if options.get(option, assumption.choices[0]) not in assumption.choices:
            choices = ", ".join(map(repr, assumption.choices))
            raise ConventionError(
                f"{option} {options[option]!r} is nothing that {tool.tool} does. Choose one of "
                f"{choices}, or read the file without --from."
            )


def must(condition: object, name: str, tool: str, what: str) -> None:
    """Raise ConventionError for the node `name` where the tool would not have written it."""
    if not np.all(np.asarray(condition)):
        raise ConventionError(
            f"node {name!r}: {tool} {what}. Name the tool that wrote the file, or read it without "
            "--from."
        )


def from_gains(
    nodes: Nodes,
    tool: str,
    steps: Callable[[nir.NIRNode], Any],
    tolerance: float = 1e-5,
) -> float | None:
    """The dt [s] on which the neurons agree; None where no neuron says it.

    steps: a neuron to the dt of each of its elements, or None where it says none.
    """
    said = {name: steps(node) for name, node in sorted(nodes.items())}
    found = {name: float64(np.ravel(dt)) for name, dt in said.items() if dt is not None}
    if not found:
        return None
    middle = float(np.median(np.concatenate(list(found.values()))))
    for name, dt in found.items():
        near = np.isfinite(dt) & (np.abs(dt / middle - 1) <= tolerance) & (dt > 0)
        must(
            near,
            name,
            tool,
            f"writes one dt into all gains; here it is {dt[0]:g} s, not {middle:g} s as elsewhere",
        )
    short = float(f"{middle:.4g}")
    return short if abs(short / middle - 1) <= tolerance else middle


def not_contradicted(given: float | None, found: float, why: str = "") -> float:
    """The dt [s] that the gains say; ConventionError where another is given.

    why: it stands in the file and cannot be another.
    """
    if given is not None and not np.isclose(given, found, rtol=1e-3):
        raise ConventionError(
            f"dt = {given:g} s: the gains of the file say {found:g} s{why}. Leave dt away."
        )
    return found


def tau_over_r(node: nir.NIRNode) -> Any:  # noqa: ANN401
    """The dt [s] of tools that write r = tau/dt; None for what has no tau."""
    if isinstance(node, CURRENT_BASED):
        return float64(node.tau_mem) / float64(node.r)
    if isinstance(node, nir.LIF):
        return float64(node.tau) / float64(node.r)
    return None
