"""A comparison in one table of at most 80 columns, and a single row of it in one line."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from spikedeploy.comparison.metrics import drives
from spikedeploy.comparison.summary import counted
from spikedeploy.reports.cells import ABSENT, Column, Row, number, price
from spikedeploy.reports.columns import finished, interval, label
from spikedeploy.reports.energy_columns import COMMON_TABLE

WIDTH = 80
_STAMP = re.compile(r"-\d{8}-\d{6}(-\d+)?$")  # when a training began, at the end of its run's name


def short_columns(rows: Sequence[Row], env: str = "") -> list[Column]:
    """Policy, return, share of the float ANN, success, operations, and energy by one table.

    env  id of the environment, which names of runs need not repeat
    """
    table = quoted_table(rows)
    earned = Column("return", "mean return, with its 95% interval", interval)
    success = Column("success", "episodes that succeed", number("success_rate", ".0%"))
    if any(map(drives, rows)):  # what counts there is how many finish
        earned = Column("return", "mean return", number("return_mean", ".1f"))
        words = "episodes that reach the last gate, with the 95% interval"
        success = Column("finished", words, finished)
    columns = [
        earned,
        Column("of ANN", "return / that of the float ANN", number("ratio_to_float_ann", ".1%")),
        success,
        Column("operations", "a control step, of synapses", operations),
        Column("energy", f"a control step, by table {table}", energy_cell(table)),
    ]
    filled = [c for c in columns if any(c.cell(row) != ABSENT for row in rows)]
    return [Column("policy", "policy · chip", short_label(rows, env)), *filled]


def short_label(rows: Sequence[Row], env: str) -> Callable[[Row], str]:
    """Labels whose run names have neither date nor environment, where they still differ."""
    names = {str(row["policy"]) for row in rows}
    part = re.sub(r"[^A-Za-z0-9.-]+", "-", f"-{env}-")  # as the run folder has it
    short = {name: _STAMP.sub("", name).replace(part, "-", 1) for name in names}
    if len(set(short.values())) < len(names):
        return label
    return lambda row: label({**row, "policy": short[str(row["policy"])]})


def quoted_table(rows: Sequence[Row]) -> str:
    """The energy table to quote: the one that prices chips and float networks alike, if any."""
    return quoted_among(name for row in rows for name in row["energy_per_inference_j"])


def quoted_among(tables: Iterable[str]) -> str:
    """The one to quote of these energy tables, if any."""
    names = dict.fromkeys(tables)
    return COMMON_TABLE if COMMON_TABLE in names else next(iter(names), "")


def energy_hint(rows: Sequence[Row]) -> str:
    """Which energy to quote; empty where there is none."""
    table = quoted_table(rows)
    if table == COMMON_TABLE:
        return f"Energy: of operations, by {table}, which prices spiking and float networks alike."
    return f"Energy: of operations, by {table}; say so where you quote it." if table else ""


def verdict(document: Mapping[str, Any]) -> str:
    """The row of a run in one line: return, success, metrics asked for, operations, energy."""
    (row,) = document["rows"]
    done = "finished" if drives(row) else "succeeded"
    said = [
        f"return {interval(row)} in {counted(row)}",
        *([f"{sum(row['successes'])} {done}"] if row["successes"] else []),
        *(f"{name} {value:.4g}" for name, value in row.get("measured", {}).items()),
        *(f"{each} a control step" for each in [operations(row)] if each != ABSENT),
    ]
    table = quoted_table([row])
    cell = energy_cell(table)(row) if table else ABSENT
    if cell != ABSENT:
        said.append(f"{cell} by {table}")
    return f"{label(row)}: {', '.join(said)}."


def operations(row: Row) -> str:
    """Synaptic operations, or the multiply-accumulates of a float network: `748,544 SOPs`."""
    if row.get("sops_per_inference") is not None:
        return f"{row['sops_per_inference']:,.0f} SOPs"
    macs = row.get("macs_dense")
    return f"{macs:,.0f} MACs" if macs else ABSENT


def energy_cell(table: str) -> Any:  # noqa: ANN401
    """A cell with the energy of a control step by a table."""
    return price("energy_per_inference_j", table, "J", "energy_interval_j")
