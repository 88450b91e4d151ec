"""Recipes of sparse policies, of the small float networks beside them, and of PPO after.

The teachers are the shipped ones; another is given with --set teacher=PATH.
"""

from spikedeploy.trainers.recipe import KART_ENVS, Recipe, Settings, merged

_SPARSE_STUDENTS: dict[str, tuple[str, Settings]] = {
    "sparse": ("events into LIF neurons", {"kind": "delta-snn"}),
    "sparse-linear": (
        "control: events straight into the readout",
        {"kind": "delta-snn", "hidden": 0},
    ),
    "small-mlp": ("control: float MLP, pruned", {"kind": "pruned-mlp"}),
    "small-linear": ("control: float linear policy, pruned", {"kind": "pruned-mlp", "hidden": []}),
    "delta-mlp": ("control: events into sigma-delta ReLU neurons", {"kind": "delta-mlp"}),
}

_SPARSE_TASKS: dict[str, tuple[str, Settings]] = {
    "hexapod": (
        "walks",
        {"env": {"name": "hexapod"}, "teacher": "hexapod/sac", "step": 0.8},
    ),
    "hexapod-command": (
        "follows commands",
        {"env": {"name": "hexapod-command"}, "teacher": "hexapod-command/smooth", "step": 0.8},
    ),
    # episodes are short, and whether a kart crashes changes between rounds: more of everything
    **{
        env: (
            f"races {env}",
            {
                "env": {"name": env},
                "teacher": f"{env}/ann",
                "crash_windows": 0.3,
                # a high price keeps hidden spikes rare beside the skip connection
                "penalty": 0.5,
                "penalty_floor": 50,
                "step": 0.3,
                "dense_updates": 2_000,
                "dense_rounds": 4,
                "level_updates": 1_000,
                "polish": 8,
                "polish_updates": 600,
                "polish_rate": 3e-4,
                "retune": "before-polish",
                "walks": 60,
                "validation": {"every": 600, "episodes": 200},
            },
        )
        for env in KART_ENVS
    },
}

# operations of each student at the end, and on the way there; and sizes. The students of a task
# have as many levels, so that all learn from as many walks for as many updates
_SPARSE_BUDGETS: dict[tuple[str, str], Settings] = {
    ("hexapod", "sparse"): {"budget": 56, "levels": [210, 140, 105, 84, 68], "polish": 3},
    ("hexapod", "sparse-linear"): {"budget": 50, "levels": [200, 150, 110, 85, 65], "polish": 3},
    ("hexapod", "small-mlp"): {"budget": 70, "levels": [400, 250, 180, 130, 95], "polish": 3},
    ("hexapod", "small-linear"): {"budget": 100, "levels": [600, 400, 280, 200, 140], "polish": 3},
    ("hexapod-command", "sparse"): {
        "budget": 300,
        "levels": [1_600, 1_000, 700, 480, 360],
        "rate_cost": 4_000,
        "policy": {"hidden": 128},
    },
    ("hexapod-command", "sparse-linear"): {"budget": 300, "levels": [1_200, 900, 700, 500, 400]},
    ("hexapod-command", "small-mlp"): {
        "budget": 240,
        "levels": [1_500, 800, 550, 400, 300],
        "policy": {"hidden": [48, 32]},
    },
    ("hexapod-command", "small-linear"): {"budget": 400, "levels": [1_200, 900, 700, 600, 500]},
    **{
        (env, student): settings
        for env in KART_ENVS
        for student, settings in {
            "sparse": {
                "budget": 33,
                "levels": [60, 48, 40, 36],
                "policy": {"integrated": True},
            },
            "sparse-linear": {"budget": 10, "levels": [28, 20, 16, 13]},
            "small-mlp": {
                "budget": 30,
                "levels": [60, 48, 40, 35],
                "policy": {"hidden": [8]},
            },
            "small-linear": {"budget": 30, "levels": [60, 48, 40, 35]},
            "delta-mlp": {
                "budget": 25,
                "levels": [60, 48, 40, 32],
                "policy": {"hidden": 8},
                "chip": "loihi2",
            },
        }.items()
    },
    # graded spikes run on no other chip
    ("hexapod", "delta-mlp"): {
        "budget": 70,
        "levels": [250, 180, 140, 110, 85],
        "polish": 3,
        "policy": {"hidden": 8},
        "chip": "loihi2",
    },
    ("hexapod-command", "delta-mlp"): {
        "budget": 480,
        "levels": [1_600, 1_100, 800, 650, 550],
        "rate_cost": 4_000,
        "policy": {"hidden": 64},
        "chip": "loihi2",
    },
}

