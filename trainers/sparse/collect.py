"""Walks of teacher and students: whole episodes, several at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.sparse.pool import Single, Walk

FloatArray = NDArray[np.float64]
Label = Callable[[FloatArray], FloatArray]


class BatchController(Protocol):
    """A controller of B robots at once."""

    def reset(self, robots: int) -> None:
        """Start an episode of each."""

    def act_batch(self, observation: FloatArray) -> NDArray[Any]:
        """Return actions (B, act), or (B,) if discrete."""


class Stateless:
    """Actions that depend on the observation alone, as a BatchController."""

    def __init__(self, act: Callable[[FloatArray], NDArray[Any]]) -> None:
        self.act_batch = act

    def reset(self, robots: int) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class Earned:
    """What an episode of S control steps brought.

    reward: (S,) float32
    final: (obs,) observation after the last step, float32
    terminated: whether that was a terminal state, and not the time limit
    """

    reward: Single
    final: Single
    terminated: bool


class Episodes:
    """Copies of an environment, for whole episodes of at most `limit` control steps.

    earned: what the episodes of the last call of `play` brought, one for each seed
    """

    def __init__(self, config: EnvConfig, count: int, limit: int | None = None) -> None:
        self._envs: list[Any] = [envs.make(config.name, **config.options) for _ in range(count)]
        self._limit = limit
        self.earned: list[Earned] = []

    def play(
        self, seeds: Sequence[int], controller: BatchController, label: Label | None = None
    ) -> tuple[list[Walk], list[float], list[dict[str, Any]]]:
        """Return walks (none without `label`), returns and last infos, one for each seed.

        label: what to imitate in observations (B, obs): actions or logits (B, act)
        """
        walks: list[Walk] = []
        returns: list[float] = []
        infos: list[dict[str, Any]] = []
        self.earned = []
        for at in range(0, len(seeds), len(self._envs)):
            batch = _Batch(self._envs, seeds[at : at + len(self._envs)])
            walks += self._walks(batch, controller, label)
            returns += batch.totals.tolist()
            infos += batch.infos
            self.earned += batch.earned()
        return walks, returns, infos

    def _walks(
        self, batch: "_Batch", controller: BatchController, label: Label | None
    ) -> list[Walk]:
        """Play the episodes of a batch to their ends."""
        seen: list[FloatArray] = []
        labels: list[FloatArray] = []
        controller.reset(len(batch.now))
        while not batch.ended.all() and len(seen) != self._limit:
            seen.append(batch.now.copy())
            if label is not None:
                labels.append(label(seen[-1]))
            batch.step(controller.act_batch(seen[-1]))
        return batch.cut(np.stack(seen, 1), np.stack(labels, 1)) if labels else []


class _Batch:
    """Episodes side by side; those that ended keep their places, as states belong to places.

    now: (B, obs) latest observations
    totals: (B,) returns so far
    ended: (B,) whether each has ended
    infos: of the last step of each
    """

    def __init__(self, copies: Sequence[Any], seeds: Sequence[int]) -> None:
        self._envs = copies[: len(seeds)]
        pairs = zip(self._envs, seeds, strict=True)
        self.now: FloatArray = np.stack([env.reset(seed=int(seed))[0] for env, seed in pairs])
        self.totals = np.zeros(len(seeds))
        self.infos: list[dict[str, Any]] = [{} for _ in seeds]
        self.ended = np.zeros(len(seeds), np.bool_)
        self._crashed = np.zeros(len(seeds), np.bool_)
        self._terminal = np.zeros(len(seeds), np.bool_)
        self._rewards: list[list[float]] = [[] for _ in seeds]
        self._lengths = np.zeros(len(seeds), np.int64)

    def step(self, actions: NDArray[Any]) -> None:
        """Take one step of each episode that has not ended."""
        for k in np.flatnonzero(~self.ended).tolist():
            self.now[k], reward, terminated, truncated, self.infos[k] = self._envs[k].step(
                actions[k]
            )
            self.totals[k] += reward
            self._rewards[k].append(reward)
            self._terminal[k] = terminated
            self._lengths[k] += 1
            self.ended[k] = terminated or truncated
            self._crashed[k] = terminated and not self.infos[k].get("success", False)

    def cut(self, seen: FloatArray, labels: FloatArray) -> list[Walk]:
        """Return each walk up to its end, from observations and labels (B, S, ...)."""
        shown, wanted = seen.astype(np.float32), labels.astype(np.float32)
        ends = zip(self._lengths, self._crashed, strict=True)
        return [Walk(shown[k, :n], wanted[k, :n], bool(fell)) for k, (n, fell) in enumerate(ends)]

    def earned(self) -> list[Earned]:
        """Return what each episode brought."""
        ends = zip(self._rewards, self.now.astype(np.float32), self._terminal, strict=True)
        return [Earned(np.array(r, np.float32), now, bool(end)) for r, now, end in ends]
