"""Shaping: extra weights of reward terms in training, beside the reward that is reported."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.env_batch import Steps


def check_shaping(weights: Mapping[str, float], env: EnvConfig) -> None:
    """Raise ConfigError if the environment's reward lacks one of the terms."""
    if not weights:
        return
    terms = _terms(env)
    unknown = sorted(set(weights) - set(terms))
    if unknown:
        raise ConfigError(
            f"shaping names {', '.join(unknown)}, which the reward of {env.name} does not have: "
            + (f"its terms are {', '.join(terms)}" if terms else "it has no named terms")
        )


def shaped(weights: Mapping[str, float], steps: Steps) -> NDArray[np.float64]:
    """Return the reward of each step (B,) with the extra weights."""
    # r' = r + sum over terms of weight x term
    extra = [_weighted(weights, info["reward_terms"]) for info in steps.infos] if weights else 0.0
    return steps.reward + extra


def _weighted(weights: Mapping[str, float], terms: Mapping[str, float]) -> float:
    return sum(weight * terms[name] for name, weight in weights.items())


def _terms(env: EnvConfig) -> Iterable[str]:
    """Return the names of the reward's terms, which the info of a first step has."""
    probe = envs.make(env.name, **env.options)
    probe.reset(seed=0)
    found: Mapping[str, float] = probe.step(np.zeros(probe.action_space.shape))[4].get(
        "reward_terms", {}
    )
    probe.close()
    return list(found)