_SMOKE_SPARSE: Settings = {
    "env": {"name": "hexapod", "count": 2},
    "teacher": "hexapod/sac",
    "budget": 60,
    "teacher_walks": 2,
    "noisy_walks": 1,
    "walks": 1,
    "dense_updates": 20,
    "dense_rounds": 1,
    "level_updates": 20,
    "levels": [200],
    "polish": 1,
    "polish_updates": 10,
    "prune_every": 5,
    "batch": 8,
    "log_every": 5,
    "validation": {"every": 10, "episodes": 1, "limit": 40},
}


def _sparse() -> dict[str, Recipe]:
    """Return the sparse recipes of every task and student."""
    found = {}
    for task, (verb, settings) in _SPARSE_TASKS.items():
        for student, (network, policy) in _SPARSE_STUDENTS.items():
            changes = merged(settings, {"policy": policy}, _SPARSE_BUDGETS[task, student])
            found[f"{task}-{student}"] = Recipe("sparse", f"{network}, that {verb}", changes)
    return found


# -- reward after imitation: the best policy of a sparse run, given with --set start=RUN

_SMOKE_TUNED: Settings = {
    "env": {"name": "hexapod"},
    "policy": {"kind": "delta-snn"},
    "iterations": 3,
    "warm_up": 1,
    "episodes": 2,
    "window": 16,
    "burn_in": 4,
    "batch": 4,
    "epochs": 2,
    "critic_hidden": [16],
    "checkpoint_every": 1,
    "validation": {"every": 1, "episodes": 1, "limit": 40},
}


# on the command task returns still rise behind the 60 iterations of the default
_TUNED_LENGTHS: dict[str, Settings] = {
    "hexapod-command": {"iterations": 150},
    # episodes of the karts are short, and each says little more than whether it finished; what the
    # teacher does where a student is about to crash does not save a student that acts later
    **{
        env: {
            "episodes": 48,
            "iterations": 80,
            "learns": "all",
            "imitation": 0.1,
            "budget": 34.5,
            "validation": {"every": 5, "episodes": 200},
        }
        for env in KART_ENVS
    },
}


def _tuned() -> dict[str, Recipe]:
    """Return the recipes that go on where the spiking ones of `_sparse` end."""
    found = {}
    for task, (verb, settings) in _SPARSE_TASKS.items():
        network, policy = _SPARSE_STUDENTS["sparse"]
        size = _SPARSE_BUDGETS[task, "sparse"].get("policy", {})
        length = _TUNED_LENGTHS.get(task, {})
        changes = {"env": settings["env"], "policy": {**policy, **size}, **length}
        summary = f"{network}, that {verb}: reward after a sparse run, start=RUN"
        found[f"{task}-sparse-tuned"] = Recipe("sparse-ppo", summary, changes)
    return found


SPARSE_RECIPES: dict[str, Recipe] = {
    **_sparse(),
    "smoke-sparse": Recipe(
        "sparse",
        "a tiny sparse policy, seconds",
        merged(_SMOKE_SPARSE, {"policy": {"kind": "delta-snn"}}),
    ),
    "smoke-sparse-mlp": Recipe(
        "sparse",
        "a tiny pruned float policy, seconds",
        merged(_SMOKE_SPARSE, {"policy": {"kind": "pruned-mlp", "hidden": [8]}}),
    ),
    **_tuned(),
    "smoke-sparse-tuned": Recipe("sparse-ppo", "PPO after smoke-sparse, seconds", _SMOKE_TUNED),
    "smoke-sparse-delta-mlp": Recipe(
        "sparse",
        "a tiny delta network, seconds",
        merged(_SMOKE_SPARSE, {"policy": {"kind": "delta-mlp", "hidden": 8}, "chip": "loihi2"}),
    ),
}
