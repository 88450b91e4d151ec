"""Seeds for training, validation and evaluation, which never overlap."""

from collections import Counter

from spikedeploy.runtime.errors import ConfigError

TRAINING = range(5_000)
VALIDATION = range(5_000, 10_000)  # choose checkpoints, record observations for parity
EVALUATION = 10_000  # and everything above
_MOST = 100_000  # numbers of a range


def listed_numbers(option: str, text: str) -> list[int]:
    """The whole numbers in a text such as `0-4`, `0,2,5` or `0-4,7`, in that order."""
    found: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ConfigError(f"{option} is {text!r}; write numbers and ranges: 0-4, or 0,2,5")
        numbers = range(int(first), int(last if dash else first) + 1)
        if not numbers or len(numbers) > _MOST:
            raise ConfigError(
                f"{option}: {part.strip()} has {len(numbers):,} numbers; from 1 to {_MOST:,} can be"
            )
        found += numbers
    if twice := [each for each, count in Counter(found).items() if count > 1]:
        raise ConfigError(f"{option}: {twice[0]} is given twice. Give each once.")
    return found


def training_seeds(option: str, text: str) -> list[int]:
    """The seeds of trainings in such a text."""
    found = listed_numbers(option, text)
    if (most := max(found)) not in TRAINING:
        raise ConfigError(f"{option}: {most} is no seed of a training; the last is {TRAINING[-1]}")
    return found
