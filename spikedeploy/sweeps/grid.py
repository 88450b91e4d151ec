"""SPEC.toml of a sweep: the axes of its grid, and what all of its jobs have in common."""

import difflib
import math
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from spikedeploy.comparison.metrics import checked_metrics
from spikedeploy.policies.registry import DEFAULT_CHIP
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import EVALUATION, listed_numbers

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found, unused-ignore]

OWN, NONE = "own", "none"  # the chip's own bits; no disturbance or fault
Texts = tuple[str, ...]
_MOST = 100_000  # jobs: planning takes a second or two for each 10,000
_LONGEST = 100  # letters of a name, of which folders are made


@dataclass(frozen=True)
class SweepGrid:
    """What a sweep varies, and what its jobs have in common.

    name      of the sweep; that of its file
    env       short names, ids of gymnasium, or module:Class
    policy    files, run folders, shipped names; none stands for all that are shipped
    chip      of spiking policies; "float" is the float twin
    bits      of the weights on those chips; None is the chip's own number
    disturb   disturbances of the world, those of one job together
    fault     faults of the chip, likewise
    specimen  which faulty chip
    seed      first seed of each job; (n,)
    episodes  of a job, from its seed on
    options   of the environment
    limits    refuse what breaks a design rule of the chip
    quantisation  of spiking policies on chips
    metrics   of the step infos, `name:mean|last|max`
    """

    name: str
    env: Texts
    policy: Texts = ()
    chip: Texts = (DEFAULT_CHIP,)
    bits: tuple[int | None, ...] = (None,)
    disturb: tuple[Texts, ...] = ((),)
    fault: tuple[Texts, ...] = ((),)
    specimen: tuple[int, ...] = (0,)
    seed: tuple[int, ...] = (EVALUATION,)
    episodes: int = 10
    options: Mapping[str, Any] = field(default_factory=dict)
    limits: bool = True
    quantisation: Quantisation = PLAIN
    metrics: Texts = ()

    def __post_init__(self) -> None:
        for axis in ("env", "policy", "chip", "bits", "disturb", "fault", "specimen", "seed"):
            counts = Counter(getattr(self, axis)).items()
            if twice := [each for each, count in counts if count > 1]:
                raise ConfigError(f"{axis}: {_said(twice[0])} is given twice. Give each once.")
        axes = (self.chip, self.bits, self.disturb, self.fault, self.specimen, self.seed)
        if (jobs := math.prod(map(len, (self.env, self.policy or (None,), *axes)))) > _MOST:
            raise ConfigError(f"{jobs:,} jobs; at most {_MOST:,} in a sweep. Split the grid.")
        if not self.env:
            raise ConfigError("env is missing: name an environment, as in env = 'hexapod'")
        for axis in ("chip", "bits", "disturb", "fault", "specimen", "seed"):
            if not getattr(self, axis):
                raise ConfigError(f"{axis} is empty, so there is nothing to do. Leave it out.")
        first = min(self.seed)
        if first < EVALUATION:
            raise ConfigError(
                f"seed {first} may have been trained on; evaluation starts at {EVALUATION}"
            )
        for lower, upper in zip(sorted(self.seed), sorted(self.seed)[1:], strict=False):
            if upper - lower < self.episodes:
                raise ConfigError(
                    f"seed: jobs from {lower} and from {upper} on share episodes, as each has "
                    f"{self.episodes}. Leave that many seeds between them, or write a range: "
                    f"seed = '{first}-{max(self.seed) + self.episodes - 1}'."
                )


def read_grid(path: Path) -> SweepGrid:
    """The grid in a TOML file; ConfigError names the key that is wrong, or unknown."""
    try:
        found: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from error
    try:
        return _grid({"name": path.stem, **found})
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def _grid(found: dict[str, Any]) -> SweepGrid:
    for key in found:
        if key not in _KEYS:
            near = difflib.get_close_matches(key, _KEYS, n=1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise ConfigError(f"unknown key {key!r}: {hint}known: {', '.join(_KEYS)}")
    episodes = _positive("episodes", found.get("episodes", SweepGrid.episodes))
    ranges = {"seed": _seeds("seed", found["seed"], episodes)} if "seed" in found else {}
    read = {key: _KEYS[key](key, value) for key, value in found.items() if key != "seed"}
    return SweepGrid(**{"env": (), **read, **ranges})


def _name(key: str, value: object) -> str:
    text = _text(key, value)
    if not text or text.startswith(".") or any(letter in text for letter in "/\\\0"):
        raise ConfigError(f"{key} is {value!r}; it must be the name of a folder, without slashes")
    if len(text) > _LONGEST:
        raise ConfigError(f"{key} has {len(text)} letters; at most {_LONGEST}")
    return text


def _text(key: str, value: object) -> str:
    if not isinstance(value, str):
        raise _wrong(key, value, "a text")
    return value


def _whole(key: str, value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise _wrong(key, value, "a whole number from 0 up")
    return value


def _positive(key: str, value: object) -> int:
    if not _whole(key, value):
        raise _wrong(key, value, "a whole number from 1 up")
    return _whole(key, value)


def _bits(key: str, value: object) -> int | None:
    return None if value == OWN else _positive(key, value)


def _together(key: str, value: object) -> Texts:
    """Disturbances or faults of one job: a text, several in a list, or none."""
    if value == NONE:
        return ()
    return tuple(_text(key, each) for each in (value if isinstance(value, list) else [value]))


def _switch(key: str, value: object) -> bool:
    if value not in ("on", "off"):
        raise _wrong(key, value, "'on' or 'off'")
    return value == "on"


def _table(key: str, value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise _wrong(key, value, f"a table: [{key}]")
    return value


def _quantisation(key: str, value: object) -> Quantisation:
    known = [each.name for each in fields(Quantisation) if each.name != "tuned"]
    for name in (given := _table(key, value)):
        if name not in known:
            raise ConfigError(f"unknown key {key}.{name}; known: {', '.join(known)}")
    readers: dict[str, Callable[[str, object], Any]] = {
        "thresholds": _positive,
        "weight_shift": _whole,
    }
    return Quantisation(**{name: readers.get(name, _text)(name, given[name]) for name in given})


def _seeds(key: str, value: object, episodes: int) -> tuple[int, ...]:
    """First seeds of jobs: whole numbers, or a range of seeds such as `10000-10049`, divided."""
    if isinstance(value, str):
        every = listed_numbers(key, value)
        return tuple(every[::episodes])
    return _each(_whole)(key, value)


def _each(read: Callable[[str, object], Any]) -> Callable[[str, object], tuple[Any, ...]]:
    """A reader of one value or a list of them."""

    def many(key: str, value: object) -> tuple[Any, ...]:
        return tuple(read(key, each) for each in (value if isinstance(value, list) else [value]))

    return many


def _metrics(key: str, value: object) -> Texts:
    return tuple(checked_metrics(_each(_text)(key, value)))


_KEYS: dict[str, Callable[[str, object], Any]] = {
    "name": _name,
    "env": _each(_text),
    "policy": _each(_text),
    "chip": _each(_text),
    "bits": _each(_bits),
    "disturb": _each(_together),
    "fault": _each(_together),
    "specimen": _each(_whole),
    "seed": _each(_whole),
    "episodes": _positive,
    "options": _table,
    "limits": _switch,
    "quantisation": _quantisation,
    "metrics": _metrics,
}


def _wrong(key: str, value: object, wanted: str) -> ConfigError:
    return ConfigError(f"{key} is {value!r}; it must be {wanted}")


def _said(value: object) -> str:
    return " with ".join(value) or NONE if isinstance(value, tuple) else f"{value or OWN}"
