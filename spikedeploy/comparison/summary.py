"""The result of a comparison in a few sentences."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from spikedeploy.comparison.metrics import drives
from spikedeploy.comparison.statistics import FEWEST, paired_difference
from spikedeploy.policies.registry import BASELINES

Row = Mapping[str, Any]  # of Comparison.as_json

_NAMES = {"gait": "The gait alone", "random": "Drawing actions at random"}


class _Words(NamedTuple):
    """Of a task: the field of a row by which policies are equal, and what being so is called."""

    field: str
    less: str
    equal: str
    more: str
    all_more: str


_WALK = _Words("returns", "earn less", "earns as much", "earns more", "earn more")
_RACE = _Words("successes", "finish less often", "finishes as often", "finishes more often",
               "finish more often")  # fmt: skip


def has_few_episodes(row: Row) -> bool:
    """Return True if a row has too few episodes for an interval."""
    return bool(row.get("episodes", FEWEST) < FEWEST)


def describe_episodes(row: Row) -> str:
    """`100 episodes`, `2 episodes, too few for an interval`."""
    count = row["episodes"]
    remark = ", too few for an interval" if has_few_episodes(row) and count > 1 else ""
    return f"{count} episode{'s' if count > 1 else ''}{remark}"


def summary(rows: Sequence[Row]) -> str:
    """Sentences on the chip beside its float twin, the smallest float policy and the controls."""
    on_chip = [r for r in rows if r["kind"] == "snn" and r["chip"] != "float"]
    # a row alone is what its numbers say
    on_chip = [r for r in on_chip if r["reference"] or (len(rows) > 1 and not _twin(r))]
    racing, foreign = any(map(drives, rows)), any(row.get("foreign") for row in rows)
    told = _earns if foreign else _finishes if racing else _keeps
    words = _RACE if racing else _WALK
    sentences = []
    for row in on_chip:
        sentences.append(told(row))
        if not _twin(row):
            sentences.append(
                f"{row['policy']} was trained for {row['trained_for']}, and no float twin stands "
                "beside it."
            )
        sentences.extend(() if has_few_episodes(row) else _smallest(row, rows, words))
    if any(map(has_few_episodes, on_chip)):
        sentences.append(f"Fewer than {FEWEST} episodes do not show which policies {words.less}.")
    if any("MACs a control step" in sentence for sentence in sentences):
        sentences.append("Neuron updates and the encoder are in neither count.")
    sentence_of = _baselines if foreign else _race if racing else _controls
    sentences.append(sentence_of(rows))
    sentences.append(_covered(rows))
    return " ".join(dict.fromkeys(filter(None, sentences)))  # some say the same of several rows


def _twin(row: Row) -> bool:
    """Return True if a policy has a float twin: all but those trained for a chip alone."""
    return not row.get("trained_for")


def smallest_baseline(row: Row, rows: Sequence[Row]) -> Row | None:
    """The trained float policy of fewest operations that is not shown to be worse than the row."""
    words = _RACE if any(map(drives, rows)) else _WALK
    return min(_trained(_equal(row, rows, words)), key=macs, default=None)


def macs(row: Row) -> float:
    """MACs of an inference: the effective ones, whose input is not 0; dense where not known."""
    effective, dense = effective_macs(row), row.get("macs_dense")
    return next((float(each) for each in (effective, dense) if each is not None), math.inf)


def effective_macs(row: Row) -> float | None:
    """NeuroBench's Effective_MACs of an inference; None where they are not known."""
    names = ("macs_effective", "effective_macs")
    return next((row[name] for name in names if row.get(name) is not None), None)


def describe_macs(row: Row) -> str:
    """`13,289 MACs`, or `20,864 dense MACs` where how many inputs are 0 is not known."""
    return f"{macs(row):,.0f} {'dense ' if effective_macs(row) is None else ''}MACs"


def _trained(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["training_seeds"]]


def _equal(row: Row, rows: Sequence[Row], words: _Words) -> list[Row]:
    """The rows that do not spike and are not shown to be worse."""
    return [r for r in rows if r["kind"] != "snn" and _difference(r, row, words)[1] >= 0]


def _difference(row: Row, other: Row, words: _Words) -> tuple[float, float]:
    """The 95 % interval of the paired difference."""
    rng = np.random.default_rng(0)
    return paired_difference(row[words.field], other[words.field], rng).ci95


def _smallest(row: Row, rows: Sequence[Row], words: _Words) -> Iterator[str]:
    """The float policy of fewest operations that is not shown to be worse, and scripts likewise."""
    equal = _equal(row, rows, words)
    networks, count = _trained(equal), len(_trained([r for r in rows if r["kind"] != "snn"]))
    if networks:
        baseline = min(networks, key=macs)
        is_counted = math.isfinite(macs(baseline))
        cost = describe_macs(baseline) if is_counted else "MACs that were not counted"
        more = round(row.get("effective_macs") or 0)
        yield (
            f"The smallest float policy not shown to {words.less} is {baseline['policy']}: {cost} "
            f"a control step, to {row['sops_per_inference']:,.0f} synaptic operations"
            f"{f' and {more:,} MACs' if more else ''} of {row['policy']}."
        )
    elif count == 1:
        yield f"The one float policy here is shown to {words.less}."
    elif count:
        yield f"None of the {count} float policies here {words.equal}."
    rest: list[str] = []
    better: list[str] = []
    for each in equal:
        if not each["training_seeds"]:
            is_better = _difference(each, row, words)[0] > 0
            (better if is_better else rest).append(each["policy"])
    if rest:
        verb, either = "is" if len(rest) == 1 else "are", " either" * bool(networks)
        yield f"The {_subject(rest)} {verb} not shown to {words.less}{either}."
    if better:
        verb = words.more if len(better) == 1 else words.all_more
        yield f"The {_subject(better)} {verb} than {row['policy']}."


