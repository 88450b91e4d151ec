"""Walks of teacher and students: whole episodes, several at once."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file
from torch import Tensor

from spikedeploy import envs
from spikedeploy.files import replacing
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.distill.teachers import same_teacher
from spikedeploy.trainers.run_folder import RunFolder, of_file, write_errors
from spikedeploy.trainers.sparse.config import SparseConfig

# -- Pool of whole walks, labelled by the teacher: the data of imitation through time.

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
    with write_errors(path):
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


# -- The pool of a run on disk: a file of walks for each collection, checked when it is read.

Sizes = tuple[int, int]  # observations and actions


def pool_file(run: Path, number: int) -> Path:
    """Return the path of a collection's walks, whether or not it exists."""
    return run / "pool" / f"{number:03d}.safetensors"


def pool_files(run: Path, count: int) -> list[Path]:
    """Return the files of a run's first `count` collections, which it needs to be resumed."""
    files = [pool_file(run, number) for number in range(count)]
    if lost := [path for path in files if not path.is_file()]:
        raise ConfigError(
            f"{lost[0]} is missing: {run} has learned from its walks and cannot go on without "
            "them. Put the file back, or train again."
        )
    return files


def collected(files: list[Path], sums: list[str], sizes: Sizes) -> list[Walk]:
    """Return the walks of files that have these checksums."""
    for path, checksum in zip(files, sums, strict=True):
        if of_file(path) != checksum:
            raise ConfigError(
                f"{path} is damaged: its content does not have the checksum in checkpoints/last. "
                "Put the file back, or train again; the policies of the run are whole: "
                f"`spikedeploy export {path.parent.parent}`."
            )
    return [walk for path in files for walk in _fitting(path, sizes)]


def walks_of(config: SparseConfig, sizes: Sizes) -> list[Walk]:
    """Return the walks of the run that the setting `pool` names."""
    run = RunFolder.find(config.pool)
    files = sorted((run.path / "pool").glob("*.safetensors"))
    if not files:
        raise ConfigError(f"{config.pool} has no pool of walks. Give a run of a sparse recipe.")
    _check_task(config, run.settings())
    return [walk for path in files for walk in _fitting(path, sizes)]


def _check_task(config: SparseConfig, source: dict[str, Any]) -> None:
    """Refuse walks of another environment, or with labels of another teacher."""
    there, here = str(source["env"]["name"]), config.env.name
    if envs.spec(there).id != envs.spec(here).id:
        raise ConfigError(
            f"pool: {config.pool} has walks in {there}, not in {here}. Give a run of its task."
        )
    labelled = str(source["teacher"])
    if not same_teacher(labelled, config.teacher):
        raise ConfigError(
            f"pool: {config.pool} has walks labelled by the teacher {labelled}, and the teacher "
            f"here is {config.teacher}. Give a run with this teacher, or set teacher={labelled}."
        )


def _fitting(path: Path, sizes: Sizes) -> list[Walk]:
    """Return the walks of a file, with observations and labels (S, obs), (S, act), all finite."""
    walks = load_walks(path)
    for walk in walks:
        found = walk.observation.shape[1], walk.label.shape[1]
        if found != sizes:
            raise ConfigError(
                f"{path} has walks of {found[0]} observations and {found[1]} actions, expected "
                f"{sizes[0]} and {sizes[1]}. Give walks of the same environment."
            )
        if not (np.isfinite(walk.observation).all() and np.isfinite(walk.label).all()):
            raise ConfigError(
                f"{path} has an observation or label that is no finite number. Put a file back "
                "that is whole, or train again."
            )
    return walks


# -- Walks of teacher and students: whole episodes, several at once.

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
