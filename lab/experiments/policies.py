"""Policies played in batches of robots, with what they did: on a chip, with 8-bit weights, or not.

Episodes begin with seeds that no training and no choice of a policy has seen.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from lab.experiments.intervals import nested_ratio
from spikedeploy import envs
from spikedeploy.comparison.statistics import Estimate
from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.policies import run_record
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.export_run import kind_of
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.distill.teachers import teacher
from spikedeploy.trainers.policies import PrunedMlpPolicy
from spikedeploy.trainers.policies.policy import PrunedWeight
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse import walks
from spikedeploy.trainers.sparse.walks import BatchController, Episodes, Stateless

EPISODES = 100
Counts = dict[str, float]
Array = NDArray[Any]


@torch.no_grad()
def in_bits(policy: PrunedMlpPolicy, bits: int) -> PrunedMlpPolicy:
    """Round a policy's weights to integers of so many bits, and return it.

    The largest weight of a matrix fills the range. Weights that are rounded to 0 cost no
    operations. Inputs, units and biases stay as they are.
    """
    for matrix in policy.modules():
        if isinstance(matrix, PrunedWeight) and matrix.weight.numel():
            weight = matrix.weight * matrix.mask
            most = weight.abs().max().clamp(min=torch.finfo(weight.dtype).tiny)
            scale = most / (2 ** (bits - 1) - 1)
            steps = torch.round(weight / scale)
            matrix.weight.copy_(steps * scale)
            matrix.mask.copy_(steps != 0)
    return policy


class EmulatedPolicy:
    """A spiking policy on an emulated chip, for a batch of robots."""

    def __init__(self, file: Path, name: str) -> None:
        self.artifact = load(file)
        self._spiking = SpikingController(self.artifact, chip(name), ledger="each")
        self.act_batch = self._spiking.act_batch

    def reset(self, robots: int) -> None:
        """Start an episode of each robot."""
        self._spiking.reset(0)

    @property
    def inputs(self) -> Counts:
        """Input neurons, and timesteps of a control step."""
        codec = self.artifact.codec
        assert codec is not None
        return {"inputs": codec.encoder.width, "timesteps": codec.timesteps}

    @property
    def neurons(self) -> int:
        """Neurons of all layers."""
        return sum(self._spiking.ledger.neurons)

    def counts(self, lengths: Sequence[int]) -> Counts:
        """Return means per control step of episodes of these lengths, in one batch.

        Robots at their end keep their place in the batch; what they do there does not count.
        """
        ledger, longest = self._spiking.ledger, max(lengths)
        rows = ledger.counts.reshape(longest, len(lengths), *ledger.counts.shape[1:])
        mean = rows[is_running(lengths)].sum(axis=0) / sum(lengths)  # (L, E)
        events = dict(zip(EVENTS, mean.sum(axis=0).tolist(), strict=True))
        readouts = [name in ledger.readouts for name in ledger.layers]
        return {
            "sops": events["sop"],
            "spikes": events["spike_out"],
            "updates": events["neuron_update"],
            "readout_updates": float(mean[readouts, EVENTS.index("neuron_update")].sum()),
            "saturations": events["saturation"],
        }


class InEightBits:
    """The pruned float network of a run, its weights rounded to 8 bits, for a batch of robots."""

    def __init__(self, run: Path, file: Path) -> None:
        policy = RunFolder(run).policy("best")
        assert isinstance(policy, PrunedMlpPolicy)
        origin = run_record.origin(run, "best")
        self._network = OnnxController(to_onnx(in_bits(policy, 8), origin, file, kind_of(policy)))

    def reset(self, robots: int) -> None:
        """Start an episode of each robot."""
        self._seen: list[Array] = []

    def act_batch(self, observation: Array) -> Array:
        """Return actions (B, act) for observations (B, obs)."""
        self._seen.append(observation.astype(np.float64))
        return self._network.replay(observation)

    def counts(self, lengths: Sequence[int]) -> Counts:
        """Return multiplications by inputs that are not 0, per control step."""
        seen = np.stack(self._seen)[is_running(lengths)]
        return {"sops": self._network.effective_macs(seen) or 0.0}


def is_running(lengths: Sequence[int]) -> NDArray[np.bool_]:
    """Return (longest, B): whether each robot's episode still runs in each control step."""
    return np.arange(max(lengths))[:, None] < np.array(lengths)


def play(env: str, policy: BatchController, episodes: int = EPISODES) -> tuple[list[float], Counts]:
    """Return the returns of as many episodes in one batch, and what a policy that counts did."""
    batch = Episodes(EnvConfig(name=env), episodes)
    _, returns, _ = batch.play(range(EVALUATION, EVALUATION + episodes), policy)
    count: Callable[[Sequence[int]], Counts] | None = getattr(policy, "counts", None)
    return [float(each) for each in returns], count(batch.lengths) if count else {}


def of_teacher(name: str, env: str) -> Stateless:
    """Return what a teacher does: its actions, or the choice of its largest logit."""
    found = teacher(name, env)
    if isinstance(_actions(env), gymnasium.spaces.Discrete):
        return Stateless(lambda seen: found.act_all(seen).argmax(-1))
    return Stateless(found.act_all)


def at_random(env: str) -> Stateless:
    """Return actions drawn at random, the lower bound of a return."""
    space: Any = _actions(env)
    chooses = isinstance(space, gymnasium.spaces.Discrete)
    count = int(space.n) if chooses else space.shape[0]
    return walks.random_actions(count, chooses, np.random.default_rng(0))


def idle(env: str) -> Stateless:
    """Return actions of 0, the middle of their range."""
    (count,) = _actions(env).shape
    return Stateless(lambda seen: np.zeros((len(seen), count)))


def _actions(env: str) -> Any:  # noqa: ANN401
    world = envs.make(env)
    world.close()
    return world.action_space


def share_of_teacher(scores: ArrayLike, taught: ArrayLike, random: ArrayLike) -> Estimate:
    """Return returns (S, n) of S trainings over the teacher's (n,) in the same episodes.

    Where the teacher's mean is negative, of the way from the mean of random actions to it.
    """
    teacher_scores = np.asarray(taught, np.float64)
    lowest = float(np.mean(np.asarray(random))) if teacher_scores.mean() < 0 else 0.0
    return nested_ratio(np.asarray(scores, np.float64) - lowest, teacher_scores - lowest)
