"""The row that a page is about, and three numbers of it."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from spikedeploy.comparison.summary import (
    describe_episodes,
    describe_macs,
    effective_macs,
    macs,
    smallest_baseline,
)
from spikedeploy.reports.columns import (
    energy_cell,
    format_difference,
    format_return,
    label,
    quoted_table,
    short_label,
)
from spikedeploy.reports.table import ABSENT, HeadlineNumber, Row

_SENTENCE = re.compile(r"(?<=\.)(?<! al\.) (?=\w)")  # between two sentences
_AS_GOOD = 0.95  # of the float ANN's return, or of the best chip's: those that operations decide


def main_row(rows: Sequence[Row]) -> Row:
    """The spiking policy on a chip with the fewest operations among those that are good.

    Good is 95 % of the float ANN's return, or of the best on a chip. Without a chip the first row.
    """
    on_chip = [row for row in rows if row["kind"] == "snn" and row["chip"] not in (None, "float")]
    if not on_chip:
        return rows[0]
    best = max(on_chip, key=lambda row: float(row["return_mean"]))
    ann = ann_row(rows)
    goal = _AS_GOOD * (ann or best)["return_mean"]
    good = [row for row in on_chip if row["return_mean"] >= goal] if goal > 0 else []
    return min(good, key=_operations) if good else best


def ann_row(rows: Sequence[Row]) -> Row | None:
    """The float ANN; None where there is none."""
    return next((row for row in rows if row["kind"] == "ann"), None)


def headline(rows: Sequence[Row], env: str = "") -> list[HeadlineNumber]:
    """Return kept on the chip, operations and energy of a control step, where they are known.

    Operations and energy stand beside the smallest float policy that is not shown to be worse, and
    beside the float ANN.
    """
    row, ann = main_row(rows), ann_row(rows)
    found = (
        [smallest_baseline(row, rows), ann] if row["kind"] == "snn" and "returns" in row else [ann]
    )
    baselines = {each["policy"]: each for each in found if each and each is not row}
    short = short_label(rows, env)
    names = {label(each): short(each) for each in rows}
    name = names[label(row)]
    numbers = (
        _return_number(row, name, names.get(row["reference"], row["reference"])),
        _operations_number(row, baselines.values(), name),
        _energy_number(row, baselines.values()),
    )
    return [each for each in numbers if each]


def verdict(document: Mapping[str, Any]) -> tuple[str, str]:
    """The sentence of a comparison about the row that its page is about, and the others."""
    row, sentences = main_row(document["rows"]), sentences_of(document["meaning"])
    about = f"{row['policy']} on {row['chip']} "
    first = next((each for each in sentences if each.startswith(about)), sentences[0])
    return first, " ".join(each for each in sentences if each != first)


def sentences_of(text: str) -> list[str]:
    """The sentences of a text."""
    return _SENTENCE.split(text)


def describe_disturbances(document: Mapping[str, Any]) -> str:
    """`slope:2 (6 [degrees]), payload=0.4 (0.4 [kg])`; empty without any."""
    found = document.get("disturbances", ())
    return ", ".join(f"{each['text']} ({each['number']:g} [{each['unit']}])" for each in found)


def _return_number(row: Row, name: str, twin: str | None) -> HeadlineNumber:
    earned = f"{format_return(row)} in {describe_episodes(row)}"
    if row.get("ratio_to_reference") is None:
        return HeadlineNumber(f"return of {name}", format_return(row).partition(" ")[0], (earned,))
    of_ann = row.get("ratio_to_float_ann")
    beside = [earned, f"{format_difference(row)} to {twin}"]
    beside += [] if of_ann is None else [f"{of_ann:.1%} of the float ANN"]
    kept = f"{row['ratio_to_reference']:.1%}"
    whose = f"{twin}'s" if row.get("trained_for") else "its float twin's"
    return HeadlineNumber(f"return kept on {row['chip']}, of {whose}", kept, tuple(beside))


def _operations_number(row: Row, baselines: Iterable[Row], name: str) -> HeadlineNumber | None:
    count = _operations(row)
    if count <= 0:
        return None
    unit = "SOPs" if row.get("sops_per_inference") is not None else "dense MACs"
    beside = [
        f"{each['policy']}: {_macs(each)}, {_times(macs(each) / count)} as many"
        for each in baselines
        if math.isfinite(macs(each))
    ]
    title = f"operations of a control step, {name}"
    return HeadlineNumber(title, f"{count:,.0f} {unit}", tuple(beside))


def _energy_number(row: Row, baselines: Iterable[Row]) -> HeadlineNumber | None:
    table = quoted_table([row])
    joules = row["energy_per_inference_j"].get(table)
    if not joules:
        return None
    energy = energy_cell(table)
    priced = [(each, each["energy_per_inference_j"].get(table)) for each in baselines]
    beside = [
        f"{each['policy']}: {energy(each)}, {_times(other / joules)} as much"
        for each, other in priced
        if other
    ]
    by = f"by {table}" + (", which prices float networks too" if beside else "")
    return HeadlineNumber(
        "energy of a control step",
        energy(row),
        (by, *beside, *_other_energies(row)),
    )


def _other_energies(row: Row) -> list[str]:
    """Its energy by other tables: `by loihi1's own tables: 33.36 nJ (davies2018)`."""
    others = [name for name in row["energy_per_inference_j"] if name != quoted_table([row])]
    energy = {name: energy_cell(name)(row) for name in others}
    beside = ", ".join(f"{cell} ({name})" for name, cell in energy.items() if cell != ABSENT)
    whose = f"{row['chip']}'s own" if row["chip"] else "other"
    return [f"by {whose} tables: {beside}"] if beside else []


def _macs(row: Row) -> str:
    """`20,864 MACs`, or `13,289 MACs of 20,864 dense`: those whose input is not 0, of all."""
    effective, dense = effective_macs(row), row.get("macs_dense")
    has_zeros = effective is not None and dense and round(effective) != round(dense)
    return f"{describe_macs(row)} of {dense:,.0f} dense" if has_zeros else describe_macs(row)


def _times(ratio: float) -> str:
    return f"{ratio:,.0f} times" if ratio >= 10 else f"{ratio:.2g} times"


def _operations(row: Row) -> float:
    sops = row.get("sops_per_inference")
    return float(sops if sops is not None else row.get("macs_dense") or 0.0)
