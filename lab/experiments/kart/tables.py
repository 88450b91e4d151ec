"""Learning, driving and the chip as Markdown tables, of one preset each."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lab.experiments.kart.design import CORRIDOR, COUNT, GREEDY, PEERS, POLICIES, WORLDS
from lab.experiments.kart.records import FIRST, HELD, NTH, Record
from spikedeploy.comparison.statistics import Estimate, ratio_of_medians
from spikedeploy.policies.registry import FLOAT
from spikedeploy.reports.table import ABSENT, format_si, markdown_text


def of(rows: Iterable[Record], world: str, policy: str, **more: object) -> list[Record]:
    """The rows of a policy in a world, and with the other fields that are given."""
    wanted = {"world": world, "policy": policy, **more}
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def on_chip(rows: Iterable[Record], world: str) -> list[Record]:
    """The spiking policies of a world where they ran on a chip."""
    return [row for row in of(rows, world, "snn") if row["chip"] != FLOAT]


def learning_table(rows: Sequence[Record]) -> list[str]:
    """Markdown: steps to the first and to the 300th finish, and until greedy episodes finish.

    Of corridors, which kart-simulator has no figures of, without its columns.
    """
    beside = not any(row["preset"] == CORRIDOR for row in rows)
    own = ["first finish", f"{COUNT} finishes", "% of ANN"]
    heads = [*own, f"greedy {GREEDY:.0%}", "% of ANN"]
    theirs = [f"kart-simulator: {head}" for head in own if beside]
    lines = [["world", "policy", "seeds", *heads, *theirs]]
    for world in WORLDS:
        for policy in POLICIES:
            found = of(rows, world, policy)
            lines.append(
                [
                    world,
                    policy,
                    f"{len(found)}",
                    steps(found, FIRST),
                    steps(found, NTH),
                    percent_of_ann(rows, world, policy, NTH),
                    steps(found, HELD),
                    percent_of_ann(rows, world, policy, HELD),
                    *(_peer(world, policy) if beside else ()),
                ]
            )
    return markdown_text(lines).splitlines()


def _peer(world: str, policy: str) -> list[str]:
    """kart-simulator's steps to the first and 300th finish, and its SNN's share of its ANN."""
    peer = PEERS[world]
    if policy not in peer.first:
        return 3 * [ABSENT]
    share = f"{peer.share:.1%}" if policy == "snn" else ABSENT
    return [f"{peer.first[policy]}k", f"{peer.nth[policy]}k", share]


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
    return markdown_text(lines).splitlines()


def chip_table(rows: Sequence[Record]) -> list[str]:
    """Markdown: every spiking policy on the chip, beside its float twin on the same starts."""
    lines = [["world", "seed", "float twin", "on the chip", "points", "same action"]]
    for world in WORLDS:
        twins = {row["seed"]: row for row in of(rows, world, "snn", chip=FLOAT)}
        lines += [_beside(row, twins[row["seed"]]) for row in on_chip(rows, world)]
    return markdown_text(lines).splitlines()


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


def steps(rows: Sequence[Record], field: str) -> str:
    """Median [least, most] in thousands: `251k [240k, > 500k]`.

    A training that ended at 500k without counts with these; what it could raise has a `>`.
    """
    if not rows:
        return ABSENT
    values = taken(rows, field)
    ended = [row["env_steps"] for row in rows if math.isinf(row[field])]

    def text(value: float) -> str:
        least = "> " if any(each <= value for each in ended) else ""
        return f"{least}{value / 1000:,.0f}k"

    return f"{text(float(np.median(values)))} [{text(min(values))}, {text(max(values))}]"


def taken(rows: Iterable[Record], field: str) -> list[float]:
    """Steps of trainings (n,) to what a field says; those that never came so far, all they took."""
    return [min(row[field], row["env_steps"]) for row in rows]


@dataclass(frozen=True)
class AnnShare:
    """The median steps of the ANN over those of a policy, with an interval over training seeds.

    estimate  of the share
    bound     "≥" or "≤" where trainings of the ANN, or of the policy, did not come so far: they
              count with all the steps that they took; else empty
    """

    estimate: Estimate
    bound: str = ""

    def __str__(self) -> str:
        """`97.4% [95%, 102%]`, `≥ 151.4% [126%, 193%]`."""
        low, high = self.estimate.ci95
        return f"{self.bound} {self.estimate.mean:.1%} [{low:.0%}, {high:.0%}]".lstrip()

    def mark(self, asked: float) -> str:
        """✓ where the whole interval reaches what is asked, ✗ where none of it can, else ≈."""
        found = self.estimate.mark(asked)
        return "≈" if (self.bound, found) in (("≥", "✗"), ("≤", "✓")) else found


def share(
    rows: Sequence[Record], world: str, policy: str = "snn", field: str = NTH
) -> AnnShare | None:
    """Median steps of the ANN / median steps of a policy.

    None where some trainings of both did not come so far: then it has no bound.
    """
    ann, own = (of(rows, world, each) for each in ("ann", policy))
    late = [any(math.isinf(row[field]) for row in each) for each in (ann, own)]
    if not ann or not own or all(late):
        return None
    bound = "≥" if late[0] else "≤" if late[1] else ""
    top, bottom = taken(ann, field), taken(own, field)
    return AnnShare(ratio_of_medians(top, bottom, np.random.default_rng(0)), bound)


def percent_of_ann(
    rows: Sequence[Record], world: str, policy: str = "snn", field: str = NTH
) -> str:
    """`share` in percent, with its interval; a dash for the ANN itself."""
    found = share(rows, world, policy, field)
    return ABSENT if policy == "ann" or found is None else str(found)


def _drivers(rows: Sequence[Record], world: str) -> list[tuple[str, list[Record]]]:
    """Label -> rows: networks, then controls, then built-in policies."""
    found: dict[str, list[Record]] = {}
    order = list(POLICIES)
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
    """The median energy by a table; with `≥` where it is a lower bound."""
    values, table = _values(rows, price), price.removeprefix("energy_").removesuffix("_j")
    least = "≥ " if any(table in row["energies_at_least"].split() for row in rows) else ""
    return f"{least}{format_si(float(np.median(values)))}J" if values else ABSENT
