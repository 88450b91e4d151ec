"""Configuration of a run: models that all algorithms share; recipe, TOML file, `--set` combined.

Each algorithm adds its own settings to RunConfig.
"""

import difflib
import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, model_validator

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_toml
from spikedeploy.runtime.schema import validate
from spikedeploy.trainers.recipes import RECIPES, merge

VALIDATION_SEEDS = 5_000  # and above, below those of evaluation: no training uses them
EVALUATION_SEEDS = 10_000  # and above: no training and no choice of checkpoints uses them
_MAX_STEPS = 10**12  # steps; a number beyond it is a mistake, and none that arrays can hold
Positive = Annotated[int, Field(gt=0, le=_MAX_STEPS)]
Count = Annotated[int, Field(ge=0, le=_MAX_STEPS)]
# what is allocated at once: units of a layer, samples of a batch, transitions that are kept
Width = Annotated[int, Field(gt=0, le=16_384)]
Batch = Annotated[int, Field(gt=0, le=1 << 20)]
Kept = Annotated[int, Field(gt=0, le=10**8)]
Copies = Annotated[int, Field(gt=0, le=4096)]
Rate = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
# of an observation in a control step; as runtime.codec.delta has it, not imported for a number
Events = Annotated[int, Field(ge=1, le=256)]
# of a control step; training holds the states of each at once
Timesteps = Annotated[int, Field(gt=0, le=1_024)]


class Section(BaseModel):
    """A group of settings: frozen, without unknown keys, and every number finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Ramp(Section):
    """A value that changes linearly from `start` to `end` between two environment steps."""

    start: float = Field(ge=0)
    end: float = Field(ge=0)
    begin: Count = 0
    finish: Count

    def value(self, step: int) -> float:
        """Return the value at an environment step."""
        span = max(self.finish - self.begin, 1)
        share = min(max((step - self.begin) / span, 0.0), 1.0)
        return self.start + (self.end - self.start) * share


class EnvConfig(Section):
    """The environment: short name or id, options, and number of copies stepped as one batch."""

    name: str = "hexapod"
    options: dict[str, Any] = Field(default_factory=dict)
    count: Copies = 4


class MlpConfig(Section):
    """A float network; no hidden layers make it a linear policy."""

    kind: Literal["mlp"] = "mlp"
    hidden: tuple[Width, ...] = (512, 512)


class PopsanConfig(Section):
    """A population-coded spiking actor (Tang et al. 2020), with the hexapod's decay factors."""

    kind: Literal["popsan"] = "popsan"
    hidden: tuple[Width, ...] = (512, 512)
    populations: Positive = 10
    timesteps: Timesteps = 5
    alpha: Share = 0.9
    beta: Share = 0.8
    threshold: Rate = 0.5
    surrogate: Literal["atan", "rectangular"] = "atan"
    surrogate_width: Rate | None = None  # None: 2.0 for atan (alpha), 0.5 for rectangular


class SpikingMlpConfig(Section):
    """Layers of LIF neurons and a linear readout of their firing rates, as in kart-simulator.

    coding: "regular" and "bernoulli" are rate codes for values in [-reach, reach], with evenly
        spaced or random spikes; "population" is PopSAN's code, `populations` neurons for each
        value, whose fields are spread over that range at first
    """

    kind: Literal["spiking-mlp"] = "spiking-mlp"
    hidden: tuple[Width, ...] = Field(default=(64, 64), min_length=1)
    coding: Literal["regular", "bernoulli", "population"] = "regular"
    populations: Positive = 4
    reach: Rate = 1.0
    timesteps: Timesteps = 16
    beta: Share = 0.9
    threshold: Rate = 0.7
    surrogate: Literal["fast-sigmoid", "atan", "rectangular"] = "fast-sigmoid"
    surrogate_width: Rate | None = None  # None: 25 for fast-sigmoid, others as in PopsanConfig


