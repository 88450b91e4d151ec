"""Run folders: the best checkpoint of a training run, in torch as it was trained."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.policies.registry import FLOAT, Candidate, Env, Floats, Player
from spikedeploy.policies.run_record import SPIKING, env_of
from spikedeploy.runtime.codec.rate import Xorshift
from spikedeploy.runtime.emulator.controllers import Sampler
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.setup import Setup

if TYPE_CHECKING:
    from torch import Tensor

    from spikedeploy.trainers.policies import Policy


class TorchController(Player):
    """A policy in torch, float32; a random encoder uses the generator of the chip.

    `sampled` draws one of several actions from the softmax of their scores; `checkpoint` is of the
    run, by default its best, else its last.
    """

    def __init__(self, run: str, sampled: bool = False, checkpoint: str | None = None) -> None:
        import torch

        torch.set_num_threads(1)
        self._torch = torch
        self.policy = policy_of(run, checkpoint)
        self._sampler = Sampler(self.policy.head == "discrete") if sampled else None
        self.reset(0)

    @classmethod
    def describe(cls, path: Path) -> Candidate:
        """The candidate in a run folder."""
        policy = policy_of(path)
        network = "control" if policy.kind.startswith("pruned") else "ann"
        return Candidate(
            path=str(path),
            name=path.resolve().name,
            kind="snn" if policy.kind in SPIKING else network,
            format="run",
            env=env_of(path),
            observed=policy.observations,
            actions=policy.actions,
        )

    @classmethod
    def open(cls, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Player:
        """The policy; a chip needs the exported file."""
        if chip not in (None, FLOAT):
            raise ConfigError(
                f"{candidate.path} is a run folder, which no chip runs; export it first: "
                f"spikedeploy export {shlex.quote(candidate.path)} --to nir"
            )
        return cls(candidate.path, setup.sampled)

    def reset(self, seed: int) -> None:
        """Seed the encoder's generator, and put states to rest; both run on between inferences."""
        from spikedeploy.trainers.policies import DeltaSnnPolicy

        self._rng = Xorshift(seed, self.policy.observations)
        self._state = self.policy.rest(1) if isinstance(self.policy, DeltaSnnPolicy) else None
        if self._sampler is not None:
            self._sampler.reset(seed)

    def replay(self, observations: Floats) -> NDArray[Any]:
        """Actions (S, act) or (S,) for the observations (S, obs) of an episode, in their order."""
        batch = self._torch.as_tensor(observations, dtype=self._torch.float32)
        with self._torch.inference_mode():
            scores = self._scores(batch)
            if self._sampler is not None:
                return self._sampler(scores.double().numpy())
            action: NDArray[Any] = self.policy.decide(scores).numpy()
        return action if self.policy.head == "discrete" else action.astype(np.float64)

    def _scores(self, batch: "Tensor") -> "Tensor":
        from spikedeploy.exporters.parity import input_spikes_of
        from spikedeploy.trainers.policies import DeltaSnnPolicy
        from spikedeploy.trainers.policies.spiking import CodedPolicy

        policy = self.policy
        if isinstance(policy, DeltaSnnPolicy) and self._state is not None:
            return self._torch.cat([policy.advance(row[None], self._state)[0] for row in batch])
        if isinstance(policy, CodedPolicy):
            spikes = input_spikes_of(policy, batch, self._rng.draw_sequence)
            return policy.forward_spikes(spikes).mean
        return policy.scores(batch)


def policy_of(run: str | Path, checkpoint: str | None = None) -> "Policy":
    """The policy of a run; ConfigError where a checkpoint does not hold what it says."""
    from spikedeploy.trainers.run_folder import load_policy

    try:
        policy = load_policy(run, checkpoint)
        float(getattr(policy.normalizer, "clip", 0.0))  # which nothing else looks at before it acts
        return policy
    # of torch, and of whatever else a value stands that is none
    except (RuntimeError, KeyError, TypeError, ValueError, AttributeError, MemoryError) as error:
        if isinstance(error, SpikedeployError):
            raise
        what = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ConfigError(
            f"{run}: checkpoint {checkpoint or 'best or last'} holds no whole policy ({what}): "
            "copy it from a backup, or take another with --checkpoint"
        ) from error
