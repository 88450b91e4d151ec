"""What a comparison means, in two or three sentences, for people who read nothing else."""

from collections.abc import Sequence

from spikedeploy.columns import Row

NEEDED = 0.95  # of the ANN's return: a control that reaches it puts the network's worth in doubt


def meaning(rows: Sequence[Row]) -> str:
    """The sentences: what the chip keeps, and what the network was worth in the first place."""
    on_chip = [r for r in rows if r["kind"] == "snn" and r["chip"] != "float" and r["reference"]]
    sentences = [_on_chip(row) for row in on_chip]
    return " ".join([*sentences, _worth(rows)]).strip()


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
    """What the gait alone and the best control reach without a network."""
    plain = [r for r in rows if r["kind"] in ("gait", "control") and r["ratio_to_float_ann"]]
    if not plain:
        return ""
    best = max(plain, key=lambda row: row["return_mean"])
    share = best["ratio_to_float_ann"]
    verdict = (
        "so on this task alone the network is not shown to be needed"
        if share >= NEEDED
        else "so the rest is what the network is worth"
    )
    gait = next((row for row in plain if row["kind"] == "gait"), None)
    alone = (
        f"The gait alone earns {gait['ratio_to_float_ann']:.1%} of the float ANN's return"
        if gait
        else ""
    )
    if best is gait:
        return f"{alone}, {verdict}."
    control = f"the best control ({best['policy']}) {share:.1%}"
    return f"{alone}, {control}: {verdict}."
