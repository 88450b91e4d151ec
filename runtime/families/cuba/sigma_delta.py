"""One timestep of sigma-delta neurons, in floats and in Loihi 2's integers.

    sigma = sigma + W g ;  a = max(sigma + b, 0) ;  d = a - q theta
    k = sign(d) floor(|d| / theta + 1/2) where |d| >= theta, else 0 ;  q = q + k

k, a signed whole number, is sent. The weights behind the layer count it in thresholds theta.

lava's neurons send where |d| >= vth too (lava-nc 0.10.0, proc.sdn, PySigmaDeltaModelFixedCorrected:
source read), in units of 2**state_exp, rounded down, and keep sigma and what they send in 24 bits.
The unit here is theta: on a chip a multiplication by 1 / theta, which no public source shows.
"""

import numpy as np

from spikedeploy.runtime.chips.layer import Layer, LayerState, Numbers, StepResult
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters


def float_update(layer: Layer, weights: Numbers, state: LayerState) -> StepResult:
    """Advance a layer by one timestep in floats; the sum of the weights (B, N) arrives in it."""
    before = state.membrane
    state.current, state.membrane = weights, before + weights
    # e = max(sigma + b, 0) / theta - q
    apart = np.maximum(state.membrane + layer.voltage_bias, 0) / layer.threshold - state.sent
    far = np.abs(apart)
    graded = np.where(far >= 1, np.sign(apart) * np.floor(far + 0.5), 0).astype(np.int64)
    return _sent(layer, before, state, graded, np.zeros(before.shape, np.int64))


def update(
    registers: CubaRegisters, bits: int, layer: Layer, weights: Numbers, state: LayerState
) -> StepResult:
    """The same in integers, each as its register holds it; a graded spike has so many bits."""
    before = state.membrane
    drive, lost = registers.accumulator.fit_counted(weights << registers.mantissa_shift)
    state.current = drive
    state.membrane, clipped = registers.membrane.fit_counted(before + drive)
    activation, pushed = registers.push.fit_counted(state.membrane + layer.voltage_bias)
    apart = np.maximum(activation, 0) - state.sent * layer.threshold
    far = np.abs(apart)
    # floor(|d| / theta + 1/2) = (2 |d| + theta) // (2 theta)
    whole = (2 * far + layer.threshold) // (2 * layer.threshold)
    graded = np.where(far >= layer.threshold, np.sign(apart) * whole, 0)
    most = (1 << (bits - 1)) - 1
    held = np.clip(graded, -most, most)
    overflows = lost + clipped + pushed + (held != graded)
    return _sent(layer, before, state, held, overflows)


def _sent(
    layer: Layer, before: Numbers, state: LayerState, graded: Numbers, overflows: Numbers
) -> StepResult:
    """The end of a timestep: what is sent is remembered."""
    state.sent = state.sent + graded
    active = (before != 0) | (state.current != 0) | (layer.voltage_bias != 0)
    return StepResult(graded, active, overflows)
