"""The recipes of distillation: name → summary, and settings that differ from the defaults.

For each task the float teacher is distilled into PopSANs of two widths and into three controls, all
with the same states and updates, so that a comparison shows what the spiking network is worth. The
teacher is given with --set teacher=PATH.
"""

from typing import Any

Settings = dict[str, Any]

STUDENTS: dict[str, tuple[str, Settings]] = {
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

TASKS: dict[str, tuple[str, Settings]] = {
    # walking bears sparser activity than the defaults ask for, at no cost in return: see the card
    # of the shipped policy, spikedeploy/zoo/hexapod/popsan.md
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
    # commands alone scatter returns by a few percent: more episodes choose the best checkpoint
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

# Seconds, not minutes: for tests and for a first look at the tools.
SMOKE: Settings = {
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
    for task, (verb, settings) in TASKS.items()
    for student, (network, policy) in STUDENTS.items()
} | {"smoke-distill": ("a tiny PopSAN from a teacher, seconds", SMOKE)}
