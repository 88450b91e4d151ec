"""Recipes for any environment: the command line names it, `train CartPole-v1 --recipe ppo-snn`.

They learn gymnasium's CartPole and Pendulum within minutes on one core; harder tasks need more
steps, with which the schedules are stretched, and wider layers.
"""

from spikedeploy.trainers.recipe import Recipe, Settings, merged

# for a vector whose scale and meaning nobody knows: the normaliser sees the first quarter of the
# steps, and populations cover two standard deviations of it on either side
_SPIKING_MLP: Settings = {
    "kind": "spiking-mlp",
    "hidden": [64, 64],
    "coding": "population",
    "populations": 8,
    "reach": 2.0,
    "timesteps": 8,
}

_PPO: Settings = {
    "env": {"name": "", "count": 8},
    "steps": 100_000,
    "horizon": 128,
    "normaliser": {"finish": 25_000},
    "actor_rate": {"start": 1e-3, "end": 0.0, "finish": 100_000},
    "entropy": {"start": 0.01, "end": 0.0, "finish": 70_000},
    "temperature": {"start": 1.0, "end": 0.1, "begin": 40_000, "finish": 70_000},
    "critic_hidden": [64, 64],
    "validation": {"every": 10_000, "episodes": 10},
    "ghosts": False,
}

# rewards of any size: the temperature is learned
_SAC: Settings = {
    "env": {"name": "", "count": 1},
    "steps": 20_000,
    "warm_up": 1_000,
    "update_every": 1,
    "batch": 128,
    "critic_hidden": [128, 128],
    "learning_rate": 1e-3,
    "temperature": {"start": 0.2, "end": 0.02, "begin": 5_000, "finish": 15_000},
    "learn_temperature": True,
    "mean_penalty": 0.0,
    "averaging": 1e-3,
    "normaliser": {"finish": 5_000},
    "support_force": {"start": 0.0, "end": 0.0, "finish": 0},
    "precision": "float32",
    "validation": {"every": 2_000, "episodes": 10},
    "checkpoint_every": 10_000,
}

_DISTILL: Settings = {
    "env": {"name": "", "count": 4},
    "iterations": 4,
    "states": 4_000,
    "updates": 4_000,
    "normaliser": {"finish": 4_000},
    "precision": "float32",
    "validation": {"every": 500, "episodes": 10},
}

# a chip's integers are computed by the interpreter, so batches are small and updates few
_FOR_CHIP: Settings = {
    "env": {"name": "", "count": 8},
    "iterations": 4,
    "states": 2_000,
    "updates": 1_200,
    "batch": 64,
    "learning_rate": 5e-3,
    "noise": 0.3,
    "rate_penalty": 0.0,
    "input_penalty": 0.0,
    "sharpness": 3.0,
    "normaliser": {"finish": 8_000, "clip": 2.0},
    "precision": "float32",
    "validation": {"every": 300, "episodes": 20},
}

_FLOAT: Settings = {"kind": "mlp", "hidden": [64, 64]}

# episodes that end early are short: windows before their ends show what keeps the robot up
_SPARSE: Settings = {
    "env": {"name": ""},
    "budget": 300,
    "teacher_walks": 40,
    "noisy_walks": 20,
    "walks": 25,
    "crash_windows": 0.2,
    "validation": {"episodes": 20},
}

# as far-sighted as the teachers are
_TUNED: Settings = {"env": {"name": ""}, "gamma": 0.99, "validation": {"episodes": 20}}

_EVENTS: Settings = {"kind": "delta-snn", "hidden": 64}

ANY_ENV_RECIPES: dict[str, Recipe] = {
    name: Recipe(algorithm, summary, merged(settings, {"policy": policy}), any_env=True)
    for name, algorithm, summary, settings, policy in (
        ("ppo-mlp", "ppo", "any ENV: a float MLP with 64-64", _PPO, _FLOAT),
        ("ppo-snn", "ppo", "any ENV: 64-64 LIF neurons, population code", _PPO, _SPIKING_MLP),
        ("sac-mlp", "sac", "any ENV with continuous actions: a float MLP with 64-64", _SAC, _FLOAT),
        (
            "sac-popsan",
            "sac",
            "any ENV with continuous actions: a PopSAN with 64-64",
            _SAC,
            {"kind": "popsan", "hidden": [64, 64]},
        ),
        (
            "distill-snn",
            "distill",
            "any ENV: 64-64 LIF neurons, from a teacher; see `distill`",
            merged(_DISTILL, {"noise": 0.1}),
            _SPIKING_MLP,
        ),
        (
            "for-chip",
            "distill",
            "any ENV: trained in the integers of a chip, from a teacher; see `train --for`",
            _FOR_CHIP,
            {"kind": "chip-snn"},
        ),
        (
            "distill-popsan",
            "distill",
            "any ENV with continuous actions: a PopSAN with 256-256, --set teacher=RUN",
            _DISTILL,
            {"kind": "popsan", "hidden": [256, 256]},
        ),
        (
            "distill-sparse",
            "sparse",
            "any ENV: events into 64 LIF neurons, pruned to --budget sops=N, --set teacher=RUN",
            _SPARSE,
            _EVENTS,
        ),
        (
            "distill-sparse-tuned",
            "sparse-ppo",
            "any ENV: reward after a run of distill-sparse, --set start=RUN",
            _TUNED,
            _EVENTS,
        ),
        (
            "distill-small-mlp",
            "sparse",
            "any ENV: control, a float MLP, pruned to --budget macs=N, --set teacher=RUN",
            _SPARSE,
            {"kind": "pruned-mlp", "hidden": [64]},
        ),
        (
            "distill-small-linear",
            "sparse",
            "any ENV: control, a float linear policy, pruned to --budget macs=N",
            _SPARSE,
            {"kind": "pruned-mlp", "hidden": []},
        ),
    )
}
