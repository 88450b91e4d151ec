"""The timestep of a file, which NIR does not store, inferred from the gains of its neurons.

Tools that discretise by forward Euler write r = tau_mem/dt and w_in = tau_syn/dt, for gains of 1.
Then dt = tau_mem/r in every neuron, and w_in dt / tau_syn = 1 confirms it.
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

DEFAULT = "the file does not say: NIR's usual"


@dataclass(frozen=True)
class InferredTimestep:
    """The dt that the gains of a graph imply.

    dt: [s], or None where they imply none or contradict each other.
    reason: from which equation and nodes, or why not; a clause for messages.
    confirmed: whether the gains w_in of the synapses agree.
    """

    dt: float | None
    reason: str
    confirmed: bool = False


def infer_timestep(graph: nir.NIRGraph) -> InferredTimestep:
    """The dt for which every gain of the graph is 1, if one exists."""
    neurons = {n: node for n, node in sorted(graph.nodes.items()) if isinstance(node, NEURONS)}
    if not neurons:
        return InferredTimestep(None, "no node of the graph has a time constant")
    if any((node.r <= 0).any() for node in neurons.values()):
        return InferredTimestep(None, "a gain r is not above 0")
    candidates = np.concatenate([_candidates(node) for node in neurons.values()])
    if not np.isfinite(candidates).all() or not candidates.min() > 0:
        return InferredTimestep(None, "tau/r is too large or too small for float64")
    tolerance = max(rounding(node) for node in neurons.values())
    dt = _rounded(float(np.median(candidates)), tolerance)
    for name, node in neurons.items():
        if contradiction := _contradiction(node, dt, tolerance):
            return InferredTimestep(None, f"in node {name!r} {contradiction}")
    confirmed = any(isinstance(node, CURRENT_BASED) for node in neurons.values())
    return InferredTimestep(dt, f"dt = tau/r in {', '.join(neurons)}", confirmed)


def _contradiction(node: nir.NIRNode, dt: float, tolerance: float) -> str:
    """Why a node contradicts this dt; empty where it does not."""
    found = _candidates(node)
    if np.abs(found / dt - 1).max() > tolerance:
        return f"tau/r is {found.min():g} s and not {dt:g} s"
    # forward Euler needs tau > dt, so r > 1; tools that leave dt out of r write r = 1
    if not isinstance(node, INTEGRATORS) and (node.r <= 1).any():
        return f"r is {node.r.min():g}, a gain and not tau/dt"
    if isinstance(node, CURRENT_BASED):
        gain = dt * node.w_in / node.tau_syn
        if np.abs(gain - 1).max() > tolerance:
            return f"w_in dt/tau_syn is {gain.max():g}, not 1"
    return ""


def infer_convention(graph: nir.NIRGraph, given: Mapping[str, Any]) -> Convention:
    """NIR's usual discretisation, with the given options, and the inferred dt unless it is given.

    Raises ArtifactError where dt is neither given nor implied by the gains.
    """
    if "dt" in given:
        return Convention(given["dt"], source=DEFAULT).with_options(given)
    evidence = infer_timestep(graph)
    if evidence.dt is None:
        raise ArtifactError(
            f"the file does not say its timestep and it cannot be inferred: {evidence.reason}. "
            "Give the dt in seconds of the tool that wrote the file, or name that tool with "
            "--like."
        )
    return Convention(evidence.dt, source=f"{evidence.reason}; {DEFAULT}").with_options(given)


def _candidates(node: nir.NIRNode) -> NDArray[np.float64]:
    """The dt of each neuron for which its membrane's gain is 1."""
    with np.errstate(over="ignore", under="ignore"):
        if isinstance(node, INTEGRATORS):
            return np.ravel(1 / node.r)
        tau = node.tau_mem if isinstance(node, CURRENT_BASED) else node.tau
        return np.ravel(tau / node.r)


def _rounded(dt: float, tolerance: float) -> float:
    """The dt to four digits, where only the rounding of the file's dtype distinguishes them."""
    short = float(f"{dt:.4g}")
    return short if abs(short / dt - 1) <= tolerance else dt
