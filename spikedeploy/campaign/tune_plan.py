"""The plan of a study: which recipe, what is searched in it, and what is best.

A search is text: `KEY=low..high`, the same with `:log`, or `KEY=a|b|c`.
"""

import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from spikedeploy.reports.runs import flatten
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_toml
from spikedeploy.trainers.config import RunConfig, amend, require_known, resolve, spiking_layers
from spikedeploy.trainers.recipes import RECIPES

if TYPE_CHECKING:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    Distribution: TypeAlias = CategoricalDistribution | FloatDistribution | IntDistribution

FIRST_SEED = 9_000  # of evaluations: validation of trainings begins below, `compare` above
Objective = Literal["return", "return-at-sops", "return,sops"]
_RANGE = re.compile(r"(?P<low>.+?)\.\.(?P<high>.+?)(?P<log>:log)?")
_SEARCHES = read_toml(Path(__file__).with_name("searches.toml"))
_SPIKES = ("rate_penalty=0.01..1.0:log", "rate_target=0.03..0.2")


@dataclass(frozen=True)
class TuningPlan:
    """The question of a study; two studies with the same plan are one.

    recipe     of trainers.recipes
    env        of a recipe for any environment; "" else
    objective  what is best: the return; the return among those within a budget; return and SOPs
    sops       budget [SOPs a control step]; 0 without
    search     texts of --search; none takes the default of the recipe
    fixed      texts of --set
    seed       of all trainings
    episodes   of each evaluation
    chip       on which a spiking policy is evaluated; "float" for its float twin; "" for that
               which it is trained for, else the default
    """

    recipe: str
    env: str = ""
    objective: Objective = "return"
    sops: float = 0.0
    search: Sequence[str] = ()
    fixed: Sequence[str] = ()
    seed: int = 0
    episodes: int = 20
    chip: str = ""

    def __post_init__(self) -> None:
        entry = RECIPES[require_known(self.recipe, RECIPES, "recipe")]
        if entry.any_env != bool(self.env):
            raise ConfigError(
                f"{self.recipe} trains in any environment: name one with --env, as CartPole-v1"
                if entry.any_env
                else f"{self.recipe} has an environment of its own: leave --env out"
            )
        if (self.objective == "return-at-sops") != (self.sops > 0):
            raise ConfigError(
                "--objective return-at-sops takes --sops N, the most SOPs of a control step; the "
                "other objectives take none"
            )
        policy = self.config.policy  # one of events has SOPs without hidden neurons too
        if self.counts_sops and not (spiking_layers(policy) or policy.kind.startswith("delta-")):
            raise ConfigError(
                f"{self.recipe} trains a float policy, which has no SOPs: --objective return"
            )

    @property
    def counts_sops(self) -> bool:
        """True where synaptic operations matter."""
        return self.objective != "return"

    @property
    def has_two(self) -> bool:
        """True where there are two objectives."""
        return self.objective == "return,sops"

    @property
    def name(self) -> str:
        """`ppo-snn CartPole-v1 return`, of the study."""
        return " ".join(filter(None, (self.recipe, self.env, self.objective)))

    @property
    def title(self) -> str:
        """The environment in letters that a path may have."""
        return re.sub(r"[^A-Za-z0-9.-]+", "-", self.env)

    @cached_property
    def config(self) -> RunConfig:
        """The recipe with the fixed settings."""
        from spikedeploy.trainers.train import algorithm

        kind = algorithm(RECIPES[self.recipe].algorithm)
        config: RunConfig = resolve(kind.Config, self.recipe, overrides=self.fixed, seed=self.seed)
        return config

    @cached_property
    def space(self) -> "dict[str, Distribution]":
        """Setting -> the distribution from which it is drawn."""
        return space(self.config, self.search, self.fixed)

    def overrides(self, values: Mapping[str, Any]) -> list[str]:
        """Settings of a trial as `--set` takes them, those that are fixed first."""
        return [*self.fixed, *(f"{key}={value}" for key, value in values.items())]

    def command(self, values: Mapping[str, Any]) -> str:
        """The command line that trains with these settings."""
        what = [self.env, "--recipe", self.recipe] if self.env else [self.recipe]
        words = ["spikedeploy", "train", *what]
        for text in self.overrides(values):
            words += ["--set", text]
        if self.seed:
            words += ["--seed", str(self.seed)]
        return shlex.join(words)

    def as_json(self) -> dict[str, Any]:
        """The fields as plain data."""
        return {**asdict(self), "search": list(self.search), "fixed": list(self.fixed)}


