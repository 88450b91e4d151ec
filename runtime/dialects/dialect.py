"""A tool's import and export of NIR as data, and the steps from one neuron to another.

A `Preset` translates a graph into one that means here what the original means in the tool that
reads it. It refuses what the tool refuses, and what NIR cannot express. A `Writer` translates a
graph into one with its author's meaning; some of what a network does is in no file, so its
convention names what was assumed. An `Importer` is what a network is rewritten for.
"""

import copy
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeAlias

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.graph.discretisation import (
    CURRENT_BASED,
    ROUNDING,
    SPIKING,
    DiscreteNeuron,
    float64,
)

Nodes: TypeAlias = dict[str, nir.NIRNode]
Edges: TypeAlias = set[tuple[str, str]]
EdgeList: TypeAlias = list[tuple[str, str]]
Kinds: TypeAlias = tuple[type[nir.NIRNode], ...]
Values = NDArray[np.float64]
Translate: TypeAlias = Callable[[str, nir.NIRNode, Convention], nir.NIRNode]


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
    kinds: Kinds
    convention: Callable[[Nodes], Convention]
    translate: Translate
    source: str
    options: tuple[str, ...] = ()
    remark: str = ""
    wire: Callable[[Nodes, Edges, Convention], None] = lambda nodes, edges, convention: None


class Assumption(NamedTuple):
    """An option that the tool's files leave open.

    choices: its values, the tool's default first.
    words: description of the default, and when to choose another.
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
        Without words it is the dt of all its files.
    tolerance: relative, within which nodes agree on dt.
    contradiction: why no other dt than the stated one can be given.
    fixed: options of Convention that are the same in all its files.
    open: options that its files do not state.
    always: further assumptions on its files, which no option changes.
    wire: (nodes, edges, convention) to what the options mean for these nodes, and what the tool
        has between and in them, changed in place.
    finite: a node to one that says the same without infinite numbers.
    """

    tool: str
    kinds: Kinds
    timestep: Callable[[str, nir.NIRNode], Any]
    translate: Translate
    source: str
    default_timestep: tuple[float, str] | None = None
    tolerance: float = 1e-5
    contradiction: str = ""
    fixed: Mapping[str, Any] = field(default_factory=dict)
    open: Mapping[str, Assumption] = field(default_factory=dict)
    always: tuple[str, ...] = ()
    wire: Callable[[Nodes, Edges, Convention], Convention] = lambda nodes, edges, convention: (
        convention
    )
    finite: Callable[[nir.NIRNode], nir.NIRNode] = lambda node: node


@dataclass(frozen=True)
class Importer:
    """The constraints of a tool's import, which a network is rewritten for.

    uniform: True if all neurons of a layer have one threshold.
    resets: that it can be told to use; the first is its default.
    v_reset: True if it reads v_reset; else membranes are reset to 0.
    convention: ours to that of the tool, but for reset and state; by default that of its preset.
    gain: (kind, neurons) to what the tool multiplies their input by.
    finish: (node, neurons) to the node with parameters that the tool reads in a way of its own.
    arrange: nodes and edges to those of the same graph that the tool runs in the right order.
    """

    uniform: bool = True
    resets: tuple[str, ...] = ("zero",)
    v_reset: bool = False
    convention: Callable[[Convention], Convention] | None = None
    gain: Callable[[type[nir.NIRNode], DiscreteNeuron], Values] = lambda kind, neuron: np.ones_like(
        neuron.gain
    )
    finish: Callable[[nir.NIRNode, DiscreteNeuron], nir.NIRNode] = lambda node, neuron: node
    arrange: Callable[[Nodes, EdgeList], tuple[Nodes, EdgeList]] = lambda nodes, edges: (
        nodes,
        sorted(edges),
    )


# requirements of a tool


class _RefusedError(Exception):
    """The name of a node, and what the tool needs there."""


@contextmanager
def refusals(tool: str, remedy: str) -> Iterator[None]:
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


def require_values(name: str, node: nir.NIRNode, verb: str, **values: float) -> None:
    """Refuse a node with other values in these of its fields; `verb`: the tool needs or writes."""
    for parameter, value in values.items():
        if hasattr(node, parameter):
            equal = getattr(node, parameter) == value
            require(equal, name, f"{verb} {parameter} = {value:g}")


def are_integrators(nodes: Nodes, mixture: str) -> bool:
    """True if the spiking neurons are IF, False if none is; refuse a mixture."""
    spiking = {name: node for name, node in sorted(nodes.items()) if isinstance(node, SPIKING)}
    integrators = [name for name, node in spiking.items() if isinstance(node, nir.IF)]
    if integrators:
        require(len(integrators) == len(spiking), integrators[0], mixture)
    return bool(integrators)


# parameters


def is_close(
    found: NDArray[Any], wanted: Values | float, relative: float = ROUNDING[np.float32]
) -> NDArray[np.bool_]:
    """Return True where values agree up to the rounding of float32."""
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
    vars(other).update(parameters)
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


def rounded_to(dt: float, tau: Values) -> Values:
    """Time constants [s], exactly dt where the rounding of float32 alone tells them from it.

    The decay factor of dt is 0.
    """
    return np.where(np.abs(tau / dt - 1) <= 4 * np.finfo(np.float32).eps, dt, tau)


def counted_from(node: nir.NIRNode, start: Values) -> nir.NIRNode:
    """The neuron whose membrane starts at `start`, counted from there: ours start at 0."""
    ends = {n: float64(getattr(node, n)) - start for n in ("v_threshold", "v_reset")}
    leak = {} if isinstance(node, nir.IF) else {"v_leak": float64(node.v_leak) - start}
    return with_parameters(node, **ends, **leak)


def with_batch_axis(node: nir.Flatten) -> nir.NIRNode:
    """The Flatten of a tool that counts the batch as axis 0."""
    start, end = int(node.start_dim), int(node.end_dim)
    return with_parameters(node, start_dim=max(start - 1, 0), end_dim=end - 1 if end > 0 else end)


def without_padding(node: nir.SumPool2d) -> nir.NIRNode:
    """The pool of a tool that ignores its padding."""
    return with_parameters(node, padding=np.zeros(2, int))
