"""The result of a comparison in a few sentences, and in three numbers of the row it is about.

The published borders weigh synapses: Davidson and Furber 2021 (Frontiers in Neuroscience 15:651141)
find that a rate code costs less below 1.72 spikes a synapse and inference, Dampfhoffer et al. 2023
(IEEE TETCI 7(3):731) below 0.15 to 1.38, for neurons without leak. Where hidden layers are narrow
and events rare, updates of neurons decide instead, and a third rule has them: a network of M
synapses, SOPs and updates U costs less than a float network of its shape, of whose inputs a share
d is not 0, where

    SOPs e_sop + U e_update < d M e_mac
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from spikedeploy.comparison.episode_metrics import drives
from spikedeploy.comparison.statistics import FEWEST, paired_difference
from spikedeploy.reports.columns import (
    describe_episodes,
    energy_cell,
    format_difference,
    format_return,
    has_few_episodes,
    label,
    quoted_table,
    short_label,
)
from spikedeploy.reports.table import ABSENT, COMMON_TABLE, HeadlineNumber, Row, format_si
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.metrics.energy_tables import STATIC, TABLES

_NAMES = {"ann": "the float ANN", "gait": "the gait alone", "random": "random actions"}


class _Words(NamedTuple):
    """Words of a task: the field of a row by which policies are equal, and the name of equality."""

    field: str
    less: str
    equal: str
    others: str


_RETURN = _Words("returns", "earn less", "earns as much", "What the others earn")
_FINISH = _Words(
    "successes", "finish less often", "finishes as often", "How often the others finish"
)
_SENTENCE = re.compile(r"(?<=\.)(?<! al\.) (?=\w)")  # between two sentences
_AS_GOOD = 0.95  # of the float ANN's return, or of the best chip's: those that operations decide

_IN_MEMORY = "horowitz45-int8-acc32"
DAVIDSON, DAMPFHOFFER = 1.72, (0.15, 1.38)  # spikes of a synapse in an inference


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


def summary(rows: Sequence[Row]) -> str:
    """Sentences on the chip beside its float twin, the smallest float policy and the controls."""
    on_chip = [r for r in rows if r["kind"] == "snn" and r["chip"] != "float"]
    # a row alone is what its numbers say
    on_chip = [r for r in on_chip if r["reference"] or (len(rows) > 1 and not _twin(r))]
    words = _words(rows)
    sentences = []
    for row in on_chip:
        sentences.append(_earns(row))
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
    sentences += [_others(rows, words), _covered(rows)]
    return " ".join(dict.fromkeys(filter(None, sentences)))  # some say the same of several rows


def _twin(row: Row) -> bool:
    """Return True if a policy has a float twin: all but those trained for a chip alone."""
    return not row.get("trained_for")


def smallest_baseline(row: Row, rows: Sequence[Row]) -> Row | None:
    """The trained float policy of fewest operations that is not shown to be worse than the row."""
    return min(_trained(_equal(row, rows, _words(rows))), key=macs, default=None)


def _words(rows: Sequence[Row]) -> _Words:
    """Return the words of a race where success is a finish, else those of returns."""
    return _FINISH if any(map(drives, rows)) else _RETURN


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
    scripts = [each["policy"] for each in equal if not each["training_seeds"]]
    if scripts:
        subject = f"script{'s' * (len(scripts) > 1)} {' and '.join(scripts)}"
        verb, either = "is" if len(scripts) == 1 else "are", " either" * bool(networks)
        yield f"The {subject} {verb} not shown to {words.less}{either}."


# sentences on an SNN on a chip beside its float twin, and on the others


def _earns(row: Row) -> str:
    """Return what a policy earns on a chip, and what is left of its reference's return."""
    other = "its float twin" if _twin(row) else str(row["reference"])
    facts = []
    if row["ratio_to_reference"] is not None:
        facts.append(f"{row['ratio_to_reference']:.1%} of the return of {other}")
    if row["difference_mean"] is not None:
        between = _between(row, "difference_ci95", "+,.3g")
        facts.append(f"{row['difference_mean']:+,.3g} to {other}{between}")
    if row.get("ratio_to_float_ann") is not None:
        facts.append(f"{row['ratio_to_float_ann']:.1%} of the float ANN's")
    found = f" ({'; '.join(facts)})" if facts else ""
    said = f"{row['policy']} on {row['chip']} earns {row['return_mean']:,.4g}{found}"
    return f"{said} in {describe_episodes(row)}{_succeeds(row, other)}."


def _succeeds(row: Row, other: str) -> str:
    """Return `, and succeeds in 97% of them (-1.0 points to its float twin)`."""
    if row["success_rate"] is None:
        return ""
    share = "all" if row["success_rate"] == 1 else f"{row['success_rate']:.0%}"
    points = row.get("success_difference_mean")
    if points is None:
        return f", and succeeds in {share} of them"
    between = _between(row, "success_difference_ci95", "+.1f", 100)
    return f", and succeeds in {share} of them ({100 * points:+.1f} points to {other}{between})"


def _between(row: Row, field: str, form: str, scale: float = 1) -> str:
    """`, 95% interval -40 to +1`; empty of few episodes, and where nothing differs to resample."""
    if has_few_episodes(row):
        return ""
    if row[field][0] == row[field][1]:
        return ", the same in every episode"
    low, high = (f"{scale * bound:{form}}" for bound in row[field])
    return f", 95% interval {low} to {high}"


