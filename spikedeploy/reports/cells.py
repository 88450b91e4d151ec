"""One column of a table, and how its cells are written: numbers, energies, bounds."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

Row = Mapping[str, Any]
Cell = Callable[[Row], str]
ABSENT = "–"


@dataclass(frozen=True)
class Column:
    """One column: its head, its definition, and the text of a row's cell."""

    title: str
    meaning: str
    cell: Cell


def number(field: str, form: str) -> Cell:
    """A cell that formats the field, or a dash where the row lacks it."""

    def cell(row: Row) -> str:
        value = row.get(field)
        return ABSENT if value is None else format(value, form)

    return cell


def price(field: str, table: str, unit: str, interval: str) -> Cell:
    """A cell with the estimate by an energy table, scaled by an SI prefix.

    interval  field with the bounds; absent in older reports
    """

    def cell(row: Row) -> str:
        value = row[field].get(table)
        if value is None:
            return ABSENT
        low, high = row.get(interval, {}).get(table, (0, None))
        return bounded(f"{scaled(value)}{unit}", value, low, high)

    return cell


def bounded(text: str, value: float, low: float, high: float | None) -> str:
    """A number with its bounds: `≥ 3.2 µJ`, `3.2 µJ ± 11.7 %`, `2.1 µJ to 9.8 µJ`."""
    if high is None or math.isinf(high):
        return f"≥ {text}" if low == value else text
    if low == high:
        return text
    if math.isclose(value - low, high - value, rel_tol=1e-6):
        return f"{text} ± {100 * (high - value) / value:.3g} %"
    unit = text[-1]
    return f"≤ {scaled(high)}{unit}" if low == 0 else f"{scaled(low)}{unit} to {scaled(high)}{unit}"


def scaled(value: float) -> str:
    """The number with an SI prefix, so that it is between 0.1 and 99: `13.03 µ`."""
    prefixes = {1: "", 1e-3: "m", 1e-6: "µ", 1e-9: "n"}
    size = next((size for size in prefixes if value >= 0.1 * size), 1e-9)
    return f"{value / size:.2f} {prefixes[size]}"
