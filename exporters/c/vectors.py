"""Recorded numbers for the self-test: what the interpreter computes of some inferences."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, narrowest_of
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.runtime.emulator.backend import Recording
from spikedeploy.runtime.emulator.machine import Machine

# numbers of a self-test, about; at least two inferences are recorded
_NUMBERS = 60_000
_INFERENCES = 20


@dataclass(frozen=True, eq=False)
class Recorded:
    """Inferences of an episode from its beginning; S of them, each of T timesteps.

    observation: (S, obs); None where the network runs alone.
    raster: (S, T, M) input spikes.
    layers: what each layer did, name -> (S, T, N).
    action: (S, act); None likewise.
    """

    observation: NDArray[np.float64] | None
    raster: NDArray[np.uint8]
    layers: dict[str, Recording]
    action: NDArray[np.float64] | None


def observed(plan: Plan, observation: NDArray[np.float64]) -> Recorded:
    """What the interpreter makes of observations (S, obs) of one episode, with the seed 0."""
    if plan.codec is None:
        raise TypeError("a network without a codec has no observations")
    machine = Machine(plan.program, 1, "none", trace=True, backend="interpreter")
    raster = plan.codec.encode_episode(observation)
    found, actions = [], []
    for rows in raster:
        actions.append(plan.codec.decode(machine.infer(rows[None])).reshape(-1))
        found.append(machine.recordings)
    action = np.array(actions, np.float64)
    return Recorded(observation, raster, _joined(found), action)


def driven(plan: Plan, raster: NDArray[np.uint8]) -> Recorded:
    """What the interpreter makes of input spikes (S, T, M), from zero states."""
    machine = Machine(plan.program, 1, "none", trace=True, backend="interpreter")
    found = []
    for rows in raster:
        machine.infer(rows[None])
        found.append(machine.recordings)
    return Recorded(None, raster, _joined(found), None)


def few(plan: Plan, timesteps: int) -> int:
    """Inferences that make a self-test of moderate size."""
    each = timesteps * sum(plan.sizes.values())
    return int(np.clip(_NUMBERS // each, 2, _INFERENCES))


def vectors(plan: Plan, recorded: Recorded) -> str:
    """vectors.h: the recorded numbers as C."""
    out = Declarations()
    inferences, timesteps, _ = recorded.raster.shape
    rows = recorded.raster.reshape(inferences * timesteps, -1)
    reset = timesteps if plan.program.convention.state == "reset" else len(rows)
    names = [layer.name for layer in plan.program.layers]
    sizes = [plan.sizes[name] for name in names]
    at, channels = np.nonzero(rows)
    out.constant("vector_events", np.searchsorted(at, np.arange(len(rows) + 1)), "uint32_t")
    out.constant("vector_channels", _some(channels), plan.id_kind)
    if recorded.observation is None:
        out.constant("vector_times", _some(rows[at, channels]), "uint8_t")
    else:
        out.constant("vector_observation", recorded.observation.astype(np.float64))
        out.constant("vector_action", _actions(recorded))
    out.constant("vector_first", np.cumsum([0, *sizes]), "uint32_t")
    for quantity in ("current", "membrane", "spikes"):
        values = [getattr(recorded.layers[name], quantity) for name in names]
        every = np.concatenate([v.reshape(len(rows), -1).astype(np.int64) for v in values], axis=1)
        out.constant(f"vector_{quantity}", every, narrowest_of(every))
    counts = {"INFERENCES": inferences, "ROWS": len(rows), "RESET": reset, "NEURONS": sum(sizes)}
    defines = [f"#define VECTOR_{name} {value}u" for name, value in counts.items()]
    return "\n".join(["#include <math.h>", "#include <stdint.h>", "", *defines, "", out.text, ""])


def _actions(recorded: Recorded) -> NDArray[np.float64]:
    if recorded.action is None:
        raise TypeError("no actions were recorded")
    return recorded.action


def _some(values: NDArray[np.integer]) -> NDArray[np.integer]:
    """The values, or one 0: C has no empty arrays."""
    return values if values.size else np.zeros(1, np.int64)


def _joined(parts: list[dict[str, Recording]]) -> dict[str, Recording]:
    """Recordings (1, T, N) of inferences as (S, T, N)."""
    return {
        name: Recording(
            *(
                np.concatenate([getattr(part[name], quantity) for part in parts])
                for quantity in ("current", "membrane", "spikes")
            )
        )
        for name in parts[0]
    }