class NetworkConfig(Section):
    """A network on a chip, between a code and a linear readout; see policies.chip_network.

    network: module:Class of a torch module, or a .nir file, whose numbers training begins with; one
        with a codec brings its own code, timesteps and readout. Without one, layers of the chip's
        own neurons, as its design rules have them
    chip: name of a datasheet, with options as on the command line
    hidden: widths of layers of the chip's own neurons
    outputs: width of the last of them, whose rates are read out
    alpha, beta: their decay factors where the chip leaves a choice; None for 0.5 and 0.9375
    limit: their largest weight [thresholds]; None for at most 0.5
    coding, reach: as in SpikingMlpConfig
    populations: likewise; None for as many as the network has inputs for, at most 8 where it is
        made for any number
    score: what of the output over the timesteps is read: its "mean", or its "last" value
    limits: refuse a named network that breaks a design rule of the chip
    """

    kind: Literal["network"] = "network"
    network: str = ""
    chip: str = "ideal"
    hidden: tuple[Width, ...] = Field(default=(32,), min_length=1)
    outputs: Positive = 8
    alpha: Share | None = None
    beta: Share | None = None
    limit: Rate | None = None
    coding: Literal["regular", "bernoulli", "population"] = "population"
    populations: Positive | None = None
    reach: Rate = 2.0
    timesteps: Timesteps = 8
    score: Literal["mean", "last"] = "mean"
    limits: bool = True
    surrogate: Literal["fast-sigmoid", "atan", "rectangular"] = "atan"
    surrogate_width: Rate | None = None

    @model_validator(mode="after")
    def _a_named_network_has_layers_of_its_own(self) -> "NetworkConfig":
        fields, own = type(self).model_fields, ("hidden", "outputs", "alpha", "beta", "limit")
        given = [name for name in own if getattr(self, name) != fields[name].default]
        if self.network and given:
            raise ValueError(
                f"{', '.join(given)}: for layers of a chip's own neurons, and the network "
                f"{self.network} has its own. Leave it out"
            )
        return self


class DeltaSnnConfig(Section):
    """Signed events into a small layer of LIF neurons, and past it into leaky readouts.

    hidden: neurons; 0 leaves a delta-coded linear policy
    skip: whether events also reach the readout directly
    integrated: whether events reach the readout through integrators that hardly decay
    most, code: events of an observation in a timestep, and on which channels; see
        runtime.codec.delta
    timesteps: timesteps of a control step. A pipelined chip acts on what it sees now from 3 on,
        with 1 it acts on what it saw one to two control steps before
    clock: "pipelined", as on chips whose cores all advance in each timestep, or "gated", for
        software and hardware that can update one layer after the other (runtime.convention.Clock)
    """

    kind: Literal["delta-snn"] = "delta-snn"
    hidden: Count = 8
    skip: bool = True
    integrated: bool = False
    most: Events = 3
    timesteps: Timesteps = 1
    code: Literal["unary", "one-hot"] = "one-hot"
    clock: Literal["gated", "pipelined"] = "pipelined"
    surrogate_width: Rate = 2.0


class PrunedMlpConfig(Section):
    """A small float network with a skip connection, pruned as the spiking ones are.

    hidden: widths of its layers; none make it a linear policy
    """

    kind: Literal["pruned-mlp"] = "pruned-mlp"
    hidden: tuple[Width, ...] = (16,)
    skip: bool = True


PolicyConfig = Annotated[
    MlpConfig | PopsanConfig | SpikingMlpConfig | NetworkConfig | DeltaSnnConfig | PrunedMlpConfig,
    Field(discriminator="kind"),
]


def spiking_layers(policy: PolicyConfig) -> int:
    """Return the number of a policy's spiking layers whose sparsity validation measures.

    The encoder does not count. Networks on a chip are validated without records.
    """
    if isinstance(policy, DeltaSnnConfig):
        return int(policy.hidden > 0)
    if isinstance(policy, PopsanConfig):  # whose last layer codes the actions
        return len(policy.hidden) + 1
    return len(policy.hidden) if isinstance(policy, SpikingMlpConfig) else 0


class NormaliserConfig(Section):
    """Observation statistics: updated up to `finish` environment steps, then frozen."""

    finish: Count = 60_000
    clip: Rate = 4.0


class ValidationConfig(Section):
    """Deterministic episodes without support force, which choose the best checkpoint.

    every: environment steps between two validations
    first_seed: episodes use this seed and the following; 5,000 to 9,999 are reserved for them
    limit: control steps after which an episode is truncated, None for the environment's limit
    """

    every: Positive = 10_000
    episodes: Positive = 4
    first_seed: int = Field(default=VALIDATION_SEEDS, ge=VALIDATION_SEEDS, lt=9_000)
    limit: Positive | None = None

    @property
    def seeds(self) -> list[int]:
        """One for each episode."""
        return list(range(self.first_seed, self.first_seed + self.episodes))


class RunConfig(Section):
    """Settings that every algorithm has."""

    algorithm: str
    recipe: str
    seed: int = Field(default=0, ge=0, lt=VALIDATION_SEEDS)
    env: EnvConfig = EnvConfig()
    policy: PolicyConfig = MlpConfig()
    normaliser: NormaliserConfig = NormaliserConfig()
    validation: ValidationConfig = ValidationConfig()


