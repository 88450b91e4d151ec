"""What a search may set in a recipe: texts of --search as Optuna's distributions.

A text is `KEY=low..high`, or that with `:log`, or `KEY=a|b|c`.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from spikedeploy.reports.runs import flatten
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_toml
from spikedeploy.trainers.config import RunConfig, amend, require_known, spiking_layers

if TYPE_CHECKING:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    Distribution: TypeAlias = CategoricalDistribution | FloatDistribution | IntDistribution

_RANGE = re.compile(r"(?P<low>.+?)\.\.(?P<high>.+?)(?P<log>:log)?")
_WHOLE = re.compile(r"[+-]?\d+")
_DEFAULTS = read_toml(Path(__file__).with_name("searches.toml"))


def search_space(
    config: RunConfig, search: Sequence[str], fixed: Sequence[str]
) -> "dict[str, Distribution]":
    """Return setting -> distribution; ConfigError for what the recipe does not take.

    search: texts of --search; none takes the default of the recipe
    fixed: texts of --set, which are not searched
    """
    taken = {text.partition("=")[0].strip() for text in fixed}
    if not search:
        default = dict(map(parse_search, default_search(config)))
        if found := {key: each for key, each in default.items() if key not in taken}:
            return found
        raise ConfigError("every default setting is fixed by --set: name some with --search")
    found = dict(map(parse_search, search))
    names = [each for each in _settings_of(config) if each not in ("algorithm", "recipe", "seed")]
    for key, distribution in found.items():
        if not key.startswith(("env.options.", "shaping.")):  # checked by the environment itself
            kind = f"setting of {config.recipe} in --search"
            require_known(key, names, kind, f"; {', '.join(names)}")
        if key in taken:
            raise ConfigError(f"{key} is searched and fixed by --set: leave one of them out")
        ends: Any = getattr(distribution, "choices", None)
        for value in ends or (distribution.low, distribution.high):  # type: ignore[union-attr]
            amend(config, overrides=[f"{key}={value}"])
    return found


def default_search(config: RunConfig) -> tuple[str, ...]:
    """Return the default search of a recipe, as texts of --search."""
    texts = [*_DEFAULTS["algorithms"].get(config.algorithm, ())]
    if config.algorithm != "sparse-ppo":  # which goes on with the policy of another run
        texts += _DEFAULTS["policies"][config.policy.kind]
    if spiking_layers(config.policy) and config.algorithm in ("ppo", "sac", "distill"):
        texts += _DEFAULTS["spikes"]
    names = _settings_of(config)
    return tuple(text for text in texts if text.partition("=")[0] in names)


def _settings_of(config: RunConfig) -> list[str]:
    """Return the settings of a configuration, by the names that `--set` takes."""
    return sorted(name for name, _ in flatten(config.model_dump(mode="json")))


def parse_search(text: str) -> "tuple[str, Distribution]":
    """Return the setting and its distribution."""
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
    """Return all numbers between two, whole numbers where both are whole; log: even in factors."""
    from optuna.distributions import FloatDistribution, IntDistribution

    try:
        first, last = (int(n) if _WHOLE.fullmatch(n) else float(n) for n in (low, high))
    except ValueError:
        first = last = math.nan
    if not (math.isfinite(first) and math.isfinite(last) and first < last):
        raise _refusal(text, f": {low} and {high} must be numbers, the lower one first")
    if log and first <= 0:
        raise _refusal(text, f": a range with :log begins above 0, not at {low}")
    if isinstance(first, int) and isinstance(last, int):
        return IntDistribution(first, last, log)
    return FloatDistribution(first, last, log)


def _refusal(text: str, why: str) -> ConfigError:
    return ConfigError(
        f"--search takes KEY=low..high, KEY=low..high:log or KEY=a|b|c, as in "
        f"--search learning_rate=1e-4..1e-2:log; got '{text}'{why}"
    )
