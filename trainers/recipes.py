"""Recipes: what to train, as differences from the defaults of the algorithms' configurations."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Settings = dict[str, Any]


@dataclass(frozen=True)
class Recipe:
    """What to train, and how.

    algorithm: key of `trainers.ALGORITHMS`
    summary: one line
    settings: nested settings that differ from the algorithm's defaults
    """

    algorithm: str
    summary: str
    settings: Mapping[str, Any]


def merged(settings: Mapping[str, Any], *changes: Mapping[str, Any]) -> Settings:
    """Return `settings` with nested changes applied in order."""
    result = dict(settings)
    for change in changes:
        for key, value in change.items():
            old = result.get(key)
            nested = isinstance(old, Mapping) and isinstance(value, Mapping)
            result[key] = merged(old, value) if nested else value  # type: ignore[arg-type]
    return result


# -- soft actor-critic: the hexapod; the defaults of SacConfig are tuned for walking straight

_POPSAN: Settings = {"policy": {"kind": "popsan"}}
MLP: Settings = {"policy": {"kind": "mlp"}}
_NARROW: Settings = {"policy": {"hidden": [256, 256]}, "critic_hidden": [256, 256]}

_HEXAPOD: Settings = {"env": {"name": "hexapod"}}
# A float teacher's training ends by itself; on hexapod the curve is flat by then.
_TEACHER: Settings = {"steps": 300_000}

# Following commands needs an early end of the support force and smoother actions.
_COMMAND: Settings = {
    "env": {"name": "hexapod-command"},
    "support_force": {"finish": 60_000},
    "temperature": {"begin": 40_000, "finish": 120_000},
    "mean_penalty": 0.15,
    "steps": 250_000,
    "validation": {"episodes": 8},
}

# A walker that is gentle with its motors: while it learns, power counts three times and changes of
# the action five times as much as in the published reward, by which it is judged all the same.
_SMOOTH: Settings = {
    "shaping": {"power": 2.0, "jerk": 4.0},
    "smoothness": 0.2,
    "validation": {"episodes": 16},
}

# Smoke recipes take seconds, for tests and a first look at the tools.
_SMOKE_SAC: Settings = {
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

# -- distillation: for each task the float teacher is distilled into PopSANs of two widths and into
# three controls, with the same states and updates, so that comparisons show what the spiking
# network contributes. The teacher is given with --set teacher=PATH

_STUDENTS: dict[str, tuple[str, Settings]] = {
    "distill": ("PopSAN 77-770-512-512-180-18", {"kind": "popsan"}),
    "distill-256": ("PopSAN 77-770-256-256-180-18", {"kind": "popsan", "hidden": [256, 256]}),
    "linear": ("control: linear in all observations", {"kind": "mlp", "hidden": []}),
    "phase": (
        "control: MLP 64-64 on the gait's phase alone, open loop",
        {"kind": "mlp", "hidden": [64, 64], "features": "phase"},
    ),
    "bilinear": (
        "control: phase times command, open loop",
        {"kind": "mlp", "hidden": [], "features": "bilinear"},
    ),
}

_TASKS: dict[str, tuple[str, Settings]] = {
    # walking allows sparser activity than the defaults, at no cost in return: see the card of the
    # shipped policy, spikedeploy/zoo/hexapod/popsan.md
    "hexapod": (
        "walks",
        {
            "env": {"name": "hexapod"},
            "rate_penalty": 0.2,
            "rate_target": 0.10,
            "input_penalty": 0.2,
            "input_target": 0.08,
        },
    ),
    # random commands spread returns by a few percent: more episodes choose the best checkpoint
    "hexapod-command": (
        "follows commands",
        {
            "env": {"name": "hexapod-command"},
            "iterations": 8,
            "updates": 10_000,
            "validation": {"every": 1_000, "episodes": 16},
        },
    ),
}

_SMOKE_DISTILL: Settings = {
    "env": {"name": "hexapod", "count": 2},
    "policy": {"kind": "popsan", "hidden": [16, 16], "populations": 3},
    "iterations": 2,
    "states": 60,
    "updates": 40,
    "batch": 16,
    "log_every": 5,
    "checkpoint_every": 10,
    "validation": {"every": 20, "episodes": 1, "limit": 20},
}

DISTILL: dict[str, tuple[str, Settings]] = {
    f"{task}-{student}": (f"{network} that {verb}, from a teacher", {**settings, "policy": policy})
    for task, (verb, settings) in _TASKS.items()
    for student, (network, policy) in _STUDENTS.items()
} | {"smoke-distill": ("a tiny PopSAN from a teacher, seconds", _SMOKE_DISTILL)}

# -- proximal policy optimisation: the karts

_KART_ENVS = ("kart-grid", "kart-gazebo", "kart-steer")

# kart-simulator's networks, and two controls for its spiking one: a float network of the same
# size, and a linear policy
_POLICIES: dict[str, tuple[str, Settings]] = {
    "ann": ("a float MLP with 128-128", {"kind": "mlp", "hidden": [128, 128]}),
    "snn": ("64-64 LIF neurons", {"kind": "spiking-mlp", "hidden": [64, 64]}),
    "small": ("a float MLP of the spiking one's size", {"kind": "mlp", "hidden": [64, 64]}),
    "linear": ("a linear policy", {"kind": "mlp", "hidden": []}),
}

_SMOKE_PPO: Settings = {
    "env": {"name": "kart-grid", "count": 2},
    "steps": 256,
    "horizon": 32,
    "epochs": 2,
    "minibatch": 32,
    "critic_hidden": [16],
    "checkpoint_every": 64,
    "validation": {"every": 128, "episodes": 1, "limit": 20},
}

_KARTS: dict[str, tuple[str, Settings]] = {
    **{
        f"{env}-{name}": (f"{summary}, to race {env}", {"env": {"name": env}, "policy": policy})
        for env in _KART_ENVS
        for name, (summary, policy) in _POLICIES.items()
    },
    "smoke-kart": (
        "a tiny spiking kart driver, seconds",
        {**_SMOKE_PPO, "policy": {"kind": "spiking-mlp", "hidden": [8, 8], "timesteps": 4}},
    ),
}

# -- sparse: a thousandth of the operations; and the small float networks that are their rivals. The
# teachers are the shipped ones; another is given with --set teacher=PATH

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
                # hidden spikes are dear, so that they stay rare beside the skip connection
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
        for env in _KART_ENVS
    },
}

# operations of each student at the end, and on the way there; and sizes
_SPARSE_BUDGETS: dict[tuple[str, str], Settings] = {
    ("hexapod", "sparse"): {"budget": 50, "levels": [210, 140, 105, 84, 66], "polish": 3},
    ("hexapod", "sparse-linear"): {"budget": 70, "levels": [160, 100], "walks": 25},
    ("hexapod", "small-mlp"): {"budget": 130, "levels": [400, 250, 180], "walks": 25},
    ("hexapod", "small-linear"): {"budget": 200, "levels": [600, 300], "walks": 25},
    ("hexapod-command", "sparse"): {
        "budget": 300,
        "levels": [1_600, 1_000, 700, 480, 360],
        "rate_cost": 4_000,
        "policy": {"hidden": 128},
    },
    ("hexapod-command", "sparse-linear"): {"budget": 300, "levels": [600], "walks": 25},
    ("hexapod-command", "small-mlp"): {
        "budget": 400,
        "levels": [1_500, 800, 550],
        "walks": 25,
        "policy": {"hidden": [48, 32]},
    },
    ("hexapod-command", "small-linear"): {"budget": 400, "levels": [700], "walks": 25},
    **{
        (env, student): settings
        for env in _KART_ENVS
        for student, settings in {
            "sparse": {"budget": 28, "levels": [45, 35], "policy": {"integrated": True}},
            "sparse-linear": {"budget": 10, "levels": [20, 14]},
            "small-mlp": {"budget": 30, "levels": [60, 40], "policy": {"hidden": [8]}},
            "small-linear": {"budget": 30, "levels": [60, 40]},
            "delta-mlp": {
                "budget": 25,
                "levels": [60, 40, 32],
                "policy": {"hidden": 8},
                "chip": "loihi2",
            },
        }.items()
    },
    # graded spikes run on no other chip
    ("hexapod", "delta-mlp"): {
        "budget": 70,
        "levels": [250, 160, 110, 85],
        "policy": {"hidden": 8},
        "chip": "loihi2",
    },
    ("hexapod-command", "delta-mlp"): {
        "budget": 480,
        "levels": [1_600, 1_000, 700, 560],
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


# episodes of the karts are short, and each says little more than whether it finished
_TUNED_KART: Settings = {
    "episodes": 48,
    "validation": {"every": 5, "episodes": 200},
}


def _tuned() -> dict[str, Recipe]:
    """Return the recipes that go on where the spiking ones of `_sparse` end."""
    found = {}
    for task, (verb, settings) in _SPARSE_TASKS.items():
        network, policy = _SPARSE_STUDENTS["sparse"]
        size = _SPARSE_BUDGETS[task, "sparse"].get("policy", {})
        length = _TUNED_KART if task in _KART_ENVS else {}
        changes = {"env": settings["env"], "policy": {**policy, **size}, **length}
        summary = f"{network}, that {verb}: reward after a sparse run, start=RUN"
        found[f"{task}-sparse-tuned"] = Recipe("sparse-ppo", summary, changes)
    return found


RECIPES: dict[str, Recipe] = {
    "hexapod-sac": Recipe(
        "sac", "float MLP 77-512-512-18 that walks", merged(_HEXAPOD, MLP, _TEACHER)
    ),
    "hexapod-sac-256": Recipe(
        "sac", "float MLP 77-256-256-18 that walks", merged(_HEXAPOD, MLP, _NARROW)
    ),
    "hexapod-popsan": Recipe(
        "sac", "PopSAN 77-770-512-512-180-18 that walks", merged(_HEXAPOD, _POPSAN)
    ),
    "hexapod-popsan-256": Recipe(
        "sac", "PopSAN 77-770-256-256-180-18 that walks", merged(_HEXAPOD, _POPSAN, _NARROW)
    ),
    "hexapod-command-sac": Recipe(
        "sac", "float MLP 77-512-512-18 that follows commands", merged(_COMMAND, MLP, _TEACHER)
    ),
    "hexapod-command-smooth": Recipe(
        "sac",
        "float MLP 77-512-512-18 that follows commands with less power and calmer joints",
        merged(_COMMAND, MLP, _TEACHER, _SMOOTH),
    ),
    "hexapod-command-popsan": Recipe(
        "sac", "PopSAN 77-770-512-512-180-18 that follows commands", merged(_COMMAND, _POPSAN)
    ),
    "smoke": Recipe("sac", "a tiny float MLP, seconds", merged(_SMOKE_SAC, MLP)),
    "smoke-popsan": Recipe(
        "sac", "a tiny PopSAN, seconds", merged(_SMOKE_SAC, _POPSAN, {"policy": {"populations": 3}})
    ),
    **{name: Recipe("distill", summary, settings) for name, (summary, settings) in DISTILL.items()},
    **{name: Recipe("ppo", summary, settings) for name, (summary, settings) in _KARTS.items()},
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
