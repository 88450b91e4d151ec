"""Datasheets side by side: what the chips compute with, and what that was compared with."""

from collections.abc import Iterable

from spikedeploy.runtime.chips.chip import Chip

COLUMNS = ("name", "neurons", "weights", "membrane", "resets", "compared with")


def rows(chips: Iterable[Chip]) -> list[tuple[str, ...]]:
    """A row of COLUMNS for each chip."""
    return [
        (chip.name, *chip.arithmetic.describe(), ", ".join(chip.resets), chip.evidence)
        for chip in chips
    ]


def markdown(chips: Iterable[Chip]) -> str:
    """The same as a table of Markdown."""
    lines = [COLUMNS, ("---",) * len(COLUMNS), *rows(chips)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
