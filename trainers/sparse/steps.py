"""Steps of the delta encoder, by how much each observation matters and how often it moves.

Thresholds of a delta network, by how much each neuron's activation varies.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.trainers.policies import DeltaMlpPolicy, DeltaSnnPolicy
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import WalkPool

_WINDOWS = 256  # on which sensitivities are measured
_PROJECTIONS = 8
_SMALLEST, _LARGEST = 0.1, 4.0  # steps [standard deviations]
_STILL = 1e-3  # standard deviation of an activation that hardly varies
_SAMPLE = 20_000  # states that show whether an observation is binary
_RARE = 2  # states: a value that fewer have is an outlier, as of a force that is nearly always zero
_SWING = 1e-2  # between two values; below it they are one value with noise


def binary_columns(observation: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which observations (obs,) take exactly two values, as contacts do, and each repeatedly."""
    some = observation[:: max(1, len(observation) // _SAMPLE)]
    found = np.array([_two_values(column) for column in some.T], np.bool_)
    # a sample may lack the rest of the values
    found[found] = [_two_values(column) for column in observation.T[found]]
    return found


def _two_values(column: NDArray[np.float64]) -> bool:
    values, counts = np.unique(column, return_counts=True)
    return len(values) == 2 and counts.min() >= _RARE and values[1] - values[0] >= _SWING


def retuned(
    policy: DeltaSnnPolicy, pool: WalkPool, binary: NDArray[np.bool_], config: SparseConfig
) -> NDArray[np.float64]:
    """Return steps (obs,) of equal marginal cost, with the configured geometric mean.

    An event costs its fan-out F, and E|dx| / step of them are sent; the error of the actions grows
    with (step^2 / 12) H, where H = E |d action / d x|^2. The least error for the operations is at

        step ~ (F E|dx| / H)^(1/3)

    Steps of binary observations, and of those that nothing reads, stay as they are.
    """
    step: NDArray[np.float64] = policy.step.double().numpy().copy()
    fan_out = policy.into.fan_out + policy.past.fan_out if policy.skip else policy.into.fan_out
    matters = _sensitivity(policy, pool, config)
    cost = fan_out.numpy() * pool.mean_move
    chosen = (cost > 0) & (matters > 0) & ~binary
    if not chosen.any():
        return step
    wanted = np.cbrt(cost[chosen] / matters[chosen])
    wanted *= config.step / np.exp(np.log(wanted).mean())
    step[chosen] = np.clip(wanted, _SMALLEST, _LARGEST)
    return step


@torch.no_grad()
def tuned_thresholds(policy: DeltaMlpPolicy, pool: WalkPool, config: SparseConfig) -> Tensor:
    """Return thresholds (H,), the policy's share of the standard deviation of each activation.

    That of a neuron whose activation hardly varies stays as it is.
    """
    batch = pool.sample(
        np.random.default_rng(0), _WINDOWS, config.window, config.burn_in, 0.0, 0.0, 1
    )
    seen = batch.seen[:, config.burn_in :]
    spread = torch.relu(seen @ policy.into().T + policy.bias).std((0, 1))
    return torch.where(spread > _STILL, policy.share * spread, policy.threshold)


def _sensitivity(
    policy: DeltaSnnPolicy, pool: WalkPool, config: SparseConfig
) -> NDArray[np.float64]:
    """Mean squared gradient H (obs,) of the actions, from random projections of them."""
    batch = pool.sample(
        np.random.default_rng(0), _WINDOWS, config.window, config.burn_in, 0.0, 0.0, 1
    )
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
