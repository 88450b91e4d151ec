"""Configuration: recipe, TOML file and `--set` overrides in, one validated model out."""

import difflib
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from runtime.errors import ConfigError
from trainers.recipes import RECIPES, merged

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found, unused-ignore]

Positive = Annotated[int, Field(gt=0)]
Count = Annotated[int, Field(ge=0)]
Rate = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class Section(BaseModel):
    """A group of settings: frozen, and it refuses what it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Ramp(Section):
    """A number that moves linearly from `start` to `end` between two environment steps."""

    start: float
    end: float
    begin: Count = 0
    finish: Count

    def at(self, step: int) -> float:
        """Return the value at an environment step."""
        span = max(self.finish - self.begin, 1)
        share = min(max((step - self.begin) / span, 0.0), 1.0)
        return self.start + (self.end - self.start) * share


class EnvConfig(Section):
    """The world: short name or id, options of its constructor, copies stepped as one batch."""

    name: str = "hexapod"
    options: dict[str, Any] = Field(default_factory=dict)
    count: Positive = 4


class MlpConfig(Section):
    """A float network; no hidden layers make it a linear policy."""

    kind: Literal["mlp"] = "mlp"
    hidden: tuple[Positive, ...] = (512, 512)
    features: Literal["all", "phase", "bilinear"] = "all"


class PopsanConfig(Section):
    """A population-coded spiking actor (Tang et al. 2020), with the hexapod's decays."""

    kind: Literal["popsan"] = "popsan"
    hidden: tuple[Positive, ...] = (512, 512)
    populations: Positive = 10
    timesteps: Positive = 5
    alpha: Share = 0.9
    beta: Share = 0.8
    threshold: Rate = 0.5
    surrogate: Literal["atan", "rectangular"] = "atan"
    surrogate_width: Rate | None = None  # None: 2.0 for atan (alpha), 0.5 for rectangular


PolicyConfig = Annotated[MlpConfig | PopsanConfig, Field(discriminator="kind")]


class NormaliserConfig(Section):
    """Observation statistics: gathered up to `finish` environment steps, then frozen."""

    finish: Count = 60_000
    clip: Rate = 4.0


class ValidationConfig(Section):
    """Deterministic episodes, without hoist, that choose the best checkpoint.

    every: environment steps between two validations
    first_seed: episodes use this seed and those after it; 5,000 to 9,999 are kept for this
    limit: control steps after which an episode is cut, None for the environment's own
    """

    every: Positive = 10_000
    episodes: Positive = 4
    first_seed: int = Field(default=5_000, ge=5_000, lt=9_000)
    limit: Positive | None = None


class RunConfig(Section):
    """What every algorithm's configuration holds."""

    algorithm: str
    recipe: str
    seed: int = Field(default=0, ge=0)
    env: EnvConfig = EnvConfig()
    policy: PolicyConfig = MlpConfig()
    normaliser: NormaliserConfig = NormaliserConfig()
    validation: ValidationConfig = ValidationConfig()


class SacConfig(RunConfig):
    """Soft actor-critic with a temperature that is set, not learned (Haarnoja et al. 2018).

    steps: environment steps in all; 500 episodes of 1,000
    warm_up: steps with uniform random actions before the first update
    update_every: environment steps per gradient update
    epsilon: added inside the logarithm of the tanh correction
    mean_penalty: weight of the squared pre-tanh mean in the actor's loss
    rate_penalty, rate_target: weight and threshold of the hinge on mean firing rates [spikes per
        neuron and timestep]; no effect on an MLP
    hoist: fraction of the full hoisting force
    """

    steps: Positive = 500_000
    warm_up: Positive = 10_000
    update_every: Positive = 4
    batch: Positive = 128
    buffer: Positive = 1_000_000
    critic_hidden: tuple[Positive, ...] = (512, 512)
    learning_rate: Rate = 3e-4
    gamma: Share = 0.99
    tau: Share = 0.005
    temperature: Ramp = Ramp(start=0.05, end=0.02, begin=50_000, finish=180_000)
    epsilon: Rate = 1e-6
    mean_penalty: float = Field(default=0.05, ge=0)
    rate_penalty: float = Field(default=0.0, ge=0)
    rate_target: Share = 0.13
    hoist: Ramp = Ramp(start=1.0, end=0.0, finish=150_000)
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    log_every: Positive = 1_000
    checkpoint_every: Positive = 25_000

    @model_validator(mode="after")
    def _sees_everything(self) -> "SacConfig":
        if isinstance(self.policy, MlpConfig) and self.policy.features != "all":
            raise ValueError("sac learns from all observations: distil policies that see less")
        return self


