"""The recipes: what to train, as differences from the defaults in `trainers.config`."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from spikedeploy.trainers.distill_recipes import DISTILL
from spikedeploy.trainers.kart_recipes import KARTS


@dataclass(frozen=True)
class Recipe:
    """One named way of training.

    algorithm: key of `trainers.ALGORITHMS`
    summary: one line for people
    settings: nested settings that differ from the algorithm's defaults
    """

    algorithm: str
    summary: str
    settings: Mapping[str, Any]


def merged(settings: Mapping[str, Any], *changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return `settings` with every nested change laid over it, later ones last."""
    result = dict(settings)
    for change in changes:
        for key, value in change.items():
            old = result.get(key)
            nested = isinstance(old, Mapping) and isinstance(value, Mapping)
            result[key] = merged(old, value) if nested else value  # type: ignore[arg-type]
    return result


POPSAN: dict[str, Any] = {"policy": {"kind": "popsan"}}
MLP: dict[str, Any] = {"policy": {"kind": "mlp"}}
NARROW: dict[str, Any] = {"policy": {"hidden": [256, 256]}, "critic_hidden": [256, 256]}

# The seed's table is the default of `SacConfig`; the ramps are those of the walking task.
HEXAPOD: dict[str, Any] = {"env": {"name": "hexapod"}}

# Commands are wider and rougher: the gait must leave the hoist early and move less violently.
COMMAND: dict[str, Any] = {
    "env": {"name": "hexapod-command"},
    "support_force": {"finish": 60_000},
    "temperature": {"begin": 40_000, "finish": 120_000},
    "mean_penalty": 0.15,
    "steps": 250_000,
    "validation": {"episodes": 8},
}

# Seconds, not minutes: for tests and for a first look at the tools.
SMOKE: dict[str, Any] = {
    "env": {"name": "hexapod", "count": 2},
    "policy": {"hidden": [16, 16]},
    "critic_hidden": [16, 16],
    "steps": 240,
    "warm_up": 80,
    "batch": 16,
    "buffer": 1_000,
    "normaliser": {"finish": 160},
    "log_every": 40,
    "checkpoint_every": 80,
    "validation": {"every": 120, "episodes": 1, "limit": 20},
}

RECIPES: dict[str, Recipe] = {
    "hexapod-sac": Recipe("sac", "float MLP 77-512-512-18 that walks", merged(HEXAPOD, MLP)),
    "hexapod-sac-256": Recipe(
        "sac", "float MLP 77-256-256-18 that walks", merged(HEXAPOD, MLP, NARROW)
    ),
    "hexapod-popsan": Recipe(
        "sac", "PopSAN 77-770-512-512-180-18 that walks", merged(HEXAPOD, POPSAN)
    ),
    "hexapod-popsan-256": Recipe(
        "sac", "PopSAN 77-770-256-256-180-18 that walks", merged(HEXAPOD, POPSAN, NARROW)
    ),
    "hexapod-command-sac": Recipe(
        "sac", "float MLP 77-512-512-18 that follows commands", merged(COMMAND, MLP)
    ),
    "hexapod-command-popsan": Recipe(
        "sac", "PopSAN 77-770-512-512-180-18 that follows commands", merged(COMMAND, POPSAN)
    ),
    "smoke": Recipe("sac", "a tiny float MLP, seconds", merged(SMOKE, MLP)),
    "smoke-popsan": Recipe(
        "sac", "a tiny PopSAN, seconds", merged(SMOKE, POPSAN, {"policy": {"populations": 3}})
    ),
    **{name: Recipe("distill", summary, settings) for name, (summary, settings) in DISTILL.items()},
    **{name: Recipe("ppo", summary, settings) for name, (summary, settings) in KARTS.items()},
}
