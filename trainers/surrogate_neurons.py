"""Spiking neurons with surrogate gradients, fused over time, and their firing rates.

Each of `cuba_lif` and `integrate_and_fire` runs a whole layer over all timesteps in one autograd
node. The forward pass is the arithmetic of files and chips; the backward pass of `cuba_lif` equals
snnTorch's `Synaptic` with reset_mechanism="zero", reset_delay=False, in which the gradient also
flows through the reset.
"""

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.numba_frame import kept_on_disk
from spikedeploy.trainers.config import require_known

Array = NDArray[np.floating[Any]]
_LOW_PRECISION = (torch.bfloat16, torch.float16)


Surrogate = Callable[[Tensor], Tensor]  # d spike / d membrane, of membrane minus threshold


def _atan(excess: Tensor, width: float) -> Tensor:
    """Return the derivative of a scaled arctangent (Fang et al. 2021), as snnTorch's `atan`."""
    # ds/dv = (alpha / 2) / (1 + (pi / 2 * alpha * (v - threshold))^2), the width is alpha
    return (excess * (math.pi / 2 * width)).square_().add_(1).reciprocal_().mul_(width / 2)


def _rectangular(excess: Tensor, width: float) -> Tensor:
    """Return one near the threshold, zero elsewhere (Tang et al. 2020)."""
    # ds/dv = |v - threshold| < width
    return (excess.abs() < width).to(excess.dtype)


def _fast_sigmoid(excess: Tensor, width: float) -> Tensor:
    """Return the derivative of x / (1 + k |x|) (Zenke and Ganguli 2018), as snnTorch's."""
    # ds/dv = 1 / (1 + k |v - threshold|)^2, the width is k
    return excess.abs().mul_(width).add_(1).square_().reciprocal_()


_SURROGATES: dict[str, tuple[Callable[..., Tensor], float]] = {
    "atan": (_atan, 2.0),
    "fast-sigmoid": (_fast_sigmoid, 25.0),
    "rectangular": (_rectangular, 0.5),
}


def surrogate(name: str, width: float | None = None) -> Surrogate:
    """Return the surrogate derivative of a spike, a function of membrane minus threshold.

    width: alpha of atan and slope of fast-sigmoid [1/membrane], half-width of rectangular
        [membrane]; None for that of its paper
    """
    function, usual = _SURROGATES[require_known(name, _SURROGATES, "surrogate")]
    if width is not None and not 0 < width < math.inf:
        raise ConfigError(f"the width of the surrogate is {width:g}; it is above 0 and finite")
    return partial(function, width=usual if width is None else width)


def spike(excess: Tensor, gradient: Surrogate) -> Tensor:
    """Return 1 where a membrane is above its threshold, else 0, with a surrogate derivative."""
    found: Tensor = _Spike.apply(excess, gradient)  # type: ignore[no-untyped-call]
    return found


class _Spike(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, excess: Tensor, gradient: Surrogate) -> Tensor:  # noqa: ANN401
        ctx.save_for_backward(excess)
        ctx.gradient = gradient
        return (excess > 0).to(excess.dtype)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:  # noqa: ANN401
        (excess,) = ctx.saved_tensors
        return upstream * ctx.gradient(excess), None


def cuba_lif(
    drive: Tensor, alpha: float, beta: float, threshold: float, gradient: Surrogate
) -> Tensor:
    """Return the spikes (T, B, N) of a current-based leaky integrate-and-fire layer at rest.

    drive: (T, B, N) weighted input of each timestep, bias included
    alpha, beta: decay factors of current and membrane per timestep; alpha 0 makes it a LIF layer
    threshold: a membrane above it spikes and is set to zero
    """
    spikes: Tensor = _CubaLif.apply(drive, alpha, beta, threshold, gradient)  # type: ignore[no-untyped-call]
    return spikes


