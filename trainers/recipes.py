"""The table of recipes: those of SAC, distillation and PPO, and what other folders add."""

from spikedeploy.trainers.any_env_recipes import ANY_ENV_RECIPES
from spikedeploy.trainers.recipe import KART_ENVS, Recipe, Settings, merged
from spikedeploy.trainers.sparse_recipes import SPARSE_RECIPES

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
