"""A LIF layer's passes forward and back as compiled loops over time, where Numba is installed.

They compute what `neurons.cuba_lif` computes with torch, in the same order and without fused
multiply-adds, so that spikes and gradients have the same bits.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.runtime.families.cuba.numba_kernels import jit

Array = NDArray[np.floating[Any]]


def usable(tensor: Tensor) -> bool:
    """Return whether the loops can run: Numba compiles, and the tensor is in main memory."""
    return _COMPILED and tensor.device.type == "cpu"


def membranes(drive: Tensor, alpha: float, beta: float, threshold: float) -> Tensor:
    """Return the membranes (T, B, N) before the reset; arguments as of `neurons.cuba_lif`.

    drive: in float32 or float64, the type of the result
    """
    x = _rows(drive)
    result = np.empty_like(x)
    _integrate(x, _constants(x, alpha, beta, threshold), _state(x), result)
    return torch.from_numpy(result).reshape(drive.shape)


def gradients(
    membrane: Tensor, slope: Tensor, upstream: Tensor, alpha: float, beta: float, threshold: float
) -> Tensor:
    """Return the gradient (T, B, N) of the drive; arguments as of `neurons._gradients`."""
    v, result = _rows(membrane), _rows(slope)
    constants = _constants(v, alpha, beta, threshold)
    _differentiate(v, _rows(upstream), constants, _state(v), result)
    return torch.from_numpy(result).reshape(slope.shape)


def _rows(tensor: Tensor) -> Array:
    """Return a tensor (T, B, N) as an array (T, B N), which shares its memory if contiguous."""
    rows: Array = tensor.detach().contiguous().flatten(1).numpy()
    return rows


def _constants(rows: Array, alpha: float, beta: float, threshold: float) -> Array:
    return np.array([alpha, beta, threshold], rows.dtype)


def _state(rows: Array) -> Array:
    return np.zeros((2, rows.shape[1]), rows.dtype)


@jit
def _integrate(drive: Array, constants: Array, state: Array, membrane: Array) -> None:
    """Write the membranes (T, N); `state` (2, N) holds currents, and membranes after the reset."""
    alpha, beta, threshold = constants[0], constants[1], constants[2]
    current, kept = state[0], state[1]
    for t in range(drive.shape[0]):
        for n in range(drive.shape[1]):
            # I = alpha I + x ; V = beta V + I ; s = V > threshold ; V = (1 - s) V
            current[n] = alpha * current[n] + drive[t, n] if alpha else drive[t, n]
            v = beta * kept[n] + current[n]
            membrane[t, n] = v
            # v - v is a zero of the same type
            kept[n] = v - v if v > threshold else v


@jit
def _differentiate(
    membrane: Array, upstream: Array, constants: Array, state: Array, result: Array
) -> None:
    """Write the gradients (T, N) over ds/dV; `state` holds those of currents and membranes."""
    alpha, beta, threshold = constants[0], constants[1], constants[2]
    to_current, to_membrane = state[0], state[1]
    for t in range(membrane.shape[0] - 1, -1, -1):
        for n in range(membrane.shape[1]):
            v, slope = membrane[t, n], result[t, n]
            # dV'/dV = (1 - s) - V ds/dV, V' the membrane after the reset
            passed = (v <= threshold) - v * slope
            g = slope * upstream[t, n] + to_membrane[n] * passed
            to_membrane[n] = g * beta
            to_current[n] = g + to_current[n] * alpha if alpha else g
            result[t, n] = to_current[n]


_COMPILED = hasattr(_integrate, "py_func")  # without Numba, the loops stay what is written here
