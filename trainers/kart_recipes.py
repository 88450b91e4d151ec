"""The recipes of the karts: each world with a float network, a spiking one, and two controls."""

from typing import Any

WORLDS: dict[str, dict[str, Any]] = {
    "kart-grid": {},
    "kart-gazebo": {},
    "kart-steer": {},
}

# kart-simulator's networks, and what its spiking network is worth: a float one of the same size,
# and no network at all
POLICIES: dict[str, tuple[str, dict[str, Any]]] = {
    "ann": ("a float MLP with 128-128", {"kind": "mlp", "hidden": [128, 128]}),
    "snn": ("64-64 LIF neurons", {"kind": "spiking-mlp", "hidden": [64, 64]}),
    "small": ("a float MLP of the spiking one's size", {"kind": "mlp", "hidden": [64, 64]}),
    "linear": ("a linear policy", {"kind": "mlp", "hidden": []}),
}

# Seconds, not minutes: for tests and for a first look at the tools.
SMOKE: dict[str, Any] = {
    "env": {"name": "kart-grid", "count": 2},
    "steps": 256,
    "horizon": 32,
    "epochs": 2,
    "minibatch": 32,
    "critic_hidden": [16],
    "checkpoint_every": 64,
    "validation": {"every": 128, "episodes": 1, "limit": 20},
}

KARTS: dict[str, tuple[str, dict[str, Any]]] = {
    **{
        f"{world}-{name}": (
            f"{summary}, to race {world}",
            {"env": {"name": world}, "policy": policy, **settings},
        )
        for world, settings in WORLDS.items()
        for name, (summary, policy) in POLICIES.items()
    },
    "smoke-kart": (
        "a tiny spiking kart driver, seconds",
        {**SMOKE, "policy": {"kind": "spiking-mlp", "hidden": [8, 8], "timesteps": 4}},
    ),
}
