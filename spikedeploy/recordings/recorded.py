"""The episodes of a report as JSON: float ANN, spiking network in float and on the chip."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spikedeploy.comparison.comparison import Comparison
from spikedeploy.comparison.lineup import Entry
from spikedeploy.make_env import make_env
from spikedeploy.recordings.episode import NetworkTrace, RecordedEpisode, record
from spikedeploy.recordings.packed import packed, packed_bits
from spikedeploy.recordings.tracks import tracks

_MOST_BYTES = 2_600_000  # of all episodes: a page of 3 MB opens at once and can be sent
_MOST_BITS = 4_000_000  # of a raster: larger ones are left out, by name
_MOST_MEMBRANES = 300_000  # numbers of a layer's membranes, likewise


def of_comparison(
    comparison: Comparison, main: int, options: Mapping[str, Any], table: str
) -> list[dict[str, Any]]:
    """The first episode of a row and its worst one, beside those of its references.

    main   place of the row
    table  of the energy
    """
    row = comparison.rows[main]
    line = [*reversed(row.entry.references), row.entry]
    first, worst = comparison.seeds[0], comparison.seeds[int(np.argmin(row.returns))]
    seeds = {"first episode": first}
    if worst != first:
        seeds["worst episode"] = worst
    found = recorded(comparison.env, options, line, seeds, table)
    while len(found) > 1 and len(json.dumps(found)) > _MOST_BYTES:
        found.pop()
    return found


def recorded(
    env: str,
    options: Mapping[str, Any],
    entries: Sequence[Entry],
    seeds: Mapping[str, int],
    table: str,
) -> list[dict[str, Any]]:
    """An episode of all entries for each seed.

    entries  in the order of the page; the last is the one that the page is about
    seeds    title -> seed
    table    of the energy
    """
    world = make_env(env, dict(options))
    found = []
    for title, seed in seeds.items():
        played = [record(world, e.candidate, e.chip, e.label, seed, table) for e in entries]
        found.append({"title": title, "seed": seed, **_episode(played)})
    world.close()
    return found


def _episode(played: Sequence[RecordedEpisode]) -> dict[str, Any]:
    last = played[-1]
    twin = next((each for each in played[:-1] if each.network is not None), None)
    return {
        "period": last.period,
        "scene": last.shapes,
        "players": [_player(each, each is last) for each in played],
        "distance": None if twin is None else packed(_apart(last, twin)),
        "twin": twin is not None,
        "first_spike": None if twin is None else first_difference(last, twin),
    }


def _player(each: RecordedEpisode, whole: bool) -> dict[str, Any]:
    """What the page draws of a player; spikes and membranes of the last one alone."""
    played = each.played
    actions = played.action.reshape(played.steps, -1)
    return {
        "label": each.label,
        "kind": each.kind,
        "steps": played.steps,
        "total": played.total,
        "success": played.success,
        "ended": "terminal state" if played.terminated else "time limit",
        "every": each.every,
        "poses": packed(each.poses) if len(each.poses) else None,
        "reward": packed(played.reward),
        "actions": packed(actions),
        "tracks": tracks(played.info),
        "network": network(each.network) if each.network and whole else None,
    }


def network(trace: NetworkTrace) -> dict[str, Any]:
    """Spikes, membranes, operations and energy; what is too large is left out, by name."""
    layers, left_out = [], []
    for name, raster in trace.rasters.items():
        steps, timesteps, neurons = raster.shape
        if raster.size > _MOST_BITS:
            left_out.append(f"{name}: {neurons:,} neurons")
            continue
        kept = trace.membranes.get(name)
        layers.append(
            {
                "name": name,
                "timesteps": timesteps,
                "spikes": packed_bits(raster.reshape(steps * timesteps, neurons)),
                "count": int(np.count_nonzero(raster)),
                "membranes": packed(kept)
                if kept is not None and kept.size <= _MOST_MEMBRANES
                else None,
            }
        )
    return {
        "layers": layers,
        "left_out": left_out,
        "sops": None if trace.sops is None else packed(trace.sops),
        "energy": None if trace.energy is None else packed(trace.energy),
    }


def _apart(one: RecordedEpisode, other: RecordedEpisode) -> "np.ndarray[Any, Any]":
    """(S,) root mean square of the difference of their observations, until one ends."""
    steps = min(one.played.steps, other.played.steps)
    seen = one.played.observation[:steps] - other.played.observation[:steps]
    apart: np.ndarray[Any, Any] = np.sqrt(np.mean(seen.reshape(steps, -1) ** 2, axis=1))
    return apart


def first_difference(one: RecordedEpisode, other: RecordedEpisode) -> dict[str, Any] | None:
    """The first spike of a layer that only one of two networks has; None where there is none.

    Both start alike, so until then they observe the same.
    """
    if one.network is None or other.network is None:
        return None
    found = []
    for place, (name, raster) in enumerate(one.network.rasters.items()):
        twin = other.network.rasters.get(name)
        if twin is None:
            continue
        steps = min(len(raster), len(twin))
        differs = np.argwhere((raster[:steps] != 0) != (twin[:steps] != 0))
        if len(differs):
            step, timestep, neuron = differs[0].tolist()
            found.append((step, timestep, place, name, neuron))
    if not found:
        return None
    step, timestep, _, name, neuron = min(found)
    return {"step": step, "timestep": timestep, "layer": name, "neuron": neuron}
