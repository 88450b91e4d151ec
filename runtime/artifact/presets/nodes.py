"""Pieces of presets: nodes with other parameters, and demands that tools make on them."""

import copy
from collections.abc import Callable
from typing import Any

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError
from spikedeploy.runtime.graph.neurons import ROUNDING

Values = NDArray[np.float64]


def stated(
    tool: str,
    default: float,
    **options: Any,  # noqa: ANN401
) -> Callable[[object, float | None], Convention]:
    """The convention of a tool that has a dt of its own, unless it is given."""

    def convention(_: object, dt: float | None) -> Convention:
        source = f"as {tool} reads it" if dt is None else f"dt given, otherwise as {tool} reads it"
        return Convention(default if dt is None else dt, source=source, **options)

    return convention


def changed(node: nir.NIRNode, **parameters: object) -> nir.NIRNode:
    """The node with other parameters."""
    other = copy.copy(node)
    for name, value in parameters.items():
        setattr(other, name, value)
    return other


def values(field: NDArray[Any]) -> Values:
    """A parameter in float64, where products do not round visibly."""
    return field.astype(np.float64)


def share(tau: NDArray[Any], convention: Convention) -> Values:
    """What of a difference a timestep makes up: 1 minus the decay."""
    step = convention.dt / values(tau)
    return -np.expm1(-step) if convention.integrator == "exponential" else step


def with_gain(node: nir.NIRNode, convention: Convention, gain: Values | float = 1.0) -> nir.NIRNode:
    """The neuron for which an input comes into the current or membrane times this."""
    if isinstance(node, (nir.IF, nir.I)):
        return changed(node, r=np.full(node.r.shape, 1.0) * gain / convention.dt)
    if isinstance(node, (nir.LIF, nir.LI)):
        return changed(node, r=gain / share(node.tau, convention))
    return changed(
        node, r=1 / share(node.tau_mem, convention), w_in=gain / share(node.tau_syn, convention)
    )


def at_rest(node: nir.NIRNode) -> nir.NIRNode:
    """The neuron with a reset to 0, as tools understand it that leave v_reset out."""
    return changed(node, v_reset=np.zeros(node.v_threshold.shape))


def demand(sound: object, name: str, tool: str, wish: str) -> None:
    """Refuse what the tool refuses."""
    if not np.all(np.asarray(sound)):
        raise ConventionError(
            f"node {name!r}: {tool} {wish}. Change the node, or read the file without the preset."
        )


def near(
    found: NDArray[Any], wanted: Values | float, relative: float = ROUNDING[np.float32]
) -> NDArray[np.bool_]:
    """Whether numbers agree but for the rounding of float32."""
    return np.asarray(np.isclose(values(found), wanted, rtol=relative, atol=1e-12))


def same(field: NDArray[Any]) -> bool:
    """Whether all neurons of a layer have the same value."""
    return np.unique(field).size == 1


def batch_counted(node: nir.Flatten) -> nir.NIRNode:
    """A Flatten whose axes are read as if the batch were the first of them."""
    start, end = int(node.start_dim), int(node.end_dim)
    return changed(node, start_dim=max(start - 1, 0), end_dim=end - 1 if end > 0 else end)
