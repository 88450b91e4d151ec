"""Results of the kart experiment as Markdown tables."""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from spikedeploy.comparison.statistics import Estimate, ratio_of_medians
from spikedeploy.experiments.kart.design import CONTROLS, NETWORKS, PEERS, WORLDS
from spikedeploy.experiments.kart.records import COUNT, NTH, Record
from spikedeploy.policies.interface import FLOAT
from spikedeploy.reports.columns import ABSENT, scaled
from spikedeploy.reports.markdown import markdown_table


def of(rows: Iterable[Record], world: str, policy: str, **more: object) -> list[Record]:
    """The rows of a policy in a world, and with the other fields that are given."""
    wanted = {"world": world, "policy": policy, **more}
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def on_chip(rows: Iterable[Record], world: str) -> list[Record]:
    """The spiking policies of a world where they ran on a chip."""
    return [row for row in of(rows, world, "snn") if row["chip"] != FLOAT]


def learning_table(rows: Sequence[Record], budgets: Mapping[tuple[str, str], int]) -> list[str]:
    """Markdown: steps to the first and to the 300th finish, beside kart-simulator's."""
    heads = ["first finish", f"{COUNT} finishes", "% of ANN"]
    lines = [["world", "policy", "seeds", *heads, *(f"kart-simulator: {head}" for head in heads)]]
    for world in WORLDS:
        for place, policy in enumerate(NETWORKS):
            found, peer = of(rows, world, policy), PEERS[world]
            spiking, budget = policy == "snn", budgets[world, policy]
            lines.append(
                [
                    world,
                    policy,
                    f"{len(found)}",
                    steps([row["first_finish"] for row in found], budget),
                    steps([row[NTH] for row in found], budget),
                    percent_of_ann(rows, world) if spiking else ABSENT,
                    f"{peer.first[place]}k",
                    f"{peer.nth[place]}k",
                    f"{peer.share:.1%}" if spiking else ABSENT,
                ]
            )
    return markdown_table(lines)


def driving_table(rows: Sequence[Record]) -> list[str]:
    """Markdown: greedy episodes of all policies, medians over the trainings."""
    prices = list(dict.fromkeys(key for row in rows for key in row if key.startswith("energy_")))
    heads = {
        "parameters": ("parameters", ",.0f"),
        "finished": ("success_rate", ".0%"),
        "lap [s]": ("lap_time", ".2f"),
        "crashes": ("crashes", ".0%"),
        "sparsity": ("sparsity", ".1%"),
        "spikes": ("spikes_per_inference", ",.0f"),
        "SOPs": ("sops_per_inference", ",.0f"),
        "MACs": ("effective_macs", ",.0f"),
    }
    energies = [price.removeprefix("energy_").removesuffix("_j") for price in prices]
    lines = [["world", "policy", "seeds", *heads, *energies]]
    for world in WORLDS:
        for label, found in _drivers(rows, world):
            cells = [
                _range(found, *how) if head == "finished" else _middle(found, *how)
                for head, how in heads.items()
            ]
            joules = [_joules(found, price) for price in prices]
            lines.append([world, label, f"{len(found)}", *cells, *joules])
    return markdown_table(lines)


def chip_table(rows: Sequence[Record]) -> list[str]:
    """Markdown: every spiking policy on the chip, beside its float twin on the same starts."""
    lines = [["world", "seed", "float twin", "on the chip", "points", "same action"]]
    for world in WORLDS:
        twins = {row["seed"]: row for row in of(rows, world, "snn", chip=FLOAT)}
        lines += [_beside(row, twins[row["seed"]]) for row in on_chip(rows, world)]
    return markdown_table(lines)


def _beside(row: Record, twin: Record) -> list[str]:
    """A spiking policy on the chip beside its float twin."""
    return [
        row["world"],
        f"{row['seed']}",
        f"{twin['success_rate']:.0%}",
        f"{row['success_rate']:.0%}",
        f"{100 * row['success_difference_mean']:+.0f}",
        f"{row['actions_equal']:.1%}",
    ]


def steps(values: Sequence[float], budget: int) -> str:
    """Median [least, most] in thousands: `251k [240k, > 500k]`, where 500k is the budget."""

    def text(value: float) -> str:
        return f"{value / 1000:,.0f}k" if math.isfinite(value) else f"> {budget / 1000:,.0f}k"

    if not values:
        return ABSENT
    return f"{text(float(np.median(values)))} [{text(min(values))}, {text(max(values))}]"


def share(rows: Sequence[Record], world: str) -> Estimate | None:
    """Median steps of the ANN / median steps of the SNN; None where a median was not reached.

    The interval is NaN where single trainings did not reach it.
    """
    ann, snn = ([row[NTH] for row in of(rows, world, policy)] for policy in NETWORKS)
    if not ann or not snn or not all(math.isfinite(np.median(each)) for each in (ann, snn)):
        return None
    if not np.isfinite([*ann, *snn]).all():
        return Estimate(float(np.median(ann) / np.median(snn)), (math.nan, math.nan))
    return ratio_of_medians(ann, snn, np.random.default_rng(0))


def percent_of_ann(rows: Sequence[Record], world: str) -> str:
    """`share` in percent, with its interval."""
    found = share(rows, world)
    if found is None:
        return ABSENT
    low, high = found.ci95
    known = "" if math.isnan(low) else f" [{low:.0%}, {high:.0%}]"
    return f"{found.mean:.1%}{known}"


def _drivers(rows: Sequence[Record], world: str) -> list[tuple[str, list[Record]]]:
    """Label -> rows: networks, then controls, then built-in policies."""
    found: dict[str, list[Record]] = {}
    order = [*NETWORKS, *CONTROLS]
    here = [row for row in rows if row["world"] == world]
    here.sort(key=lambda row: order.index(row["policy"]) if row["policy"] in order else len(order))
    for row in here:
        label = f"{row['policy']} · {row['chip']}" if row["chip"] else row["policy"]
        found.setdefault(label, []).append(row)
    return list(found.items())


def _values(rows: Sequence[Record], field: str) -> list[float]:
    return [row[field] for row in rows if row.get(field) is not None]


def _middle(rows: Sequence[Record], field: str, form: str) -> str:
    """The median of the rows that have the field."""
    values = _values(rows, field)
    return format(float(np.median(values)), form) if values else ABSENT


def _range(rows: Sequence[Record], field: str, form: str) -> str:
    """The median [least, most]; a single value without a range."""
    values, middle = _values(rows, field), _middle(rows, field, form)
    if len(values) < 2:
        return middle
    return f"{middle} [{format(min(values), form)}, {format(max(values), form)}]"


def _joules(rows: Sequence[Record], price: str) -> str:
    values = _values(rows, price)
    return f"{scaled(float(np.median(values)))}J" if values else ABSENT
