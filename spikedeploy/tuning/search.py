"""What a setting may be: `KEY=low..high`, the same with `:log`, or `KEY=a|b|c`."""

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from spikedeploy.runtime.errors import ConfigError

if TYPE_CHECKING:
    import optuna

_RANGE = re.compile(r"(?P<low>.+?)\.\.(?P<high>.+?)(?P<log>:log)?")


@dataclass(frozen=True)
class Interval:
    """All numbers between two, in whole numbers where both are whole.

    low, high  the limits, which belong to it
    log        whether factors are searched evenly, not differences
    """

    low: float
    high: float
    log: bool = False

    @property
    def ends(self) -> tuple[str, str]:
        """The limits as `--set` takes them."""
        return repr(self.low), repr(self.high)

    def suggested(self, trial: "optuna.Trial", key: str) -> str:
        """A value of it that the trial is to try, as `--set` takes it."""
        if isinstance(self.low, int) and isinstance(self.high, int):
            return repr(trial.suggest_int(key, self.low, self.high, log=self.log))
        return repr(trial.suggest_float(key, self.low, self.high, log=self.log))


@dataclass(frozen=True)
class Choices:
    """Some values, as `--set` takes them."""

    texts: tuple[str, ...]

    @property
    def ends(self) -> tuple[str, ...]:
        """All of them."""
        return self.texts

    def suggested(self, trial: "optuna.Trial", key: str) -> str:
        """One of them that the trial is to try."""
        return str(trial.suggest_categorical(key, self.texts))


Search = Interval | Choices


def parsed(text: str) -> tuple[str, Search]:
    """The setting and what it may be, of `KEY=low..high[:log]` or `KEY=a|b|c`."""
    key, equals, values = (part.strip() for part in text.partition("="))
    if not (key and equals and values):
        raise _refused(text, "")
    if found := _RANGE.fullmatch(values):
        return key, _interval(text, found["low"], found["high"], bool(found["log"]))
    texts = tuple(dict.fromkeys(part.strip() for part in values.split("|")))
    if len(texts) < 2 or not all(texts):
        raise _refused(text, ": there is nothing to choose; --set takes a single value")
    return key, Choices(texts)


def _interval(text: str, low: str, high: str, log: bool) -> Interval:
    try:
        ends = _number(low), _number(high)
    except ValueError:
        raise _refused(text, f": {low} and {high} must be numbers") from None
    if not ends[0] < ends[1]:
        raise _refused(text, f": {low} must be below {high}")
    if log and ends[0] <= 0:
        raise _refused(text, f": a range with :log begins above 0, not at {low}")
    whole = all(isinstance(end, int) for end in ends)
    return Interval(*ends, log) if whole else Interval(float(ends[0]), float(ends[1]), log)


def _number(text: str) -> float:
    try:
        return int(text)
    except ValueError:
        number = float(text)
        if not math.isfinite(number):
            raise
        return number


def _refused(text: str, why: str) -> ConfigError:
    return ConfigError(
        f"--search takes KEY=low..high, KEY=low..high:log or KEY=a|b|c, as in "
        f"--search learning_rate=1e-4..1e-2:log; got '{text}'{why}"
    )
