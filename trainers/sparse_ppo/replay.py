"""Policies whose walks are played again in windows: spiking ones from events, float ones as is."""

from copy import deepcopy
from typing import Protocol

import torch
from torch import Tensor

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.trainers.policies import DeltaSnnPolicy, Policy, PrunedMlpPolicy
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import WalkPool, Windows
from spikedeploy.trainers.sparse.pruning import operations
from spikedeploy.trainers.sparse.rounding import add_offsets, rounding_offsets
from spikedeploy.trainers.sparse.students import DeltaStudent, MlpStudent


class Means(Protocol):
    """A policy in episodes of several robots, before an action is chosen."""

    def reset(self, robots: int) -> None:
        """Start an episode of each."""

    def __call__(self, observation: Tensor) -> Tensor:
        """Return the means (B, act) of one control step."""


class Replay(Protocol):
    """What PPO asks of a policy with masks.

    readout: names of the parameters behind the last hidden layer, and past it
    """

    @property
    def policy(self) -> Policy:
        """The policy that learns."""

    readout: frozenset[str]

    def round(self, target: Chip) -> None:
        """Compute with the weights that the chip would have now."""

    def acting(self) -> Means:
        """Return the policy in episodes, with the weights that are computed with."""

    def prepare(self, pool: WalkPool) -> None:
        """Make windows of new walks possible."""

    def replay(self, windows: Windows) -> tuple[Tensor, list[Tensor]]:
        """Return means and hidden activities (n, L + burn-in, ...) of windows, layer by layer."""

    def hidden(self, activities: list[Tensor]) -> Tensor:
        """Return the hidden neurons' operations for activities (..., H), with a gradient."""

    def operations(self, activities: list[Tensor]) -> float:
        """Return all operations of a control step on the walks that were prepared."""


class DeltaReplay:
    """A DeltaSnnPolicy, with the rounding of its weights; see Replay."""

    readout = frozenset({"out.weight", "past.weight", "action_bias", "_gamma"})

    def __init__(self, policy: DeltaSnnPolicy, source: SparseConfig, burn_in: int) -> None:
        self.policy, self._source, self._burn_in = policy, source, burn_in
        self.student = DeltaStudent(policy, source)

    def round(self, target: Chip) -> None:
        """Compute with the weights that the chip would have now."""
        if self._source.rounding:
            self.student.offsets = rounding_offsets(self.policy, target)

    def acting(self) -> "DeltaMeans":
        """Return the policy in episodes, with the weights that are computed with."""
        policy = deepcopy(self.policy)
        add_offsets(policy, self.student.offsets)
        return DeltaMeans(policy)

    def prepare(self, pool: WalkPool) -> None:
        """Compute the events of new walks."""
        self.student.prepare(pool)

    def replay(self, windows: Windows) -> tuple[Tensor, list[Tensor]]:
        """Return means and hidden spikes of windows."""
        mean, spikes = self.policy.unrolled(
            windows.seen, windows.moved, self.student.weights(), self._burn_in, windows.begins
        )
        return mean, [spikes]

    def hidden(self, activities: list[Tensor]) -> Tensor:
        """Return the hidden neurons' operations for spikes (n, H), with a gradient."""
        return (activities[0].mean(0) * self.policy.out.fan_out).sum()

    def operations(self, activities: list[Tensor]) -> float:
        """Return all operations of a control step on the walks that were prepared."""
        self.student.hidden_rate = activities[0].mean(0)
        return operations(self.student.synapses())


class DeltaMeans:
    """A DeltaSnnPolicy in episodes; see Means."""

    def __init__(self, policy: DeltaSnnPolicy) -> None:
        self.policy = policy

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._state = self.policy.rest(robots)

    def __call__(self, observation: Tensor) -> Tensor:
        """Return the means (B, act) of one control step."""
        return self.policy.advance(observation, self._state)[0]


class MlpReplay:
    """A PrunedMlpPolicy, which has no state: windows are observations alone; see Replay."""

    def __init__(self, policy: PrunedMlpPolicy, source: SparseConfig) -> None:
        self.policy = policy
        self.student = MlpStudent(policy, source)
        last = len(policy.matrices) - 1
        self.readout = frozenset({f"matrices.{last}.weight", f"biases.{last}", "past.weight"})

    def round(self, target: Chip) -> None:
        """Do nothing: float weights are not rounded."""

    def acting(self) -> "MlpReplay":
        """Return the policy itself."""
        return self

    def reset(self, robots: int) -> None:
        """Do nothing: there is no state."""

    def __call__(self, observation: Tensor) -> Tensor:
        """Return the means (B, act) of one control step."""
        return self.policy.activations(observation)[0]

    def prepare(self, pool: WalkPool) -> None:
        """Take the observations as they are."""
        pool.take_observations()

    def replay(self, windows: Windows) -> tuple[Tensor, list[Tensor]]:
        """Return means and hidden activations of windows."""
        count, length = windows.seen.shape[:2]
        mean, inputs = self.policy.activations(windows.seen.flatten(0, 1))
        return mean.view(count, length, -1), [x.view(count, length, -1) for x in inputs[1:]]

    def hidden(self, activities: list[Tensor]) -> Tensor:
        """Return the mean of activations (n, H) times their fan-outs, which stands for operations.

        The share of active neurons has no gradient.
        """
        matrices = [each for each in self.student.synapses() if each.matrix is not self.policy.past]
        costs = [
            (hidden.mean(0) * each.matrix.fan_out).sum()
            for hidden, each in zip(activities, matrices[1:], strict=True)
        ]
        return sum(costs, start=torch.zeros(()))

    def operations(self, activities: list[Tensor]) -> float:
        """Return all operations of a control step on the walks that were prepared."""
        rates = ((hidden > 0).float().mean(0) for hidden in activities)
        self.student.load({f"rate{number}": rate for number, rate in enumerate(rates)})
        return operations(self.student.synapses())


def replay_of(policy: Policy, source: SparseConfig, burn_in: int) -> Replay:
    """Return what PPO needs of a policy that a sparse run left."""
    if isinstance(policy, DeltaSnnPolicy):
        return DeltaReplay(policy, source, burn_in)
    if isinstance(policy, PrunedMlpPolicy):
        return MlpReplay(policy, source)
    raise TypeError(f"{type(policy).__name__} is no policy that is pruned")