def _others(rows: Sequence[Row], words: _Words) -> str:
    """Return what the float ANN, the baseline and the best control earn, or how many finish."""
    field = "success_rate" if words is _FINISH else "return_mean"
    form = ".0%" if words is _FINISH else ",.4g"
    named = {kind: next((r for r in rows if r["kind"] == kind), None) for kind in _NAMES}
    found = {_NAMES[kind]: row for kind, row in named.items() if row}
    controls = [row for row in rows if row["kind"] == "control" and row[field] is not None]
    if controls:
        best = max(controls, key=lambda row: float(row[field]))
        found[f"the best control ({best['policy']})"] = best
    parts = [f"{name} {row[field]:{form}}" for name, row in found.items() if row[field] is not None]
    return f"{words.others}: {', '.join(parts)}." if parts else ""


def _covered(rows: Sequence[Row]) -> str:
    """The sentence on what the intervals cover, where no row is of several trainings."""
    trained = _trained(rows)
    if len(rows) < 2 or not trained or any(row["training_seeds"] > 1 for row in trained):
        return ""
    measured = "." if any(row.get("foreign") for row in rows) else ": results/README.md."
    few = has_few_episodes(trained[0])
    covered = "Rows are" if few else f"Intervals cover {describe_episodes(trained[0])}"
    return f"{covered} of one training each; other trainings differ{measured}"


# three numbers


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


# whether spiking saves energy


def energy_verdict(rows: Sequence[Row]) -> str:
    """Sentences on the row that a page is about; empty where it does not spike on a chip."""
    row = main_row(rows)
    if row["kind"] != "snn" or row["chip"] in (None, "float"):
        return ""
    return " ".join(filter(None, (_borders(row), _beside(row, rows), static_power(row))))


def _borders(row: Row) -> str:
    """Spikes of a synapse, beside the borders of others and the rule with updates."""
    synapses, sops = row.get("synapses"), row["sops_per_inference"]
    updates = row["neuron_updates_per_inference"]
    if not synapses or sops is None or updates is None:
        return ""
    registers, memory = (_share_of_dense(row, name) for name in (COMMON_TABLE, _IN_MEMORY))
    density = sops / synapses
    low, high = DAMPFHOFFER
    if density < low:
        place = f"below published borders of {low} to {DAVIDSON}"
    elif density > DAVIDSON:
        place = f"above published borders of {low} to {DAVIDSON}"
    else:
        place = f"within published borders, {low} to {high} and {DAVIDSON}"
    return (
        f"A synapse of {row['policy']} receives {density:.2g} spikes a control step, {place} "
        "(Dampfhoffer et al. 2023, Davidson and Furber 2021), which leave out updates of neurons. "
        f"With updates, {row['policy']} takes {registers:.0%} of the energy of a dense float "
        f"network of its shape by {COMMON_TABLE}, which has sums in registers, and {memory:.0%} "
        f"with sums in memory ({_IN_MEMORY}). A float network that skips inputs of 0 takes less "
        "where fewer of its inputs than that are not 0."
    )


def _share_of_dense(row: Row, table: str) -> float:
    """Energy of synapses and updates over that of all multiply-accumulates of the same shape."""
    prices = TABLES[table].joules
    updates = row["neuron_updates_per_inference"] * prices["neuron_update"]
    spent = row["sops_per_inference"] * prices["sop"] + updates
    return float(spent / (row["synapses"] * prices["mac"]))


def _beside(row: Row, rows: Sequence[Row]) -> str:
    """All known terms, beside those of the smallest float policy that is as good."""
    spent = row["energy_total_j"].get(COMMON_TABLE)
    other = smallest_baseline(row, rows) if "returns" in row else None
    dense = other["energy_total_j"].get(COMMON_TABLE) if other else None
    if not spent or not other or not dense:
        return ""
    computed = other["energy_per_inference_j"][COMMON_TABLE]
    beside = dense - computed + other["energy_zero_skipping_j"].get(COMMON_TABLE, computed)
    ratio = spent / beside
    times = f"{ratio:.1f} times" if ratio >= 1 else f"{ratio:.0%} of"
    skips = ", which skips inputs of 0" if beside < dense else ""
    return (
        f"By {COMMON_TABLE} all its known terms are {format_si(spent)}J, {times} the "
        f"{format_si(beside)}J of {other['policy']}{skips}."
    )


def static_power(row: Row) -> str:
    """Idle energy of the chip in a control step, over all that is known of a policy.

    By the chip's own prices, each of its tables; by the common one where it has none.
    """
    if not row["static_energy_j"]:
        return ""
    on, totals = chip(row["chip"]), row["energy_total_j"]
    tables = [table for table in on.energy_tables if totals.get(table)]
    if not tables and totals.get(COMMON_TABLE):
        tables = [COMMON_TABLE]
    if not tables:
        return ""
    first, joules = min(row["static_energy_j"].items(), key=lambda each: each[1])
    power = next(p for p in STATIC[on.name] if p.name == first)
    times = [_magnitude(joules / totals[table]) for table in tables]
    times[0] += f" all known terms of {row['policy']}"
    beside = " and ".join(f"{n} by {table}" for n, table in zip(times, tables, strict=True))
    why = "" if on.energy_tables else f", as no prices of {on.name} are published"
    return (
        f"Static power comes on top: {on.name} idles at "
        f"{format_si(power.watts * power.share)}W ({power.source}), {format_si(joules)}J in a "
        f"control step, {beside}{why}."
    )


def _magnitude(ratio: float) -> str:
    if ratio >= 1e5:
        return f"{ratio / 1e6:,.2g} million times"
    return f"{ratio:,.0f} times" if ratio >= 2 else f"{ratio:.2g} times"