def space(
    config: RunConfig, asked: Sequence[str], fixed: Iterable[str]
) -> "dict[str, Distribution]":
    """Setting -> distribution: what is asked for, else the default without what is fixed.

    config  of the recipe with the fixed settings
    asked   texts of --search
    fixed   texts of --set
    """
    taken = {text.partition("=")[0].strip() for text in fixed}
    found = dict(map(parse_search, asked or default_search(config)))
    names = [each for each in settings_of(config) if each not in ("algorithm", "recipe", "seed")]
    for key in list(found):
        if not key.startswith(("env.options.", "shaping.")):  # checked by the environment itself
            require_known(
                key, names, f"setting of {config.recipe} in --search", f"; {', '.join(names)}"
            )
        if key in taken:
            if asked:
                raise ConfigError(f"{key} is searched and fixed by --set: leave one of them out")
            del found[key]
        elif asked:
            for value in _limits(found[key]):
                amend(config, overrides=[f"{key}={value}"])
    if not found:
        raise ConfigError("every default setting is fixed by --set: name some with --search")
    return found


def default_search(config: RunConfig) -> tuple[str, ...]:
    """The default search of a recipe, as texts of --search."""
    texts = [*_SEARCHES["algorithms"].get(config.algorithm, ())]
    if config.algorithm != "sparse-ppo":  # which goes on with the policy of another run
        texts += _SEARCHES["policies"][config.policy.kind]
    if spiking_layers(config.policy) and config.algorithm in ("ppo", "sac", "distill"):
        texts += _SPIKES
    names = settings_of(config)
    return tuple(text for text in texts if text.partition("=")[0] in names)


def settings_of(config: RunConfig) -> list[str]:
    """The settings of a configuration, by the names that `--set` takes."""
    return sorted(name for name, _ in flatten(config.model_dump(mode="json")))


def parse_search(text: str) -> "tuple[str, Distribution]":
    """The setting and its distribution, of `KEY=low..high[:log]` or `KEY=a|b|c`."""
    from optuna.distributions import CategoricalDistribution

    key, equals, values = (part.strip() for part in text.partition("="))
    if not (key and equals and values):
        raise _refusal(text, "")
    if found := _RANGE.fullmatch(values):
        return key, _range(text, found["low"], found["high"], bool(found["log"]))
    texts = tuple(dict.fromkeys(part.strip() for part in values.split("|")))
    if len(texts) < 2 or not all(texts):
        raise _refusal(text, ": there is nothing to choose; --set takes a single value")
    return key, CategoricalDistribution(texts)


def _range(text: str, low: str, high: str, log: bool) -> "Distribution":
    """All numbers between two, whole numbers where both are whole; log: even in factors."""
    from optuna.distributions import FloatDistribution, IntDistribution

    try:
        first, last = (int(n) if re.fullmatch(r"[+-]?\d+", n) else float(n) for n in (low, high))
    except ValueError:
        first = last = math.nan
    if not (math.isfinite(first) and math.isfinite(last)):
        raise _refusal(text, f": {low} and {high} must be numbers")
    if not first < last:
        raise _refusal(text, f": {low} must be below {high}")
    if log and first <= 0:
        raise _refusal(text, f": a range with :log begins above 0, not at {low}")
    if isinstance(first, int) and isinstance(last, int):
        return IntDistribution(first, last, log)
    return FloatDistribution(first, last, log)


def _limits(distribution: "Distribution") -> Sequence[Any]:
    choices: Sequence[Any] | None = getattr(distribution, "choices", None)
    return choices or (distribution.low, distribution.high)  # type: ignore[union-attr]


def _refusal(text: str, why: str) -> ConfigError:
    return ConfigError(
        f"--search takes KEY=low..high, KEY=low..high:log or KEY=a|b|c, as in "
        f"--search learning_rate=1e-4..1e-2:log; got '{text}'{why}"
    )
