"""What the hidden neurons of shipped spiking policies are for: each policy with all of them dead.

    python -m lab hidden-neurons [POLICY …] [--write]

A sparse policy has two ways from events to actions: through spiking neurons, and past them, from
events straight into integrating readouts. The second alone is a linear policy of events. Here all
hidden neurons are dead (the fault `dead-neurons`, level 1), in the episodes of the policy's card,
whose returns stand beside. A policy is called linear in events that keeps LEAST of its return so,
and whose success is not shown to change: the 95 % interval of the difference, paired by episode,
holds 0. Its neurons are needed where that interval is below 0; else nothing is said but the shares.
That hidden neurons spike, by the ledger, says nothing of this: those of all policies here do.

--write puts the rows into results/hidden-neurons.json and onto the cards, of the policies that are
named; others keep theirs. With --no-play the cards are written of the rows that are there.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spikedeploy import zoo
from spikedeploy.comparison.comparison import Row
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.comparison.lineup import Entry
from spikedeploy.comparison.statistics import paired_difference
from spikedeploy.policies.registry import find
from spikedeploy.runtime.faults import faults
from spikedeploy.runtime.files import read_json, write_json, write_text
from spikedeploy.shipping import cards

TABLE = Path(__file__).resolve().parents[2] / "results" / "hidden-neurons.json"
POLICIES = tuple(
    f"{task}/{name}"
    for task in ("kart-grid", "kart-gazebo", "kart-steer", "hexapod", "hexapod-command")
    for name in ("sparse", "sparse-gated")
)
FAULT = "dead-neurons=1"
LEAST = 0.98  # of the return


def read(path: Path = TABLE) -> dict[str, Any]:
    """The row of each policy; empty where there is no table."""
    return read_json(path) if path.is_file() else {}


def measure(policy: str) -> dict[str, Any]:
    """The row of a policy: its card's episodes, played with all hidden neurons dead."""
    card = zoo.card(policy)
    (intact,) = (row for row in card["evaluation"] if row["chip"] not in (None, "float"))
    first = card["seeds"]["first"]
    entry = Entry(replace(find(policy), faults=faults([FAULT])), intact["chip"])
    seeds = range(first, first + intact["episodes"])
    (dead,) = compare_policies(card["env"], [entry], seeds).rows
    return row_of(policy, intact, dead, first)


def row_of(policy: str, intact: Mapping[str, Any], dead: Row, first: int) -> dict[str, Any]:
    """What a policy keeps without its hidden neurons.

    intact  row of its card
    dead    the same episodes
    first   seed of the first
    """
    rng = np.random.default_rng(0)
    fewer = paired_difference(dead.successes, intact["successes"], rng)
    return {
        "command": f"spikedeploy run {policy} --chip {intact['chip']} --fault {FAULT} "
        f"--episodes {intact['episodes']}",
        "chip": intact["chip"],
        "episodes": intact["episodes"],
        "first_seed": first,
        "hidden_spikes": intact["spikes_per_inference"],
        "return_mean": intact["return_mean"],
        "return_mean_dead": dead.mean,
        "kept": dead.mean / intact["return_mean"],
        "success_rate": intact["success_rate"],
        "success_rate_dead": float(np.mean(dead.successes)),
        "success_difference_ci95": list(fewer.ci95),
    }


def is_linear(row: Mapping[str, Any]) -> bool:
    """Whether the policy of a row is called linear in events."""
    low, high = row["success_difference_ci95"]
    return bool(row["kept"] >= LEAST and low <= 0 <= high)


def describe(row: Mapping[str, Any]) -> str:
    """`linear in events: with all hidden neurons dead it keeps 100.5% of its return and …`."""
    verdict = "needed: " if row["success_difference_ci95"][1] < 0 else ""
    return (
        f"{'linear in events: ' if is_linear(row) else verdict}"
        f"with all hidden neurons dead it keeps {row['kept']:.1%} of its return and "
        f"succeeds in {row['success_rate_dead']:.0%} of {row['episodes']} episodes, intact in "
        f"{row['success_rate']:.0%} (`{row['command']}`)"
    )


def write_on_card(policy: str, row: Mapping[str, Any]) -> Path:
    """Write the sentence onto the card and its page; return the card."""
    file = zoo.path(policy)
    assert file is not None  # measured just now
    card = file.with_suffix(".json")
    record = {**read_json(card), "hidden_neurons": describe(row)}
    write_json(card, record)
    write_text(card.with_suffix(".md"), cards.markdown(card.stem, record))
    return card


def main() -> None:
    """Play the policies that are named, by default all, and print a sentence on each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("policies", nargs="*", metavar="POLICY", help=", ".join(POLICIES))
    parser.add_argument("--write", action="store_true", help="into results/ and onto the cards")
    parser.add_argument("--no-play", action="store_true", help="take the rows that are there")
    given = parser.parse_args()
    if unknown := set(given.policies) - set(POLICIES):
        parser.error(f"unknown: {', '.join(sorted(unknown))}. Choose of {', '.join(POLICIES)}.")
    for policy in given.policies or POLICIES:
        if given.no_play and policy not in read():
            continue
        row = read()[policy] if given.no_play else measure(policy)
        print(f"{policy}: {describe(row)}", flush=True)
        if given.write:
            found = {**read(), policy: row}
            write_json(TABLE, {name: found[name] for name in POLICIES if name in found})
            write_on_card(policy, row)
