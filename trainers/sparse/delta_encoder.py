"""Steps of the encoder, by what the walks of a pool show."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from spikedeploy.trainers.policies import DeltaSnnPolicy
from spikedeploy.trainers.sparse.settings import SparseConfig
from spikedeploy.trainers.sparse.walks import WalkPool

FloatArray = NDArray[np.float64]
_WINDOWS = 256  # on which sensitivities are measured
_PROJECTIONS = 8
_MIN_STEP, _MAX_STEP = 0.1, 4.0  # [standard deviations]
_SAMPLE = 20_000  # states that show whether an observation is binary
_RARE = 2  # states: a value that fewer have is an outlier, as of a force that is nearly always zero
_SWING = 1e-2  # between two values; below it they are one value with noise


def binary_columns(observation: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Mask (obs,) of observations that take exactly two values, each repeatedly, as contacts do."""
    some = observation[:: max(1, len(observation) // _SAMPLE)]
    found = np.array([_is_binary(column) for column in some.T], np.bool_)
    # a sample may lack the rest of the values
    found[found] = [_is_binary(column) for column in observation.T[found]]
    return found


def _is_binary(column: NDArray[np.floating[Any]]) -> bool:
    low, high = column.min(), column.max()
    ends = np.count_nonzero(column == low), np.count_nonzero(column == high)
    return bool(sum(ends) == len(column) and min(ends) >= _RARE and high - low >= _SWING)


def choose_steps(
    policy: DeltaSnnPolicy, pool: WalkPool, binary: NDArray[np.bool_], config: SparseConfig
) -> FloatArray:
    """Return steps (obs,) of equal marginal cost, with the configured geometric mean.

    An event costs its fan-out F, and E|dx| / step of them are sent; the error of the actions grows
    with (step^2 / 12) H, where H = E |d action / d x|^2. The least error for the operations is at

        step ~ (F E|dx| / H)^(1/3)

    Steps of binary observations, and of those that nothing reads, stay as they are.
    """
    step: FloatArray = policy.step.double().numpy().copy()
    fan_out = policy.into.fan_out + policy.past.fan_out if policy.skip else policy.into.fan_out
    matters = _sensitivity(policy, pool, config)
    cost = fan_out.numpy() * pool.mean_move
    chosen = (cost > 0) & (matters > 0) & ~binary
    if not chosen.any():
        return step
    wanted = np.cbrt(cost[chosen] / matters[chosen])
    wanted *= config.step / np.exp(np.log(wanted).mean())
    step[chosen] = np.clip(wanted, _MIN_STEP, _MAX_STEP)
    return step


def _sensitivity(policy: DeltaSnnPolicy, pool: WalkPool, config: SparseConfig) -> FloatArray:
    """Mean squared gradient H (obs,) of the actions, from random projections of them."""
    batch = pool.sample(np.random.default_rng(0), _WINDOWS, config.window, config.burn_in)
    seen = batch.seen.clone().requires_grad_(True)
    moved = batch.moved.clone().requires_grad_(True)
    mean, _ = policy.unrolled(seen, moved, policy.weights(), 0, batch.begins)
    action = torch.tanh(mean[:, config.burn_in :])
    total = torch.zeros(policy.observations)
    generator = torch.Generator().manual_seed(0)
    for _ in range(_PROJECTIONS):
        noise = torch.randn(action.shape, generator=generator)
        found = torch.autograd.grad(
            (action * noise).sum(), (seen, moved), retain_graph=True, allow_unused=True
        )
        total += sum(each.square().sum((0, 1)) for each in found if each is not None)
    return (total / (_PROJECTIONS * action.shape[0] * action.shape[1])).double().numpy()