C = TypeVar("C", bound=RunConfig)


# -- a recipe, a TOML file and `--set` combined into a configuration

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found, unused-ignore]


def resolve(
    model: type[C],
    recipe: str,
    *,
    file: str | Path | None = None,
    overrides: Iterable[str] = (),
    seed: int = 0,
) -> C:
    """Return the recipe's configuration, changed by the file and then by the overrides."""
    entry = RECIPES[require_known(recipe, RECIPES, "recipe")]
    defaults = model(algorithm=entry.algorithm, recipe=recipe, seed=seed).model_dump()
    if "policy" in entry.settings:
        del defaults["policy"]  # another kind of policy has other settings
    base = validate(model, merge(defaults, entry.settings), f"recipe {recipe}")
    if entry.any_env:
        base = _stretched(base, amend(base, file=file, overrides=overrides))
    return amend(base, file=file, overrides=overrides)


def amend(base: C, *, file: str | Path | None = None, overrides: Iterable[str] = ()) -> C:
    """Return a configuration changed by the file and then by the overrides."""
    settings = base.model_dump(mode="json")
    if file is not None:
        try:
            tables = read_toml(Path(file))
        except OSError as error:
            raise ConfigError(f"cannot read the configuration file {file}: {error}") from error
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"{file} is not valid TOML: {error}") from error
        settings = _overlaid(settings, tables, str(file))
    for text in overrides:
        settings = _overlaid(settings, parse_override(text), f"--set {text}")
    for name in ("algorithm", "recipe"):
        if settings[name] != getattr(base, name):
            raise ConfigError(
                f"{name}: it is that of the recipe {base.recipe}. Name another recipe"
            )
    return validate(type(base), settings, f"recipe {base.recipe}")


def _stretched(base: C, asked: C) -> C:
    """Return the base with every schedule stretched to the length that is asked for."""
    settings = base.model_dump(mode="json")
    share = getattr(asked, "steps", 1) / settings.get("steps", 1)
    for value in settings.values():
        for end in ("begin", "finish"):
            if isinstance(value, dict) and end in value:
                value[end] = round(value[end] * share)
    return validate(type(base), settings, f"recipe {base.recipe}")


def differences(config: RunConfig) -> list[str]:
    """Return the overrides, as `--set` takes them, that turn the recipe into this configuration."""
    recipe = _flat(resolve(type(config), config.recipe, seed=config.seed).model_dump(mode="json"))
    found = _flat(config.model_dump(mode="json"))
    return [
        f"{key}={json.dumps(value)}" for key, value in found.items() if recipe.get(key) != value
    ]


def _flat(settings: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """Return nested settings as one level of dotted names."""
    result: dict[str, Any] = {}
    for key, value in settings.items():
        inner = isinstance(value, Mapping) and value
        result |= _flat(value, f"{path}{key}.") if inner else {path + key: value}
    return result


def require_known(name: str, names: Iterable[str], kind: str, remedy: str = "") -> str:
    """Return `name` if it is one of the names, else raise ConfigError with the closest ones.

    remedy: what else may have been meant
    """
    choices = sorted(names)
    if name in choices:
        return name
    near = difflib.get_close_matches(name, choices, n=3)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(choices)}"
    raise ConfigError(f"unknown {kind} '{name}': {hint}{remedy}")


def parse_override(text: str) -> dict[str, Any]:
    """Return `a.b=value` as nested tables; a value that is not TOML is a string."""
    key, equals, value = text.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ConfigError(f"--set takes key=value, as in --set policy.hidden=[64,64]; got '{text}'")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except RecursionError:
        raise ConfigError(f"--set {key.strip()}: its value is nested too deeply") from None
    except ValueError:  # tomllib's own, and of numbers with thousands of digits
        parsed = value.strip()
    for part in reversed(parts):
        parsed = {part: parsed}
    nested: dict[str, Any] = parsed
    return nested


def _overlaid(
    settings: Mapping[str, Any], change: Mapping[str, Any], source: str, path: str = ""
) -> dict[str, Any]:
    """Return `settings` with a nested change applied; unknown keys raise ConfigError."""
    result = dict(settings)
    for key, value in change.items():
        name = path + key
        if path not in ("env.options.", "shaping."):  # checked by the environment itself
            kind = f"setting ({source}) {path}".rstrip()
            own = "" if path else f"; an option of the environment is env.options.{key}"
            require_known(key, settings, kind, own)
        old = settings.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping):
            value = _overlaid(old, value, source, f"{name}.")
        result[key] = value
    return result
