"""The table of recipes: those of SAC, distillation and PPO, and what other folders add."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

# -- A recipe: what to train, as differences from the defaults of an algorithm's configuration.

Settings = dict[str, Any]

KART_ENVS = ("kart-grid", "kart-gazebo", "kart-steer")


@dataclass(frozen=True)
class Recipe:
    """What to train, and how.

    algorithm: key of `trainers.ALGORITHMS`
    summary: one line
    settings: nested settings that differ from the algorithm's defaults
    any_env: whether the command line names the environment
    """

    algorithm: str
    summary: str
    settings: Mapping[str, Any]
    any_env: bool = False


def merged(settings: Mapping[str, Any], *changes: Mapping[str, Any]) -> Settings:
    """Return `settings` with nested changes applied in order."""
    result = dict(settings)
    for change in changes:
        for key, value in change.items():
            old = result.get(key)
            nested = isinstance(old, Mapping) and isinstance(value, Mapping)
            result[key] = merged(old, value) if nested else value  # type: ignore[arg-type]
    return result


def budget(recipe: Recipe) -> str:
    """Operations of a control step that a recipe ends with: `50 SOPs`; empty where it has none."""
    count = recipe.settings.get("budget")
    unit = "MACs" if recipe.settings.get("policy", {}).get("kind") == "pruned-mlp" else "SOPs"
    return "" if count is None else f"{count:,g} {unit}"


# -- Recipes for any environment: the command line names it, `train CartPole-v1 --recipe ppo-
#    snn`.
#
# They learn gymnasium's CartPole and Pendulum within minutes on one core; harder tasks need more
# steps, with which the schedules are stretched, and wider layers.

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


# -- Recipes of sparse policies, of the small float networks beside them, and of PPO after.
#
# The teachers are the shipped ones; another is given with --set teacher=PATH.

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


# -- The table of recipes: those of SAC, distillation and PPO, and what other folders add.

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

# -- for each task the float teacher is distilled into PopSANs of two widths and into
# controls from the gait's phase alone to an MLP with 64-64, all with the same states and updates,
# so that comparisons name the smallest float policy of equal return. The teacher is given with
# --set teacher=PATH

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
    "fourier": (
        "control: three harmonics of the phase times command and errors, no hidden layer",
        {"kind": "mlp", "hidden": [], "features": "fourier"},
    ),
    **{
        f"mlp-{hidden[0]}": (
            f"control: MLP 77-{'-'.join(str(width) for width in hidden)}-18",
            {"kind": "mlp", "hidden": hidden},
        )
        for hidden in ([8], [16], [32], [64, 64])
    },
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

# kart-simulator's settings of PPO for its own presets, as far as ours has them (docs/karts.md).
# Learning rate and entropy of its spiking networks where they are not those of its float ones
_CLASSIC: dict[str, tuple[Settings, Settings]] = {
    "kart-grid": (
        {"steps": 500_000, "horizon": 224, "minibatch": 32, "epochs": 9, "gamma": 0.9717,
         "trace": 0.9665, "rate": 1.74e-3, "entropy": 9.93e-3},
        {"timesteps": 50},
    ),
    "kart-gazebo": (
        {"steps": 600_000, "horizon": 160, "minibatch": 20, "epochs": 9, "gamma": 0.97237,
         "trace": 0.94459, "rate": 9.75693e-4, "entropy": 1.32582e-3},
        {"timesteps": 100, "rate": 9.75693e-3, "entropy": 1.32582e-4},
    ),
    "kart-steer": (
        {"steps": 1_000_000, "horizon": 256, "minibatch": 51, "epochs": 7, "gamma": 0.963,
         "trace": 0.9644, "rate": 1.78e-4, "entropy": 4.79e-3},
        {"timesteps": 32},
    ),
}  # fmt: skip


def _classic(env: str, name: str) -> Settings:
    """Return the settings of a policy on kart-simulator's observation and reward."""
    settings, spiking = _CLASSIC[env]
    policy = _POLICIES[name][1]
    if name == "snn":
        policy = {**policy, "coding": "bernoulli", "timesteps": spiking["timesteps"]}
        settings = {**settings, **{k: v for k, v in spiking.items() if k in settings}}
    rate, entropy = settings["rate"], settings["entropy"]
    return {
        **{key: value for key, value in settings.items() if key not in ("rate", "entropy")},
        "env": {"name": env, "options": {"preset": "classic"}},
        "policy": policy,
        "actor_rate": {"start": rate, "end": 0.0, "finish": settings["steps"]},
        "critic_rate": rate,
        "entropy": {"start": entropy, "end": entropy},
        "temperature": {"end": 1.0},
        "target_kl": 0.0,
        "running_total": True,
    }


# a new corridor each episode, observed without what belongs to one track: its box, its directions
_CORRIDOR: Settings = {
    "env": {"options": {"track": "corridor-8", "observe": ["lidar", "velocity"]}},
    # episodes are short, so that two thirds of the default schedule are enough
    "steps": 200_000,
    "actor_rate": {"finish": 200_000},
    "entropy": {"finish": 150_000},
    "temperature": {"begin": 80_000, "finish": 150_000},
}

_KARTS: dict[str, tuple[str, Settings]] = {
    **{
        f"{env}-classic-{name}": (
            f"{summary}, to race {env} as kart-simulator has it",
            _classic(env, name),
        )
        for env in KART_ENVS
        for name, (summary, _) in _POLICIES.items()
    },
    **{
        f"{env}-corridor-{name}": (
            f"{summary}, to race {env} in corridors drawn at random",
            merged(_CORRIDOR, {"env": {"name": env}, "policy": policy}),
        )
        for env in KART_ENVS
        for name, (summary, policy) in _POLICIES.items()
    },
    **{
        f"{env}-{name}": (f"{summary}, to race {env}", {"env": {"name": env}, "policy": policy})
        for env in KART_ENVS
        for name, (summary, policy) in _POLICIES.items()
    },
    "smoke-kart": (
        "a tiny spiking kart driver, seconds",
        {**_SMOKE_PPO, "policy": {"kind": "spiking-mlp", "hidden": [8, 8], "timesteps": 4}},
    ),
}

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
    **SPARSE_RECIPES,
    **ANY_ENV_RECIPES,
}
