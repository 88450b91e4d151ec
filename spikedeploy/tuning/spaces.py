"""What is searched in a recipe unless it is said, and which keys there are."""

import difflib
from collections.abc import Iterable, Mapping, Sequence

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import RunConfig, amended
from spikedeploy.tuning.search import Search, parsed

_RL = ("gamma=0.95..0.999", "critic_hidden=[64,64]|[128,128]|[256,256]")
# learning rates over two orders of magnitude, discounts, batches
_ALGORITHMS: Mapping[str, Sequence[str]] = {
    "ppo": (
        *_RL,
        "actor_rate.start=1e-4..1e-2:log",
        "critic_rate=1e-4..1e-2:log",
        "minibatch=64|128|256|512",
        "horizon=64|128|256",
        "epochs=3..12",
        "clip=0.1..0.3",
        "trace=0.9..0.99",
        "entropy.start=1e-4..0.05:log",
    ),
    "sac": (
        *_RL,
        "learning_rate=1e-4..3e-3:log",
        "batch=64|128|256",
        "tau=0.002..0.02:log",
        "temperature.start=0.01..0.5:log",
    ),
    "distill": (
        "learning_rate=1e-4..1e-2:log",
        "batch=64|128|256|512",
        "noise=0.0..0.3",
        "mixing=0.0..0.6",
    ),
    "sparse": (
        "learning_rate=1e-3..1e-2:log",
        "level_rate=5e-4..5e-3:log",
        "polish_rate=2e-4..3e-3:log",
        "penalty=0.002..0.5:log",
        "step=0.25..1.0",
        "noise=0.1..0.5",
        "polish=2..8",
    ),
    "sparse-ppo": (
        "actor_rate=1e-5..3e-4:log",
        "critic_rate=3e-4..3e-3:log",
        "target_kl=0.003..0.03:log",
        "gamma=0.95..0.995",
        "imitation=0.1..3.0:log",
    ),
}
# widths and what makes spikes, of each kind of policy
_POLICIES: Mapping[str, Sequence[str]] = {
    "mlp": ("policy.hidden=[32,32]|[64,64]|[128,128]|[256,256]",),
    "popsan": (
        "policy.hidden=[64,64]|[128,128]|[256,256]",
        "policy.populations=4..10",
        "policy.threshold=0.3..1.0",
    ),
    "chip-snn": ("policy.hidden=[16]|[32]|[64]", "policy.timesteps=4|8|16"),
    "spiking-mlp": (
        "policy.hidden=[32,32]|[64,64]|[128,128]",
        "policy.timesteps=4..16",
        "policy.beta=0.7..0.98",
        "policy.threshold=0.4..1.2",
    ),
    "delta-snn": ("policy.hidden=8|16|32|64", "policy.most=1..4"),
    "delta-mlp": ("policy.hidden=8|16|32|64", "policy.most=1..4", "policy.threshold=0.2..1.0"),
    "pruned-mlp": ("policy.hidden=[8]|[16]|[32]|[64]",),
}
_SPIKES = ("rate_penalty=0.01..1.0:log", "rate_target=0.03..0.2")
_ENDS_WITH_POLICY = ("sparse-ppo",)  # goes on with the policy of another run


def space(config: RunConfig, asked: Sequence[str], fixed: Iterable[str]) -> dict[str, Search]:
    """Setting -> what it may be: what is asked for, else the default without what is fixed.

    config  of the recipe with the fixed settings
    asked   texts of --search
    fixed   texts of --set
    """
    taken = {text.partition("=")[0].strip() for text in fixed}
    found = dict(map(parsed, asked or default(config)))
    for key in list(found):
        _check_key(config, key)
        if key in taken and asked:
            raise ConfigError(f"{key} is both searched and fixed by --set: leave one of them out")
        if key in taken:
            del found[key]
    for key, each in found.items() if asked else ():
        for end in each.ends:
            amended(config, overrides=[f"{key}={end}"])
    if not found:
        raise ConfigError("every default setting is fixed by --set: name some with --search")
    return found


def default(config: RunConfig) -> tuple[str, ...]:
    """What is searched unless it is said, as texts of --search."""
    kind = config.policy.kind
    texts = list(_ALGORITHMS.get(config.algorithm, ()))
    if config.algorithm not in _ENDS_WITH_POLICY:
        texts += _POLICIES[kind]
    if config.policy.spiking_layers and config.algorithm in ("ppo", "sac", "distill"):
        texts += _SPIKES
    known = keys(config)
    return tuple(text for text in texts if text.partition("=")[0] in known)


def keys(config: RunConfig) -> list[str]:
    """The settings of a configuration, by the names that `--set` takes."""
    return sorted(_flat(config.model_dump(mode="json"), ""))


def _flat(settings: Mapping[str, object], path: str) -> list[str]:
    names: list[str] = []
    for key, value in settings.items():
        nested = isinstance(value, Mapping) and value
        names += _flat(value, f"{path}{key}.") if nested else [path + key]  # type: ignore[arg-type]
    return names


def _check_key(config: RunConfig, key: str) -> None:
    """Refuse what is no setting, with the nearest ones, or all."""
    known = [each for each in keys(config) if each not in ("algorithm", "recipe", "seed")]
    if key in known or key.startswith(("env.options.", "shaping.")):
        return
    near = difflib.get_close_matches(key, known, n=3)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    raise ConfigError(
        f"--search {key}: {config.recipe} has no such setting; {hint}known: {', '.join(known)}"
    )
