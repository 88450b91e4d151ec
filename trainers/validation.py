"""Validation: deterministic episodes without support force, which choose the best checkpoint."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from spikedeploy import envs
from spikedeploy.trainers.config import EnvConfig, PolicyConfig, ValidationConfig
from spikedeploy.trainers.policies import Policy

# info of the environment -> metric: mean over steps, root mean square, and value at the end
_MEANS = {"speed": "eval_speed"}
_SQUARES = {"speed_error": "eval_speed_rmse", "turn_error": "eval_turn_rmse"}
_LASTS = {
    "cot": "eval_cot",
    "fall": "eval_falls",
    "finish": "eval_finish",
    "crash": "eval_crash",
    "gates": "eval_gates",
}


@dataclass
class _Episode:
    """An unfinished episode."""

    env: Any
    observation: Any
    total: float = 0.0
    infos: list[dict[str, Any]] = field(default_factory=list)

    def step(self, action: Any) -> bool:  # noqa: ANN401
        """Step, and return whether the episode continues."""
        self.observation, reward, terminated, truncated, info = self.env.step(action)
        self.total += reward
        self.infos.append(info)
        return not (terminated or truncated)


class Validator:
    """Runs a policy on the validation seeds, with all episodes as one batch."""

    def __init__(self, env: EnvConfig, config: ValidationConfig) -> None:
        self._config = config
        self._envs = [envs.make(env.name, **env.options) for _ in range(config.episodes)]

    @torch.no_grad()
    def __call__(self, policy: Policy) -> dict[str, float]:
        """Return means: return, speed, cost of transport, falls, success, errors, sparsity."""
        episodes = [
            _Episode(env, env.reset(seed=self._config.first_seed + k)[0])
            for k, env in enumerate(self._envs)
        ]
        rates = []
        running = episodes
        while running:
            observation = np.stack([episode.observation for episode in running])
            latent = policy.latent(torch.from_numpy(observation).float())
            chosen = policy.decide(latent.mean)
            actions = (chosen.double() if chosen.is_floating_point() else chosen).numpy()
            rates.append([float(rate) for rate in latent.rates])
            running = [
                episode
                for episode, action in zip(running, actions, strict=True)
                if episode.step(action) and len(episode.infos) != self._config.limit
            ]
        return {**_metrics(episodes), **_sparsity(rates)}


def _metrics(episodes: list[_Episode]) -> dict[str, float]:
    """Return the metrics of the episodes, as far as the environment's infos have them."""
    result = {"eval_return": float(np.mean([episode.total for episode in episodes]))}
    steps = [info for episode in episodes for info in episode.infos]
    ends = [episode.infos[-1] for episode in episodes]
    for name, column in _MEANS.items():
        if name in ends[0]:
            result[column] = float(np.mean([info[name] for info in steps]))
    for name, column in _SQUARES.items():
        if name in ends[0]:
            result[column] = float(np.sqrt(np.mean([info[name] ** 2 for info in steps])))
    for name, column in _LASTS.items():
        if name in ends[0]:
            result[column] = float(np.mean([info[name] for info in ends]))
    if all("success" in info for info in ends):  # other people's say it at the end alone
        result["eval_success"] = float(np.mean([info["success"] for info in ends]))
    return result


def sparsities(policy: PolicyConfig) -> tuple[str, ...]:
    """Return the names of the sparsity metrics of a policy's spiking layers."""
    return tuple(f"sparsity_lif{k}" for k in range(1, policy.spiking_layers + 1))


def _sparsity(rates: list[list[float]]) -> dict[str, float]:
    """Return the sparsity of each spiking layer: the share of neuron timesteps without a spike."""
    means = np.mean(rates, axis=0)
    return {f"sparsity_lif{k}": 1.0 - float(rate) for k, rate in enumerate(means, start=1)}
