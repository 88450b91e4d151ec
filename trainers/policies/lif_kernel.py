"""A LIF layer's passes forward and back as compiled loops over time, where Numba is installed.

They compute what `neurons.cuba_lif` computes with torch, in the same order and without fused
multiply-adds, so that spikes and gradients have the same bits.
"""

from importlib.util import find_spec
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.runtime.families.cuba_numba.jit import kept_on_disk

Array = NDArray[np.floating[Any]]

_INSTALLED = find_spec("numba") is not None


def usable(tensor: Tensor) -> bool:
    """Return whether the loops can run: Numba is there, and the tensor is in main memory."""
    return _INSTALLED and tensor.device.type == "cpu"


def membranes(drive: Tensor, alpha: float, beta: float, threshold: float) -> Tensor:
    """Return the membranes (T, B, N) before the reset; arguments as of `neurons.cuba_lif`.

    drive: in float32 or float64, the type of the result
    """
    result = torch.empty_like(drive, memory_format=torch.contiguous_format)
    x, v = _rows(drive), _rows(result)
    rounded = np.array([alpha, beta, threshold]).astype(x.dtype)
    _integrate(x, rounded[0], rounded[1], rounded[2], np.zeros((2, x.shape[1]), x.dtype), v)
    return result


def gradients(
    membrane: Tensor, slope: Tensor, upstream: Tensor, alpha: float, beta: float, threshold: float
) -> Tensor:
    """Return the gradient (T, B, N) of the drive; arguments as of `neurons._gradients`."""
    v, ds, g = _rows(membrane), _rows(slope), _rows(upstream)
    rounded = np.array([alpha, beta, threshold]).astype(v.dtype)
    _differentiate(v, g, rounded[0], rounded[1], rounded[2], np.zeros((2, v.shape[1]), v.dtype), ds)
    return slope


def _rows(tensor: Tensor) -> Array:
    """Return a tensor (T, B, N) as an array (T, B N), which shares its memory if contiguous."""
    rows: Array = tensor.detach().contiguous().numpy().reshape(len(tensor), -1)
    return rows


@kept_on_disk
def _integrate(
    drive: Array,
    alpha: np.floating[Any],
    beta: np.floating[Any],
    threshold: np.floating[Any],
    state: Array,
    membrane: Array,
) -> None:
    """Write the membranes (T, N); `state` (2, N) holds currents, and membranes after the reset."""
    current, kept = state[0], state[1]
    for t in range(drive.shape[0]):
        for n in range(drive.shape[1]):
            # I = alpha I + x ; V = beta V + I ; s = V > threshold ; V = (1 - s) V
            current[n] = alpha * current[n] + drive[t, n]
            v = beta * kept[n] + current[n]
            membrane[t, n] = v
            # a zero of the same type
            kept[n] = v - v if v > threshold else v


@kept_on_disk
def _differentiate(
    membrane: Array,
    upstream: Array,
    alpha: np.floating[Any],
    beta: np.floating[Any],
    threshold: np.floating[Any],
    state: Array,
    result: Array,
) -> None:
    """Write the gradients (T, N) over ds/dV; `state` holds those of currents and membranes."""
    to_current, to_membrane = state[0], state[1]
    for t in range(membrane.shape[0] - 1, -1, -1):
        for n in range(membrane.shape[1]):
            v, slope = membrane[t, n], result[t, n]
            # dV'/dV = (1 - s) - V ds/dV, V' the membrane after the reset
            passed = (v <= threshold) - v * slope
            g = slope * upstream[t, n] + to_membrane[n] * passed
            to_membrane[n] = g * beta
            to_current[n] = g + to_current[n] * alpha
            result[t, n] = to_current[n]
