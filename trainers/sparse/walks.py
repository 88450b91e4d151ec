"""Whole walks: collected from environments, their events, and windows of them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy import envs
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.run_folder import with_prefix

Single = NDArray[np.float32]
FloatArray = NDArray[np.float64]
Label = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Walk:
    """One episode of S control steps.

    observation: (S, obs) raw, float32
    label: (S, act) the teacher's action, or its logits, in each of them; (S, 0) where not asked for
    crashed: whether it ended by a fall or crash
    reward: (S,) float32; this and what follows is not in checkpoints
    final: (obs,) observation after the last step, float32
    terminated: whether that was a terminal state, and not the time limit
    """

    observation: Single
    label: Single
    crashed: bool = False
    reward: Single = field(default_factory=lambda: np.zeros(0, np.float32))
    final: Single = field(default_factory=lambda: np.zeros(0, np.float32))
    terminated: bool = False


# -- collection


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


def random_actions(count: int, discrete: bool, rng: np.random.Generator) -> Stateless:
    """Return actions (B, act) drawn from [-1, 1], or choices (B,) of so many."""

    def act(observation: FloatArray) -> NDArray[Any]:
        if discrete:
            return rng.integers(count, size=len(observation))
        return rng.uniform(-1.0, 1.0, (len(observation), count))

    return Stateless(act)


class Episodes:
    """Copies of an environment, for whole episodes of at most `limit` control steps.

    worlds: the environments behind their wrappers
    lengths: control steps of each episode of the last call of `play`
    """

    def __init__(self, config: EnvConfig, count: int, limit: int | None = None) -> None:
        self._limit = limit
        self._envs: list[Any] = [envs.make(config.name, **config.options) for _ in range(count)]
        self.worlds = [env.unwrapped for env in self._envs]
        self.lengths: list[int] = []

    def play(
        self, seeds: Sequence[int], controller: BatchController, label: Label | None = None
    ) -> tuple[list[Walk], list[float], list[dict[str, Any]]]:
        """Return walks, returns and last infos, one for each seed.

        label: what to imitate in observations (B, obs): actions or logits (B, act)
        """
        walks: list[Walk] = []
        totals: list[float] = []
        infos: list[dict[str, Any]] = []
        for at in range(0, len(seeds), len(self._envs)):
            part = seeds[at : at + len(self._envs)]
            played = self._side_by_side(part, controller, label)
            walks += played[0]
            totals += played[1]
            infos += played[2]
        self.lengths = [len(walk.reward) for walk in walks]
        return walks, totals, infos

    def _side_by_side(
        self, seeds: Sequence[int], controller: BatchController, label: Label | None
    ) -> tuple[list[Walk], list[float], list[dict[str, Any]]]:
        """Play at most an episode of each copy; those that ended keep their places."""
        copies, count = self._envs[: len(seeds)], len(seeds)
        pairs = zip(copies, seeds, strict=True)
        now: FloatArray = np.stack([env.reset(seed=int(seed))[0] for env, seed in pairs])
        totals, rewards = np.zeros(count), [list[float]() for _ in seeds]
        infos: list[dict[str, Any]] = [{} for _ in seeds]
        ended, terminal = np.zeros((2, count), np.bool_)
        seen: list[FloatArray] = []
        labels: list[FloatArray] = []
        controller.reset(count)
        while not ended.all() and len(seen) != self._limit:
            seen.append(now.copy())
            labels.append(np.zeros((count, 0)) if label is None else label(seen[-1]))
            actions = controller.act_batch(seen[-1])
            for k in np.flatnonzero(~ended).tolist():
                now[k], reward, terminal[k], truncated, infos[k] = copies[k].step(actions[k])
                totals[k] += reward
                rewards[k].append(reward)
                ended[k] = terminal[k] or truncated
        shown, wanted = (np.stack(each, 1).astype(np.float32) for each in (seen, labels))
        walks = []
        for k, (earned, last) in enumerate(zip(rewards, now.astype(np.float32), strict=True)):
            crashed = bool(terminal[k] and not infos[k].get("success", False))
            walks.append(
                Walk(
                    shown[k, : len(earned)],
                    wanted[k, : len(earned)],
                    crashed,
                    np.array(earned, np.float32),
                    last,
                    bool(terminal[k]),
                )
            )
        return walks, totals.tolist(), infos


# -- events and windows


@dataclass(frozen=True)
class Windows:
    """Parts of walks, W of them with L control steps of T timesteps each.

    seen: (W, L T, obs) what synapses with a decaying current hold of the observation
    moved: (W, L T, obs) the encoder's step times its signed events, as they arrive
    label: (W, L, act)
    begins: (W,) whether the episode begins after the burn-in
    """

    seen: Tensor
    moved: Tensor
    label: Tensor
    begins: Tensor


class WalkPool:
    """Walks of teacher and students, and their events for one setting of the encoder.

    walks: all of them
    event_rate: (obs,) mean number of input spikes in a control step
    mean_move: (obs,) mean distance between two control steps [normalised observation]
    """

    event_rate: Tensor
    mean_move: FloatArray

    def __init__(self, walks: Iterable[Walk] = ()) -> None:
        self.walks = list(walks)
        self._events: tuple[Tensor, Tensor] | None = None  # moved and seen, as they arrive
        self._rows: tuple[NDArray[Any], Single] | None = None  # of all walks, one behind another

    def __len__(self) -> int:
        return len(self.walks)

    @property
    def steps(self) -> int:
        """Control steps of all walks together."""
        return sum(len(walk.label) for walk in self.walks)

    def add(self, walks: Iterable[Walk]) -> None:
        """Take over walks; their windows are drawn after the next `encode`."""
        self.walks += walks
        self._rows = None

    def encode(
        self,
        normalised: Iterable[NDArray[np.floating[Any]]],
        encoder: DeltaEncoder,
        decay: float,
        delay: int = 0,
        timesteps: int = 1,
    ) -> None:
        """Compute the events of all walks.

        normalised: (S, obs) observations of each walk
        decay: factor by which currents keep, in a control step, what events brought
        delay: timesteps from an event to its arrival
        timesteps: timesteps of a control step
        """
        rows = [np.asarray(each) for each in normalised]
        self._take_labels()
        self._events = None  # makes room
        steps, walks, width = self._length.max(), len(rows), encoder.observed
        seen = np.zeros((walks, steps * timesteps, width), np.float32)
        moved = np.zeros_like(seen)
        step = np.where(np.isfinite(encoder.step), encoder.step, 0.0)
        held, before = np.zeros((2, walks, width))
        levels = encoder.start(0)
        spikes, distance = np.zeros((2, width))
        for t in range(steps):
            now = np.stack([each[min(t, len(each) - 1)] for each in rows])
            events = encoder.events(now, timesteps, levels)
            for at, sent in enumerate(events.swapaxes(0, 1), t * timesteps + delay):
                arriving = (step * sent).astype(np.float32)
                held = decay * held + arriving
                seen[:, at : at + 1] = held[:, None]  # nothing behind the end
                moved[:, at : at + 1] = arriving[:, None]
            sizes = np.abs(events[t < self._length])
            spikes += (sizes if encoder.code == "unary" else sizes > 0).sum((0, 1))
            distance += np.abs(now - before)[t < self._length].sum(0) if t else 0.0
            before = now
        self._events = torch.from_numpy(moved), torch.from_numpy(seen)
        self._timesteps = timesteps
        self.event_rate = torch.from_numpy(spikes / self.steps).float()
        self.mean_move = distance / self.steps

    def take_observations(self) -> None:
        """Store the raw observations in `seen` of windows, and nothing in `moved`."""
        self._take_labels()
        self._events, self._timesteps = None, 1

    def _take_labels(self) -> None:
        """Take over lengths (W,) and labels (W, S, act), the last of each walk repeated."""
        labels = [walk.label for walk in self.walks]
        self._length = np.array([len(each) for each in labels])
        missing = self._length.max() - self._length
        pairs = zip(labels, missing, strict=True)
        padded = [np.pad(each, ((0, count), (0, 0)), "edge") for each, count in pairs]
        self._label = torch.from_numpy(np.stack(padded))

    def sample(
        self, rng: np.random.Generator, count: int, window: int, burn_in: int,
        first: float = 0.0, crash: float = 0.0, crash_steps: int = 1,
    ) -> Windows:  # fmt: skip
        """Return windows drawn at random; arguments as in SparseConfig."""
        encoded = len(self._length)  # walks that came later wait for `encode`
        which = rng.integers(encoded, size=count)
        kind = rng.random(count)
        crashed = np.array([k for k in range(encoded) if self.walks[k].crashed])
        near = (kind >= first) & (kind < first + crash)
        if len(crashed):
            which[near] = rng.choice(crashed, size=int(near.sum()))
        last = np.maximum(self._length[which] - window, 1 - burn_in)
        start = rng.integers(-burn_in + 1, last + 1)
        if len(crashed):
            back = rng.integers(0, crash_steps, size=count)
            start = np.where(near, np.maximum(last - back, 1 - burn_in), start)
        start = np.where((kind < first) | (start < 0), -burn_in, start)
        return self.windows(which, start, window)

    def windows(self, which: NDArray[np.int64], start: NDArray[np.int64], window: int) -> Windows:
        """Return windows of walks `which` (W,) from steps `start` (W,), -burn_in or from 0 on."""
        steps = start[:, None] + np.arange(window)
        rows = (steps[:, :, None] * self._timesteps + np.arange(self._timesteps)).reshape(
            len(steps), -1
        )
        at = np.clip(steps, 0, self._label.shape[1] - 1)
        label = self._label[torch.from_numpy(which)[:, None], torch.from_numpy(at)]
        begins = torch.from_numpy(start < 0)
        if self._events is None:
            seen = self._observed(which, steps)
            return Windows(seen, seen[..., :0], label, begins)
        # before the beginning nothing has happened; behind the end the last state stays
        before = torch.from_numpy(rows < 0)[:, :, None]
        walk = torch.from_numpy(which)[:, None]
        arrived = torch.from_numpy(np.clip(rows, 0, self._events[0].shape[1] - 1))
        moved, seen = (each[walk, arrived].masked_fill_(before, 0.0) for each in self._events)
        return Windows(seen, moved, label, begins)

    def _observed(self, which: NDArray[np.int64], steps: NDArray[np.int64]) -> Tensor:
        """Return observations (W, L, obs) at steps (W, L); 0 outside of the walks."""
        first = self.walks[0].observation
        seen = np.zeros((*steps.shape, first.shape[1]), first.dtype)
        for row, number, at in zip(seen, which, steps, strict=True):
            observation = self.walks[number].observation
            there = (at >= 0) & (at < len(observation))
            row[there] = observation[at[there]]
        return torch.from_numpy(seen)

    def states(
        self, rng: np.random.Generator, count: int, crash: float, crash_steps: int
    ) -> tuple[Tensor, Tensor]:
        """Return raw observations (n, obs) and labels (n, act) drawn at random."""
        which = rng.integers(len(self.walks), size=count)
        crashed = np.array([k for k, walk in enumerate(self.walks) if walk.crashed])
        near = rng.random(count) < crash if len(crashed) else np.zeros(count, bool)
        which[near] = rng.choice(crashed, size=int(near.sum())) if near.any() else which[near]
        length = np.array([len(walk.label) for walk in self.walks])
        first = np.where(near, np.maximum(length[which] - crash_steps, 0), 0)
        at = (np.cumsum(length) - length)[which] + rng.integers(first, length[which])
        if self._rows is None:
            self._rows = (
                np.concatenate([walk.observation for walk in self.walks]),
                np.concatenate([walk.label for walk in self.walks]),
            )
        observation, label = (torch.from_numpy(rows[at]) for rows in self._rows)
        return observation, label


# -- walks in a checkpoint


def walk_tensors(walks: Sequence[Walk]) -> dict[str, Tensor]:
    """Return walks as tensors by name, for a checkpoint; of rewards nothing is kept."""
    arrays = {
        "observation": np.concatenate([walk.observation for walk in walks]),
        "label": np.concatenate([walk.label for walk in walks]),
        "length": np.array([len(walk.label) for walk in walks]),
        "crashed": np.array([walk.crashed for walk in walks]),
    }
    return {f"walks.{name}": torch.from_numpy(array) for name, array in arrays.items()}


def walks_of(tensors: Mapping[str, Tensor]) -> list[Walk]:
    """Return the walks of a checkpoint."""
    named = {name: tensor.numpy() for name, tensor in with_prefix("walks", tensors).items()}
    ends = np.cumsum(named["length"])[:-1]
    seen, labels = (np.split(named[name], ends) for name in ("observation", "label"))
    return [Walk(*each) for each in zip(seen, labels, map(bool, named["crashed"]), strict=True)]