class _CubaLif(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,  # noqa: ANN401
        drive: Tensor,
        alpha: float,
        beta: float,
        threshold: float,
        gradient: Surrogate,
    ) -> Tensor:
        state = torch.float32 if drive.dtype in _LOW_PRECISION else drive.dtype
        integrate = membranes if usable(drive) else _membranes
        membrane = integrate(drive.detach().to(state), alpha, beta, threshold)
        ctx.save_for_backward(membrane)
        ctx.constants = alpha, beta, threshold, gradient
        return (membrane > threshold).to(drive.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        (membrane,) = ctx.saved_tensors
        alpha, beta, threshold, gradient = ctx.constants
        slope = gradient(membrane - threshold)
        differentiate = gradients if usable(membrane) else _gradients
        result = differentiate(membrane, slope, upstream.to(slope.dtype), alpha, beta, threshold)
        return result.to(upstream.dtype), None, None, None, None


def _membranes(drive: Tensor, alpha: float, beta: float, threshold: float) -> Tensor:
    """Return the membranes (T, B, N) of a layer before the reset."""
    membrane = torch.empty_like(drive)
    current = torch.zeros_like(drive[0])
    previous = torch.zeros_like(drive[0])  # membrane after the reset
    # a Python number would become a tensor at every timestep, which costs more than the product
    on_current, on_membrane = (drive.new_tensor(factor) for factor in (alpha, beta))
    for x, v in zip(drive.unbind(), membrane.unbind(), strict=True):
        # I = alpha I + x ; V = beta V + I ; s = V > threshold ; V = (1 - s) V
        current = current.mul_(on_current).add_(x) if alpha else x
        torch.add(previous.mul_(on_membrane), current, out=v)
        # subtracting the values above the threshold is twice as fast as a masked fill
        torch.sub(v, functional.threshold(v, threshold, 0.0), out=previous)
    return membrane


def _gradients(
    membrane: Tensor, slope: Tensor, upstream: Tensor, alpha: float, beta: float, threshold: float
) -> Tensor:
    """Return the gradient of the drive (T, B, N) from that of the spikes; `slope` is overwritten.

    membrane, slope, upstream: (T, B, N) before the reset, d spike / d membrane, d loss / d spike
    """
    # dV'/dV = (1 - s) - V ds/dV, V' the membrane after the reset
    passed = (membrane <= threshold).to(slope.dtype).sub_(membrane * slope)
    result = slope.mul_(upstream)  # filled in place, from the last timestep to the first
    to_current, to_membrane = torch.zeros_like(membrane[0]), torch.zeros_like(membrane[0])
    on_current, on_membrane = (membrane.new_tensor(factor) for factor in (alpha, beta))
    for g, share in zip(reversed(result.unbind()), reversed(passed.unbind()), strict=True):
        # products are rounded before they are added, as in the compiled loop
        torch.mul(g.add_(to_membrane.mul_(share)), on_membrane, out=to_membrane)
        if alpha:
            to_current = g.add_(to_current * on_current)
    return result


def integrate_and_fire(drive: Tensor, threshold: float, timesteps: int) -> Tensor:
    """Return the spikes (T, B, N) of integrate-and-fire neurons with a constant drive.

    drive: (B, N) added to the membrane at every timestep
    threshold: a membrane above it spikes and is reduced by it

    Straight-through gradient: that of each spike is passed to its drive (Tang et al. 2020).
    """
    spikes: Tensor = _IntegrateAndFire.apply(drive, threshold, timesteps)  # type: ignore[no-untyped-call]
    return spikes


class _IntegrateAndFire(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,  # noqa: ANN401
        drive: Tensor,
        threshold: float,
        timesteps: int,
    ) -> Tensor:
        spikes = drive.new_empty((timesteps, *drive.shape))
        membrane = torch.zeros_like(drive)
        for t in range(timesteps):
            # v = v + A ; s = v > threshold ; v = v - threshold s
            membrane.add_(drive)
            torch.gt(membrane, threshold, out=spikes[t])
            membrane.sub_(spikes[t], alpha=threshold)
        return spikes

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        return upstream.sum(0), None, None


def firing_rates(spikes: Tensor) -> Tensor:
    """Return firing rates (B, N) of spikes (T, B, N)."""
    precise = torch.float32 if spikes.dtype == torch.bfloat16 else spikes.dtype
    return spikes.mean(0, dtype=precise)


def mean_rate(spikes: Tensor) -> Tensor:
    """Return the mean firing rate of a layer, a scalar."""
    return spikes.mean(dtype=torch.float32)


def excess_rate(rates: Iterable[Tensor], target: float) -> Tensor:
    """Return by how much mean rates exceed a target, summed over layers; zero for no layers."""
    # sum over layers of max(0, rate - target)
    return sum(((rate - target).relu() for rate in rates), start=torch.zeros(()))


# -- the passes forward and back as compiled loops over time, where Numba is installed: the same
#    sums in the same order and without fused multiply-adds, so that all bits are the same


def usable(tensor: Tensor) -> bool:
    """Return whether the loops can run: Numba compiles, and the tensor is in main memory."""
    return _COMPILED and tensor.device.type == "cpu"


def membranes(drive: Tensor, alpha: float, beta: float, threshold: float) -> Tensor:
    """Return the membranes (T, B, N) before the reset; arguments as of `cuba_lif`.

    drive: in float32 or float64, the type of the result
    """
    x = _rows(drive)
    result, state = np.empty_like(x), np.zeros((2, x.shape[1]), x.dtype)
    _integrate(x, np.array([alpha, beta, threshold], x.dtype), state, result)
    return torch.from_numpy(result).reshape(drive.shape)


def gradients(
    membrane: Tensor, slope: Tensor, upstream: Tensor, alpha: float, beta: float, threshold: float
) -> Tensor:
    """Return the gradient (T, B, N) of the drive; arguments as of `_gradients`."""
    v, result = _rows(membrane), _rows(slope)
    constants, state = (
        np.array([alpha, beta, threshold], v.dtype),
        np.zeros((2, v.shape[1]), v.dtype),
    )
    _differentiate(v, _rows(upstream), constants, state, result)
    return torch.from_numpy(result).reshape(slope.shape)


def _rows(tensor: Tensor) -> Array:
    """Return a tensor (T, B, N) as an array (T, B N), which shares its memory if contiguous."""
    rows: Array = tensor.detach().contiguous().flatten(1).numpy()
    return rows


@kept_on_disk
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


@kept_on_disk
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
