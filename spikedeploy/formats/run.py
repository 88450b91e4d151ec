"""Run folders: the best checkpoint of a training run, played in torch as it was trained."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from envs.rollout import Rollout
from runtime.errors import ConfigError
from spikedeploy.costs import Costs
from spikedeploy.policies import FLOAT, Candidate, env_id
from spikedeploy.runs import settings


class TorchController:
    """A policy as its trainer holds it, float32."""

    def __init__(self, run: str) -> None:
        import torch

        from trainers.run_folder import load_policy

        torch.set_num_threads(1)
        self._torch = torch
        self.policy = load_policy(run)

    def reset(self, seed: int) -> None:
        """Nothing to reset: each action is an inference of its own."""

    def act(self, observation: NDArray[np.float64]) -> NDArray[np.float64]:
        """The action (act,)."""
        action: NDArray[np.float64] = self.replay(observation[None])[0]
        return action

    def replay(self, observations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Actions (S, act) for the observations (S, obs) of an episode."""
        batch = self._torch.as_tensor(observations, dtype=self._torch.float32)
        with self._torch.inference_mode():
            return np.asarray(self.policy(batch).numpy(), np.float64)


def describe(path: Path) -> Candidate:
    """The candidate in a run folder."""
    from trainers.run_folder import load_policy

    policy = load_policy(path)
    return Candidate(
        path=str(path),
        name=path.resolve().name,
        kind="snn" if policy.kind == "popsan" else "ann",
        format="run",
        env=env_id(settings(path)["env"]["name"]),
        observed=policy.observations,
        actions=policy.actions,
    )


def controller(
    candidate: Candidate, chip: str | None, env: gymnasium.Env[Any, Any], sampled: bool
) -> TorchController:
    """The policy, loaded; a chip needs the exported file."""
    if chip not in (None, FLOAT):
        raise ConfigError(
            f"{candidate.path} is a run folder, which no chip runs; export it first: "
            f"spikedeploy export {candidate.path} --to nir"
        )
    return TorchController(candidate.path)


def costs(controller: TorchController, played: Rollout) -> Costs:
    """Not counted: costs belong to the exported file that would be deployed."""
    return Costs()
