"""What a browser is told of an episode, in the form that recorded episodes have."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.recordings.episode import NetworkTrace, costs_of_each
from spikedeploy.recordings.packed import packed
from spikedeploy.recordings.recorded import network
from spikedeploy.recordings.scenes import Floats
from spikedeploy.recordings.tracks import track, tracks
from spikedeploy.runtime.emulator.ledger import Ledger

# infos of our environments, of which curves are drawn; which ones others have changes by the step
_OURS = {"command_turn", "slip", "gates"}
_MOST_NEURONS = 4096  # of a layer whose spikes are sent
_MOST_MEMBRANES = 2048  # likewise


@dataclass(frozen=True)
class WatchedInference:
    """What a network did in a control step.

    spikes     "input" and every spiking layer -> (T, N)
    membranes  layer -> (N,) after the last timestep; empty in float
    ledger     of this inference; None where it cannot be counted
    """

    spikes: Mapping[str, NDArray[Any]]
    membranes: Mapping[str, Floats]
    ledger: Ledger | None


@dataclass(frozen=True)
class WatchedStep:
    """A control step that was taken.

    number     of the step in its episode, from 0
    action     (act,) or ()
    reward     of the step
    total      return so far
    info       numbers of the environment
    pose       of the scene; None without one
    inference  of a policy that spikes
    policy     time of the policy [s]
    missed     deadlines that the policy missed so far, in all episodes
    skipped    periods so far, likewise
    """

    number: int
    action: NDArray[Any]
    reward: float
    total: float
    info: Mapping[str, float]
    pose: Floats | None
    inference: WatchedInference | None
    policy: float
    missed: int
    skipped: int


@dataclass(frozen=True)
class Message:
    """An event of the stream.

    kind  "begin", "steps", "over" or "end"
    text  as Server-Sent Events have it
    """

    kind: str
    text: bytes


def message(kind: str, data: Mapping[str, Any]) -> Message:
    """A message of JSON."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return Message(kind, f"event: {kind}\ndata: {text}\n\n".encode())


def told(batch: Sequence[WatchedStep], table: str, deadline: float) -> Message:
    """Consecutive control steps.

    table     of the energy
    deadline  [s] of the policy
    """
    last, poses = batch[-1], [step.pose for step in batch if step.pose is not None]
    data = {
        "first": batch[0].number,
        "steps": len(batch),
        "total": last.total,
        "missed": last.missed,
        "skipped": last.skipped,
        "poses": packed(poses) if poses else None,
        "reward": packed([step.reward for step in batch]),
        "actions": packed([step.action.reshape(-1) for step in batch]),
        "tracks": [_use(batch, deadline), *_curves(batch)],
        "network": _network(batch, table),
    }
    return message("steps", data)


def _use(batch: Sequence[WatchedStep], deadline: float) -> dict[str, Any]:
    """Share of the deadline that the policy took."""
    share = np.array([100 * step.policy / deadline for step in batch])
    return track("time of the policy, of its deadline", "%", share)


def _curves(batch: Sequence[WatchedStep]) -> list[dict[str, Any]]:
    if not _OURS & batch[-1].info.keys():
        return []
    return tracks({name: np.array([s.info[name] for s in batch]) for name in batch[-1].info})


def _network(batch: Sequence[WatchedStep], table: str) -> dict[str, Any] | None:
    each = [step.inference for step in batch if step.inference is not None]
    if not each:
        return None
    shown = [name for name, spikes in each[0].spikes.items() if spikes.shape[1] <= _MOST_NEURONS]
    sent = [name for name, last in each[0].membranes.items() if len(last) <= _MOST_MEMBRANES]
    sops, joules = _costs([one.ledger for one in each if one.ledger is not None], table)
    trace = NetworkTrace(
        {name: np.stack([one.spikes[name] for one in each]) for name in shown},
        {name: np.stack([one.membranes[name] for one in each]) for name in sent},
        sops,
        joules,
    )
    left = [
        f"{name}: {spikes.shape[1]:,} neurons"
        for name, spikes in each[0].spikes.items()
        if name not in shown
    ]
    return {**network(trace), "left_out": left}


def _costs(ledgers: Sequence[Ledger], table: str) -> tuple[Floats | None, Floats | None]:
    """Operations and energy [J] of each inference; None where they are not counted."""
    if not ledgers:
        return None, None
    counts = np.concatenate([ledger.counts for ledger in ledgers])
    return costs_of_each(replace(ledgers[0], counts=counts), table)
