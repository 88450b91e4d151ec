"""The result of a comparison in two or three sentences."""

from collections.abc import Mapping, Sequence
from typing import Any

from spikedeploy.comparison.metrics import drives
from spikedeploy.policies.interface import BASELINES

Row = Mapping[str, Any]  # of Comparison.as_json

_NEEDED = 0.95  # of the ANN's return: a control that reaches this much is as good
_NAMES = {"gait": "The gait alone", "random": "Drawing actions at random"}


def summary(rows: Sequence[Row]) -> str:
    """What the chip keeps of the float twin, and what the network is worth beside controls."""
    on_chip = [r for r in rows if r["kind"] == "snn" and r["chip"] != "float" and r["reference"]]
    racing = any(map(drives, rows))
    sentences = [_finishes(row) if racing else _on_chip(row) for row in on_chip]
    return " ".join([*sentences, _race(rows) if racing else _worth(rows)]).strip()


def _on_chip(row: Row) -> str:
    kept = [f"{row['ratio_to_reference']:.1%} of its float twin's return"]
    if row["ratio_to_float_ann"] is not None:
        kept.append(f"{row['ratio_to_float_ann']:.1%} of the float ANN's")
    low, high = row["difference_ci95"]
    return (
        f"{row['policy']} on {row['chip']} keeps {' and '.join(kept)} "
        f"({row['difference_mean']:+,.0f} to the twin, 95% interval {low:+,.0f} to {high:+,.0f}) "
        f"and succeeds in {_share(row)} of {row['episodes']} episodes."
    )


def _share(row: Row) -> str:
    return "all" if row["success_rate"] == 1 else f"{row['success_rate']:.0%}"


def _worth(rows: Sequence[Row]) -> str:
    """What the baseline and the best control reach."""
    kinds = (*BASELINES, "control")
    plain = [r for r in rows if r["kind"] in kinds and r["ratio_to_float_ann"]]
    if not plain:
        return ""
    best = max(plain, key=lambda row: row["return_mean"])
    share = best["ratio_to_float_ann"]
    verdict = (
        "so on this task alone the network is not shown to be needed"
        if share >= _NEEDED
        else "so the rest is what the network is worth"
    )
    baseline = next((row for row in plain if row["kind"] in BASELINES), None)
    alone = (
        f"{_NAMES[baseline['kind']]} earns {baseline['ratio_to_float_ann']:.1%} of the float ANN's "
        "return"
        if baseline
        else ""
    )
    if best is baseline:
        return f"{alone}, {verdict}."
    control = f"the best control ({best['policy']}) {share:.1%}"
    return f"{alone}, {control}: {verdict}."


def _finishes(row: Row) -> str:
    """How often an SNN on a chip finishes, beside its float twin."""
    low, high = (100 * bound for bound in row["success_difference_ci95"])
    return (
        f"{row['policy']} on {row['chip']} finishes {_share(row)} of {row['episodes']} episodes "
        f"({100 * row['success_difference_mean']:+.1f} points to its float twin, 95% interval "
        f"{low:+.1f} to {high:+.1f})."
    )


def _race(rows: Sequence[Row]) -> str:
    """How often the float ANN finishes, and what drives without a trained network."""
    ann = next((row for row in rows if row["kind"] == "ann"), None)
    plain = [row for row in rows if row["kind"] in (*BASELINES, "control")]
    if not ann or not plain:
        return ""
    others = ", ".join(f"{row['policy']} {row['success_rate']:.0%}" for row in plain)
    best = max(plain, key=lambda row: row["success_rate"])
    verdict = (
        f"so on this track alone {best['policy']} is enough"
        if best["success_rate"] >= _NEEDED * ann["success_rate"]
        else "so the rest is what the network is worth"
    )
    return f"The float ANN finishes {ann['success_rate']:.0%}, the controls {others}: {verdict}."
