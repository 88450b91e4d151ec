"""Spiking neurons for training: CuBa-LIF layers with surrogate gradients, fused over time.

Both functions run a whole layer over all its timesteps in one autograd node. The forward pass is
the arithmetic that chips and files agree on; the backward pass equals snnTorch's `Synaptic` with
reset_mechanism="zero", reset_delay=False, in which the gradient also flows through the reset.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from runtime.errors import ConfigError

LOW_PRECISION = (torch.bfloat16, torch.float16)


@dataclass(frozen=True)
class Surrogate:
    """The derivative that stands in for a spike's, as a function of membrane minus threshold.

    name: key of `SURROGATES`
    width: alpha of atan [1/membrane], half-width of rectangular [membrane]
    """

    name: str
    width: float

    def __call__(self, excess: Tensor) -> Tensor:
        """Return d spike / d membrane."""
        return SURROGATES[self.name][0](excess, self.width)


def atan(excess: Tensor, alpha: float) -> Tensor:
    """Return the derivative of a scaled arctangent (Fang et al. 2021), as snnTorch's `atan`."""
    # ds/dv = (alpha / 2) / (1 + (pi / 2 * alpha * (v - threshold))^2)
    return (excess * (math.pi / 2 * alpha)).square_().add_(1).reciprocal_().mul_(alpha / 2)


def rectangular(excess: Tensor, width: float) -> Tensor:
    """Return one near the threshold and zero elsewhere (Tang et al. 2020)."""
    # ds/dv = |v - threshold| < width
    return (excess.abs() < width).to(excess.dtype)


SURROGATES: dict[str, tuple[Callable[[Tensor, float], Tensor], float]] = {
    "atan": (atan, 2.0),
    "rectangular": (rectangular, 0.5),
}


def surrogate(name: str, width: float | None = None) -> Surrogate:
    """Return a surrogate by name; None takes the width of its paper."""
    if name not in SURROGATES:
        raise ConfigError(f"unknown surrogate '{name}': known: {', '.join(SURROGATES)}")
    return Surrogate(name, SURROGATES[name][1] if width is None else width)


def cuba_lif(
    drive: Tensor, alpha: float, beta: float, threshold: float, gradient: Surrogate
) -> Tensor:
    """Return the spikes (T, B, N) of a current-based leaky integrate-and-fire layer at rest.

    drive: (T, B, N) weighted input of each timestep, bias included
    alpha, beta: what the current and the membrane keep from one timestep to the next
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
        state = torch.float32 if drive.dtype in LOW_PRECISION else drive.dtype
        membrane = torch.empty(drive.shape, dtype=state)  # before the reset, of every timestep
        spikes = torch.empty(drive.shape, dtype=torch.bool)
        current = torch.zeros(drive.shape[1:], dtype=state)
        kept = torch.zeros(drive.shape[1:], dtype=state)
        for t in range(drive.shape[0]):
            # I = alpha I + x ; V = beta V + I ; s = V > threshold ; V = (1 - s) V
            current.mul_(alpha).add_(drive[t])
            torch.add(kept.mul_(beta), current, out=membrane[t])
            torch.gt(membrane[t], threshold, out=spikes[t])
            kept = membrane[t].masked_fill(spikes[t], 0.0)
        ctx.save_for_backward(membrane, spikes)
        ctx.constants = alpha, beta, threshold, gradient
        return spikes.to(drive.dtype)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[override]  # noqa: ANN401
        membrane, spikes = ctx.saved_tensors
        alpha, beta, threshold, gradient = ctx.constants
        slope = gradient(membrane - threshold)
        # dV'/dV = (1 - s) - V ds/dV: what the gradient of the membrane after the reset keeps
        passed = torch.addcmul((~spikes).to(slope.dtype), membrane, slope, value=-1.0)
        fired = upstream.to(slope.dtype) * slope
        result = torch.empty_like(upstream)
        to_current = torch.zeros_like(membrane[0])
        to_kept = torch.zeros_like(membrane[0])
        for t in range(len(membrane) - 1, -1, -1):
            to_membrane = torch.addcmul(fired[t], to_kept, passed[t])
            torch.add(to_membrane, to_current, alpha=alpha, out=to_current)
            result[t] = to_current
            torch.mul(to_membrane, beta, out=to_kept)
        return result, None, None, None, None


def integrate_and_fire(drive: Tensor, threshold: float, timesteps: int) -> Tensor:
    """Return the spikes (T, B, N) of neurons that integrate a constant drive, T first.

    drive: (B, N) added to the membrane at every timestep
    threshold: a membrane above it spikes and is lowered by it

    The gradient is passed straight through: each spike counts as its drive (Tang et al. 2020).
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
        spikes = torch.empty((timesteps, *drive.shape), dtype=drive.dtype)
        membrane = torch.zeros_like(drive)
        for t in range(timesteps):
            # v = v + A ; s = v > threshold ; v = v - threshold s
            membrane.add_(drive)
            torch.gt(membrane, threshold, out=spikes[t])
            membrane.sub_(spikes[t], alpha=threshold)
        return spikes

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[override]  # noqa: ANN401
        return upstream.sum(0), None, None
