"""Pool of whole walks, labelled by the teacher: the data of imitation through time."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file
from torch import Tensor

from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.atomic import replacing
from spikedeploy.trainers.checksums import of_file
from spikedeploy.trainers.write_errors import said

Single = NDArray[np.float32]


@dataclass(frozen=True)
class Walk:
    """One episode of S control steps.

    observation: (S, obs) raw, float32
    label: (S, act) the teacher's action, or its logits, in each of them
    crashed: whether it ended by a fall or crash
    """

    observation: Single
    label: Single
    crashed: bool = False


@dataclass(frozen=True)
class Windows:
    """Parts of walks, W of them with L control steps each.

    seen: (W, L, obs) what synapses with a decaying current hold of the observation
    moved: (W, L, obs) the encoder's step times its signed events, as they arrive
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
    mean_move: NDArray[np.float64]

    def __init__(self) -> None:
        self.walks: list[Walk] = []

    def __len__(self) -> int:
        return len(self.walks)

    @property
    def steps(self) -> int:
        """Control steps of all walks together."""
        return sum(len(walk.label) for walk in self.walks)

    def add(self, walks: Iterable[Walk]) -> None:
        """Take over walks; their windows are drawn after the next `encode`."""
        self.walks += walks

    def observations(self) -> Single:
        """All observations (n, obs) one after another."""
        return np.concatenate([walk.observation for walk in self.walks])

    def encode(
        self,
        normalised: Iterable[NDArray[np.floating[Any]]],
        encoder: DeltaEncoder,
        decay: float,
        delay: int = 0,
    ) -> None:
        """Compute the events of all walks.

        normalised: (S, obs) observations of each walk
        decay: factor by which currents keep, in a control step, what events brought
        delay: control steps from an event to its arrival
        """
        rows = [np.asarray(each) for each in normalised]
        self._length = np.array([len(each) for each in rows])
        shape = self._length.max(), len(rows), encoder.observed
        moved, seen = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        step = np.where(np.isfinite(encoder.step), encoder.step, 0.0)
        held, before, levels = np.zeros(shape[1:]), np.zeros(shape[1:]), encoder.start(0)
        spikes, moves = np.zeros(encoder.observed), np.zeros(encoder.observed)
        for t in range(len(moved)):
            now = np.stack([each[min(t, len(each) - 1)] for each in rows])
            events = encoder.events(now, 1, levels)[:, 0]
            moved[t] = step * events
            held = decay * held + moved[t]
            seen[t] = held
            sizes = np.abs(events[t < self._length])
            spikes += sizes.sum(0) if encoder.code == "unary" else (sizes > 0).sum(0)
            moves += np.abs(now - before)[t < self._length].sum(0) if t else 0.0
            before = now
        self._moved, self._seen = (_by_walk(_delayed(each, delay)) for each in (moved, seen))
        self._label = torch.from_numpy(self._labels())
        self.event_rate = torch.from_numpy(spikes / self.steps).float()
        self.mean_move = moves / self.steps

    def take_observations(self) -> None:
        """Let windows hold the raw observations in `seen`, and nothing in `moved`."""
        self._length = np.array([len(walk.label) for walk in self.walks])
        longest = int(self._length.max())
        self._seen = torch.zeros(len(self.walks), longest, self.walks[0].observation.shape[1])
        for k, walk in enumerate(self.walks):
            self._seen[k, : len(walk.label)] = torch.from_numpy(walk.observation)
        self._label = torch.from_numpy(self._labels())
        self._moved = self._seen[..., :0]

    def sample(
        self, rng: np.random.Generator, count: int, window: int, burn_in: int,
        first: float, crash: float, crash_steps: int,
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
        return self.windows(which, start, window, burn_in)

    def windows(
        self, which: NDArray[np.int64], start: NDArray[np.int64], window: int, burn_in: int
    ) -> Windows:
        """Return windows of walks `which` (W,) from steps `start` (W,), -burn_in or from 0 on."""
        steps = start[:, None] + np.arange(window)
        # before the beginning nothing has happened; behind the end the last state stays
        before = torch.from_numpy(steps < 0)[:, :, None]
        at = torch.from_numpy(np.clip(steps, 0, self._moved.shape[1] - 1))
        row = torch.from_numpy(which)[:, None]
        return Windows(
            self._seen[row, at].masked_fill_(before, 0.0),
            self._moved[row, at].masked_fill_(before, 0.0),
            self._label[row, at],
            torch.from_numpy(start < 0),
        )

    def states(
        self, rng: np.random.Generator, count: int, crash: float, crash_steps: int
    ) -> tuple[Tensor, Tensor]:
        """Return raw observations (n, obs) and labels (n, act) drawn at random."""
        which = rng.integers(len(self.walks), size=count)
        crashed = np.array([k for k, walk in enumerate(self.walks) if walk.crashed])
        near = rng.random(count) < crash if len(crashed) else np.zeros(count, bool)
        which[near] = rng.choice(crashed, size=int(near.sum())) if near.any() else which[near]
        lengths = np.array([len(self.walks[k].label) for k in which])
        first = np.where(near, np.maximum(lengths - crash_steps, 0), 0)
        at = rng.integers(first, lengths)
        pairs = list(zip(which, at, strict=True))
        observation = np.stack([self.walks[k].observation[t] for k, t in pairs])
        label = np.stack([self.walks[k].label[t] for k, t in pairs])
        return torch.from_numpy(observation), torch.from_numpy(label)

    def _labels(self) -> Single:
        """Labels (W, S, act), the last of each walk repeated."""
        labels = [walk.label for walk in self.walks]
        longest = max(map(len, labels))
        padded = [np.pad(each, ((0, longest - len(each)), (0, 0)), "edge") for each in labels]
        return np.stack(padded)


def _by_walk(rows: Single) -> Tensor:
    """Return rows (S, W, ...) as (W, S, ...), in which a window lies in one piece of memory."""
    return torch.from_numpy(np.ascontiguousarray(rows.swapaxes(0, 1)))


def _delayed(rows: Single, delay: int) -> Single:
    """Return rows (S, ...) as they arrive, so many control steps late; nothing before."""
    arriving = np.zeros_like(rows)
    arriving[delay:] = rows[: len(rows) - delay]
    return arriving


def save_walks(walks: list[Walk], path: Path) -> str:
    """Write walks as a safetensors file, atomically; return its checksum."""
    arrays = {
        "observation": np.concatenate([walk.observation for walk in walks]),
        "label": np.concatenate([walk.label for walk in walks]),
        "length": np.array([len(walk.label) for walk in walks]),
        "crashed": np.array([walk.crashed for walk in walks]),
    }
    with said(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            save_file(arrays, temporary)
        return of_file(path)


def load_walks(path: Path) -> list[Walk]:
    """Read what `save_walks` wrote."""
    try:
        arrays = load_file(path)
        _check_lengths(arrays)
        ends = np.cumsum(arrays["length"])[:-1]
        seen, labels = (np.split(arrays[name], ends) for name in ("observation", "label"))
        crashed = [bool(each) for each in arrays["crashed"]]
        return [Walk(*each) for each in zip(seen, labels, crashed, strict=True)]
    except (SafetensorError, OSError, KeyError, ValueError) as error:
        raise ConfigError(
            f"{path} holds no walks that can be read ({error}). Delete the run and train again."
        ) from error


def _check_lengths(arrays: dict[str, NDArray[Any]]) -> None:
    lengths, crashed = arrays["length"], arrays["crashed"]
    rows = [(name, arrays[name]) for name in ("observation", "label")]
    if len(lengths) == 0 or lengths.min() < 1 or crashed.shape != lengths.shape:
        raise ValueError(f"it has {lengths.size} lengths of walks and {crashed.size} ends")
    for name, array in rows:
        if array.ndim != 2 or array.dtype != np.float32 or len(array) != lengths.sum():
            raise ValueError(
                f"{name} is {array.dtype} {array.shape}, expected float32 ({lengths.sum()}, n)"
            )
