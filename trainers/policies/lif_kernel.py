"""The forward pass of a LIF layer as one compiled loop, where Numba is installed.

The loop computes what `neurons.cuba_lif` computes with torch, in the same order and without fused
multiply-adds, so that membranes and spikes have the same bits. The backward pass stays torch's,
whose kernels round some sums of products once, which Numba cannot be told to do.
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


def usable(drive: Tensor) -> bool:
    """Return whether `membranes` can run: Numba is there, and the drive is in main memory."""
    return _INSTALLED and drive.device.type == "cpu"


def membranes(drive: Tensor, alpha: float, beta: float, threshold: float) -> Tensor:
    """Return the membranes (T, B, N) before the reset; arguments as of `neurons.cuba_lif`.

    drive: in float32 or float64, the type of the result
    """
    result = torch.empty_like(drive, memory_format=torch.contiguous_format)
    x, v = (each.numpy().reshape(len(drive), -1) for each in (drive.contiguous(), result))
    rounded = np.array([alpha, beta, threshold]).astype(x.dtype)
    _integrate(x, rounded[0], rounded[1], rounded[2], np.zeros((2, x.shape[1]), x.dtype), v)
    return result


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