C = TypeVar("C", bound=RunConfig)


def resolve(
    model: type[C],
    recipe: str,
    *,
    file: str | Path | None = None,
    overrides: Iterable[str] = (),
    seed: int = 0,
) -> C:
    """Return the recipe's configuration with the file and then the overrides laid over it."""
    entry = RECIPES[known(recipe, RECIPES, "recipe")]
    defaults = model(algorithm=entry.algorithm, recipe=recipe, seed=seed).model_dump()
    if "policy" in entry.settings:
        del defaults["policy"]  # another kind of policy has other settings
    base = validated(model, merged(defaults, entry.settings), f"recipe {recipe}")
    return amended(base, file=file, overrides=overrides)


def amended(base: C, *, file: str | Path | None = None, overrides: Iterable[str] = ()) -> C:
    """Return a configuration with the file and then the overrides laid over it."""
    settings = base.model_dump(mode="json")
    if file is not None:
        settings = _overlaid(settings, read_toml(file), str(file))
    for text in overrides:
        settings = _overlaid(settings, parse_override(text), f"--set {text}")
    return validated(type(base), settings, f"recipe {base.recipe}")


def known(name: str, names: Iterable[str], kind: str) -> str:
    """Return `name`, or raise ConfigError with the nearest of the names that exist."""
    choices = sorted(names)
    if name in choices:
        return name
    near = difflib.get_close_matches(name, choices, n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(choices)}"
    raise ConfigError(f"unknown {kind} '{name}': {hint}")


def read_toml(file: str | Path) -> dict[str, Any]:
    """Return the tables of a TOML file."""
    try:
        tables: dict[str, Any] = tomllib.loads(Path(file).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read the configuration file {file}: {error}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file} is not valid TOML: {error}") from error
    return tables


def parse_override(text: str) -> dict[str, Any]:
    """Return `a.b=value` as nested tables; a value that is not TOML is taken as a string."""
    key, equals, value = text.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ConfigError(f"--set takes key=value, as in --set policy.hidden=[64,64]; got '{text}'")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()
    for part in reversed(parts):
        parsed = {part: parsed}
    nested: dict[str, Any] = parsed
    return nested


def _overlaid(
    settings: Mapping[str, Any], change: Mapping[str, Any], source: str, path: str = ""
) -> dict[str, Any]:
    """Return `settings` with the change laid over it; a key that is not there is refused."""
    result = dict(settings)
    for key, value in change.items():
        name = path + key
        if path != "env.options.":  # the environment itself knows its options
            known(key, settings, f"setting ({source}) {path}".rstrip())
        old = settings.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping):
            value = _overlaid(old, value, source, f"{name}.")
        result[key] = value
    return result


def validated(model: type[C], settings: Mapping[str, Any], source: str) -> C:
    """Return the settings as a model, or raise ConfigError naming each wrong one."""
    try:
        return model.model_validate(settings)
    except ValidationError as error:
        faults = "; ".join(_fault(**fault) for fault in error.errors())
        raise ConfigError(f"{source}: {faults}") from error


def _fault(loc: tuple[int | str, ...], msg: str, input: object, **_: object) -> str:
    """Return one fault that pydantic found as `a.b: what is wrong, got x`."""
    return f"{'.'.join(map(str, loc))}: {msg}, got {input!r}"
