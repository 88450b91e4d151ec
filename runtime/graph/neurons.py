"""The difference equation that a NIR neuron becomes under a convention.

    I[t] = a I[t-1] + gain x[t]          a = 1 - dt/tau_syn  or  exp(-dt/tau_syn)
    V[t] = b V[t-1] + I[t] + leak        b = 1 - dt/tau_mem  or  exp(-dt/tau_mem)
    gain = (1-a) w_in (1-b) r            leak = (1-b) v_leak
    spike where V[t] > threshold, then V[t] = v_reset  or  V[t] - (threshold - v_reset)

The gain of the membrane, (1-b) r, is applied to the input, once for all timesteps. Neurons without
a synaptic current have a = 0; integrators without a leak have b = 1, and dt r for (1-b) r.
"""

from dataclasses import dataclass

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ConventionError

Array = NDArray[np.float64]

LEAKY = (nir.LIF, nir.LI)
CURRENT_BASED = (nir.CubaLIF, nir.CubaLI)
INTEGRATORS = (nir.IF, nir.I)
SPIKING = (nir.LIF, nir.CubaLIF, nir.IF)
NEURONS = (*LEAKY, *CURRENT_BASED, *INTEGRATORS)

# Relative rounding error of parameters by their dtype. Exporters write r = tau/dt and w_in = tau/dt
# for a gain of 1; a gain that differs from 1 by no more than this is taken as exactly 1, so that
# results equal bit for bit those of a simulator without that multiplication.
ROUNDING = {np.float16: 1e-2, np.float32: 1e-5, np.float64: 1e-9}


@dataclass(frozen=True, eq=False)
class DiscreteNeuron:
    """Coefficients of the neurons of one node; each array has the shape of its parameters, (*N).

    current_decay: decay factor a of the current, or None where the input itself is the current.
    membrane_decay: decay factor b of the membrane.
    gain: factor of the input.
    leak: added to the membrane in every timestep.
    threshold: or None where neurons do not spike and the membrane is the output.
    v_reset: membrane after a spike.
    """

    current_decay: Array | None
    membrane_decay: Array
    gain: Array
    leak: Array
    threshold: Array | None
    v_reset: Array

    def flat(self) -> "DiscreteNeuron":
        """The same neurons along one axis (N,), in C order."""
        return DiscreteNeuron(
            current_decay=None if self.current_decay is None else self.current_decay.ravel(),
            membrane_decay=self.membrane_decay.ravel(),
            gain=self.gain.ravel(),
            leak=self.leak.ravel(),
            threshold=None if self.threshold is None else self.threshold.ravel(),
            v_reset=self.v_reset.ravel(),
        )


@np.errstate(over="ignore", invalid="ignore")
def discretise(name: str, node: nir.NIRNode, convention: Convention) -> DiscreteNeuron:
    """The difference equation of a node of one of the kinds NEURONS.

    Raises ConventionError where the convention cannot step it: dt > tau under forward Euler, a gain
    or leak that overflows, several spikes of a zero threshold. `name` is for messages.
    """
    current_decay = None
    gain = _array(node.r)
    leak = np.zeros_like(gain)
    if isinstance(node, INTEGRATORS):
        membrane_decay = np.ones_like(gain)
        gain = convention.dt * gain
    else:
        tau = "tau" if isinstance(node, LEAKY) else "tau_mem"
        membrane_decay, complement = _decay(name, node, tau, convention)
        leak = complement * _array(node.v_leak)
        gain = complement * gain
    if isinstance(node, CURRENT_BASED):
        current_decay, complement = _decay(name, node, "tau_syn", convention)
        gain = complement * _array(node.w_in) * gain
    if not np.isfinite(gain).all() or not np.isfinite(leak).all():
        raise ConventionError(
            f"node {name!r}: at dt = {convention.dt:g} s its gain or leak is too large for "
            "float64. Correct its parameters, or choose another dt."
        )
    gain[np.abs(gain - 1) <= rounding(node)] = 1.0
    if convention.spikes == "many" and isinstance(node, SPIKING):
        _check_spike_height(name, node)
    threshold = _array(node.v_threshold) if isinstance(node, SPIKING) else None
    v_reset = _array(node.v_reset) if isinstance(node, SPIKING) else np.zeros_like(gain)
    return DiscreteNeuron(current_decay, membrane_decay, gain, leak, threshold, v_reset)


def _check_spike_height(name: str, node: nir.NIRNode) -> None:
    if not (node.v_threshold > node.v_reset).all():
        raise ConventionError(
            f"node {name!r}: its threshold is not above v_reset, so that spikes 'many' would be "
            "infinitely many. Raise the threshold, or choose spikes 'above'."
        )


def rounding(node: nir.NIRNode) -> float:
    """Relative rounding error of a neuron's parameters, from their dtype."""
    return ROUNDING.get(node.r.dtype.type, ROUNDING[np.float64])


def _decay(name: str, node: nir.NIRNode, field: str, convention: Convention) -> tuple[Array, Array]:
    """The decay factor of one timestep, and 1 minus it computed without cancellation."""
    with np.errstate(over="ignore"):
        step = convention.dt / _array(getattr(node, field))
    if convention.integrator == "exponential":
        return np.exp(-step), -np.expm1(-step)
    # for tau = dt, rounding may put dt/tau slightly above 1
    if step.max() > 1 + rounding(node):
        raise ConventionError(
            f"node {name!r}: dt = {convention.dt:g} s is longer than {field} = "
            f"{convention.dt / step.max():g} s, and forward Euler would overshoot. "
            "Choose a shorter dt, or the exponential integrator."
        )
    step = np.minimum(step, 1.0)
    return 1 - step, step


def _array(values: NDArray[np.generic]) -> Array:
    return values.astype(np.float64)