def _subject(names: Sequence[str]) -> str:
    """`script gait`, `scripts gait and gap`."""
    return f"script{'s' * (len(names) > 1)} {' and '.join(names)}"


# sentences on an SNN on a chip beside its float twin


def _keeps(row: Row) -> str:
    """The share of the return, in an environment of ours."""
    if not _twin(row):
        return _earns(row)
    kept = [f"{row['ratio_to_reference']:.1%} of its float twin's return"]
    if row["ratio_to_float_ann"] is not None:
        kept.append(f"{row['ratio_to_float_ann']:.1%} of the float ANN's")
    between = _between(row, "difference_ci95", "+,.0f")
    return (
        f"{row['policy']} on {row['chip']} keeps {' and '.join(kept)} "
        f"({row['difference_mean']:+,.0f} to the twin{between}) "
        f"and succeeds in {_share(row)} of {describe_episodes(row)}."
    )


def _finishes(row: Row) -> str:
    """The share of races that it finishes."""
    said = f"{row['policy']} on {row['chip']} finishes {_share(row)} of {describe_episodes(row)}"
    if row["success_difference_mean"] is None:
        return f"{said}."
    between = _between(row, "success_difference_ci95", "+.1f", 100)
    other = "its float twin" if _twin(row) else row["reference"]
    return f"{said} ({100 * row['success_difference_mean']:+.1f} points to {other}{between})."


def _earns(row: Row) -> str:
    """The return, in an environment that is not ours."""
    own = _between(row, "return_ci95", ",.4g").removeprefix(", ")
    other = "the twin" if _twin(row) else str(row["reference"])
    whose = "its float twin's return" if _twin(row) else f"the return of {other}"
    share = row["ratio_to_reference"]
    kept = "" if share is None else f"{share:.1%} of {whose}, "
    if row["difference_mean"] is not None:
        between = _between(row, "difference_ci95", "+,.3g")
        kept += f"{row['difference_mean']:+,.3g} to {other}{between}"
    succeeded = "" if row["success_rate"] is None else f", and succeeds in {_share(row)} of them"
    found = "; ".join(filter(None, (own, kept.removesuffix(", "))))
    more = f" ({found})" if found else ""
    return (
        f"{row['policy']} on {row['chip']} earns {row['return_mean']:,.4g}{more} "
        f"in {describe_episodes(row)}{succeeded}."
    )


def _between(row: Row, field: str, form: str, scale: float = 1) -> str:
    """`, 95% interval -40 to +1`; empty of few episodes, and where nothing differs to resample."""
    if has_few_episodes(row):
        return ""
    if row[field][0] == row[field][1]:
        return ", the same in every episode"
    low, high = (f"{scale * bound:{form}}" for bound in row[field])
    return f", 95% interval {low} to {high}"


def _share(row: Row) -> str:
    return "all" if row["success_rate"] == 1 else f"{row['success_rate']:.0%}"


# sentences on the others


def _controls(rows: Sequence[Row]) -> str:
    """The baseline and the best control."""
    kinds = (*BASELINES, "control")
    plain = [r for r in rows if r["kind"] in kinds and r["ratio_to_float_ann"]]
    if not plain:
        return ""
    best = max(plain, key=lambda row: row["return_mean"])
    baseline = next((row for row in plain if row["kind"] in BASELINES), None)
    control, share = f"best control ({best['policy']})", f"{best['ratio_to_float_ann']:.1%}"
    if baseline is None:
        return f"The {control} earns {share} of the float ANN's return."
    alone = f"{_NAMES[baseline['kind']]} earns {baseline['ratio_to_float_ann']:.1%}"
    beside = "" if best is baseline else f", the {control} {share}"
    return f"{alone} of the float ANN's return{beside}."


def _race(rows: Sequence[Row]) -> str:
    """Shares of races that the float ANN and the controls finish."""
    ann = next((row for row in rows if row["kind"] == "ann"), None)
    plain = [row for row in rows if row["kind"] in (*BASELINES, "control")]
    if not ann or not plain:
        return ""
    others = ", ".join(f"{row['policy']} {row['success_rate']:.0%}" for row in plain)
    return f"The float ANN finishes {ann['success_rate']:.0%}, the controls {others}."


def _baselines(rows: Sequence[Row]) -> str:
    """The float ANN and random actions."""
    names = {"ann": "The float ANN", **_NAMES}
    found = [row for row in rows if row["kind"] in names]
    return " ".join(f"{names[row['kind']]} earns {row['return_mean']:,.4g}." for row in found)


def _covered(rows: Sequence[Row]) -> str:
    """The sentence on what the intervals cover, where no row is of several trainings."""
    trained = _trained(rows)
    if len(rows) < 2 or not trained or any(row["training_seeds"] > 1 for row in trained):
        return ""
    measured = "." if any(row.get("foreign") for row in rows) else ": results/README.md."
    few = has_few_episodes(trained[0])
    covered = "Rows are" if few else f"Intervals cover {describe_episodes(trained[0])}"
    return f"{covered} of one training each; other trainings differ{measured}"
