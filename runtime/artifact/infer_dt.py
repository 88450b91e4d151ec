"""The timestep that a file was written with, where NIR leaves it out but the gains betray it.

Tools that discretise by forward Euler write r = tau_mem/dt and w_in = tau_syn/dt, so that all gains
are 1; then dt = tau_mem/r in every neuron, and w_in dt / tau_syn = 1 confirms it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.graph.neurons import CURRENT_BASED, INTEGRATORS, NEURONS, rounding

USUAL = "the file does not say: NIR's usual"


@dataclass(frozen=True)
class Timestep:
    """What the gains of a graph say about dt.

    dt: [s], or None where they say nothing or contradict each other.
    reason: a clause for people that says from what, or why not.
    confirmed: whether a second equation, that of w_in, agrees.
    """

    dt: float | None
    reason: str
    confirmed: bool = False


def timestep(graph: nir.NIRGraph) -> Timestep:
    """The dt for which every gain of the graph is 1, if there is one."""
    neurons = {n: node for n, node in sorted(graph.nodes.items()) if isinstance(node, NEURONS)}
    if not neurons:
        return Timestep(None, "no node of the graph has a time constant")
    if any((node.r <= 0).any() for node in neurons.values()):
        return Timestep(None, "a gain r is not above 0")
    every = np.concatenate([_candidates(node) for node in neurons.values()])
    if not np.isfinite(every).all() or not every.min() > 0:
        return Timestep(None, "tau/r is too large or too small for a number")
    tolerance = max(rounding(node) for node in neurons.values())
    dt = _rounded(float(np.median(every)), tolerance)
    for name, node in neurons.items():
        if doubt := _doubt(node, dt, tolerance):
            return Timestep(None, f"in node {name!r} {doubt}")
    confirmed = any(isinstance(node, CURRENT_BASED) for node in neurons.values())
    return Timestep(dt, f"dt = tau/r in {', '.join(neurons)}", confirmed)


def _doubt(node: nir.NIRNode, dt: float, tolerance: float) -> str:
    """What speaks against this dt, or nothing."""
    found = _candidates(node)
    if np.abs(found / dt - 1).max() > tolerance:
        return f"tau/r is {found.min():g} s and not {dt:g} s"
    # a leaky membrane has tau > dt; r = 1 is the gain of a tool that leaves dt out of r
    if not isinstance(node, INTEGRATORS) and (node.r <= 1).any():
        return f"r is {node.r.min():g}, a gain and not tau/dt"
    if isinstance(node, CURRENT_BASED):
        gain = dt * node.w_in / node.tau_syn
        if np.abs(gain - 1).max() > tolerance:
            return f"w_in dt/tau_syn is {gain.max():g}, not 1"
    return ""


def inferred_convention(graph: nir.NIRGraph, given: Mapping[str, Any]) -> Convention:
    """NIR's usual discretisation, with the dt of the gains unless it is given."""
    if "dt" in given:
        return Convention(given["dt"], source=USUAL).with_options(given)
    evidence = timestep(graph)
    if evidence.dt is None:
        raise ArtifactError(
            f"the file does not say its timestep and it cannot be inferred: {evidence.reason}. "
            "Give dt in seconds, as the tool that wrote the file used it, or name the tool whose "
            "reading is wanted."
        )
    return Convention(evidence.dt, source=f"{evidence.reason}; {USUAL}").with_options(given)


def _candidates(node: nir.NIRNode) -> NDArray[np.float64]:
    """The dt of each neuron for which the gain of its membrane is 1."""
    with np.errstate(over="ignore", under="ignore"):
        if isinstance(node, INTEGRATORS):
            return np.ravel(1 / node.r)
        tau = node.tau_mem if isinstance(node, CURRENT_BASED) else node.tau
        return np.ravel(tau / node.r)


def _rounded(dt: float, tolerance: float) -> float:
    """The dt that people meant, where only the rounding of the file's number type hides it."""
    short = float(f"{dt:.4g}")
    return short if abs(short / dt - 1) <= tolerance else dt
