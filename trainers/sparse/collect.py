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
    """Copies of an environment for whole episodes.

    earned: what the episodes of the last call of `play` brought, one for each seed
    """

    def __init__(self, config: EnvConfig, count: int, limit: int | None = None) -> None:
        self._envs: list[Any] = [envs.make(config.name, **config.options) for _ in range(count)]
        self._limit = limit
        self.earned: list[Earned] = []

    def play(
        self,
        seeds: Sequence[int],
        controller: BatchController,
        label: Callable[[FloatArray], FloatArray] | None = None,
    ) -> tuple[list[Walk], list[float], list[dict[str, Any]]]:
        """Return walks (none without `label`), returns and last infos, one for each seed.

        label: what to imitate in observations (B, obs): actions or logits (B, act)
        """
        walks: list[Walk] = []
        returns: list[float] = []
        infos: list[dict[str, Any]] = []
        self.earned = []
        for at in range(0, len(seeds), len(self._envs)):
            found = self._together(seeds[at : at + len(self._envs)], controller, label)
            walks += found[0]
            returns += found[1]
            infos += found[2]
        return walks, returns, infos

    def _together(
        self,
        seeds: Sequence[int],
        controller: BatchController,
        label: Callable[[FloatArray], FloatArray] | None,
    ) -> tuple[list[Walk], list[float], list[dict[str, Any]]]:
        chosen = self._envs[: len(seeds)]
        now = np.stack([e.reset(seed=int(s))[0] for e, s in zip(chosen, seeds, strict=True)])
        controller.reset(len(seeds))
        seen: list[FloatArray] = []
        labels: list[FloatArray] = []
        lengths, totals = np.zeros(len(seeds), np.int64), np.zeros(len(seeds))
        infos: list[dict[str, Any]] = [{} for _ in seeds]
        ended = np.zeros(len(seeds), np.bool_)
        crashed = np.zeros(len(seeds), np.bool_)
        terminal = np.zeros(len(seeds), np.bool_)
        rewards: list[list[float]] = [[] for _ in seeds]
        while not ended.all() and len(seen) != self._limit:
            seen.append(now.copy())
            if label is not None:
                labels.append(label(now))
            # robots at their end keep their place in the batch: states belong to places
            actions = controller.act_batch(now)
            for k in np.flatnonzero(~ended):
                now[k], reward, terminated, truncated, infos[k] = chosen[k].step(actions[k])
                totals[k] += reward
                rewards[k].append(reward)
                lengths[k] += 1
                ended[k], terminal[k] = terminated or truncated, terminated
                crashed[k] = terminated and not infos[k].get("success", False)
        self.earned += [
            Earned(np.array(each, np.float32), now[k].astype(np.float32), bool(terminal[k]))
            for k, each in enumerate(rewards)
        ]
        if label is None:
            return [], totals.tolist(), infos
        arrays = [np.stack(rows, axis=1).astype(np.float32) for rows in (seen, labels)]
        walks = [
            Walk(*(rows[k, :n] for rows in arrays), crashed=bool(crashed[k]))
            for k, n in enumerate(lengths)
        ]
        return walks, totals.tolist(), infos
