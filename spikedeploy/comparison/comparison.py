"""The result of a comparison: every row beside its reference, and where its energy goes."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

from spikedeploy import envs, zoo
from spikedeploy.comparison.episodes import (
    Episode,
    median_divergence,
    pooled_equality,
    pooled_rmse,
)
from spikedeploy.comparison.lineup import Entry
from spikedeploy.comparison.statistics import (
    bootstrap,
    paired_difference,
    share,
    stratified_bootstrap,
)
from spikedeploy.policies import costs
from spikedeploy.policies.costs import FLOAT_TABLES, Costs, priced_by
from spikedeploy.policies.registry import BASELINES, UNTRAINED
from spikedeploy.runtime.chips.damage import sum_damage
from spikedeploy.runtime.emulator.running_network import chip_or_float
from spikedeploy.runtime.metrics.energy import BREAK_EVEN_TABLES, break_even_sops, static_energy
from spikedeploy.runtime.metrics.energy_tables import STATIC, TABLES
from spikedeploy.setup import Setup

_AGREEMENT = (
    "reference",
    "difference_mean",
    "difference_ci95",
    "ratio_to_reference",
    "success_difference_mean",
    "success_difference_ci95",
    "action_rmse",
    "rmse_to_ann",
    "actions_equal",
    "actions_equal_to_ann",
    "first_divergence",
)


@dataclass(frozen=True)
class Row:
    """One policy on one chip.

    entry: policy and chip
    episodes: in the order of the seeds (n,)
    """

    entry: Entry
    episodes: Sequence[Episode]

    @property
    def returns(self) -> list[float]:
        """Return of each episode (n,)."""
        return [episode.total for episode in self.episodes]

    @property
    def successes(self) -> list[bool]:
        """Success of each episode (n,); empty where the environment does not say."""
        return [episode.success for episode in self.episodes if episode.success is not None]

    @property
    def failures(self) -> list[bool]:
        """Failure of each episode (n,); empty where the environment knows no success."""
        return [episode.failed for episode in self.episodes if episode.failed is not None]

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(np.mean(self.returns))

    @property
    def training_seeds(self) -> int | None:
        """Trainings that it is of: a file holds one; None for what was not trained."""
        return None if self.entry.candidate.format in UNTRAINED else 1

    @cached_property
    def costs(self) -> Costs:
        """Means over the inferences of all episodes."""
        return costs.mean([e.costs for e in self.episodes], [e.steps for e in self.episodes])

    def identity(self) -> dict[str, Any]:
        """Fields that name it."""
        candidate = self.entry.candidate
        return {
            "policy": candidate.name,
            "kind": candidate.kind,
            "chip": self.entry.chip,
            "limits": self.entry.limits,
            "file": zoo.name_in_reports(candidate.path),
            **({"trained_for": candidate.chip} if candidate.chip else {}),
        }

    def metrics(self) -> dict[str, Any]:
        """Means of every metric over the episodes that have it, and of those that were named."""
        names = dict.fromkeys(name for episode in self.episodes for name in episode.metrics)
        found: dict[str, Any] = {
            name: float(np.mean([e.metrics[name] for e in self.episodes if name in e.metrics]))
            for name in names
        }
        # faults of the chip, of those over time in all episodes
        over_time = sum_damage([[d for d in e.damage if d.over_time] for e in self.episodes])
        damage = (*(d for d in self.episodes[0].damage if not d.over_time), *over_time)
        if damage:
            found["faults"] = [asdict(each) for each in damage]
        if named := self.episodes[0].measured:
            found["measured"] = {
                name: float(np.mean([e.measured[name] for e in self.episodes])) for name in named
            }
        return found


@dataclass(frozen=True)
class Comparison:
    """Rows that played the same seeds.

    env: id of the environment
    seeds: (n,)
    rows: in the order of the line-up
    foreign: whether the environment is not ours
    period: time of a control step [s], where it is not as the environment's class says
    """

    env: str
    seeds: Sequence[int]
    rows: Sequence[Row]
    foreign: bool = False
    period: float | None = None

    @property
    def setup(self) -> Setup:
        """The setup, which all rows share."""
        return self.rows[0].entry.setup

    def row(self, entry: Entry | None) -> Row | None:
        """The row of an entry."""
        return next((row for row in self.rows if row.entry == entry), None)

    def of_kind(self, *kinds: str) -> Row | None:
        """The first row of one of the kinds."""
        return next((row for row in self.rows if row.entry.candidate.kind in kinds), None)

    def as_json(self) -> list[dict[str, Any]]:
        """The rows as plain data, for a report."""
        return [
            row.identity()
            | self._performance(row)
            | self._agreement(row)
            | self._costs(row)
            | row.metrics()
            | ({"foreign": True} if self.foreign else {})
            for row in self.rows
        ]

    def _performance(self, row: Row) -> dict[str, Any]:
        """Returns and successes, alone and beside the float ANN and the baseline."""
        ann, baseline = self.of_kind("ann"), self.of_kind(*BASELINES)
        estimate = bootstrap(row.returns, _rng())
        succeeded = share(row.successes) if row.successes else None
        failed = share(row.failures) if row.failures else None
        others = stratified_bootstrap([row.returns], _rng())
        return {
            "training_seeds": row.training_seeds,
            "episodes": len(row.episodes),
            "return_mean": estimate.mean,
            "return_std": float(np.std(row.returns)),
            "return_iqm": others.iqm.mean,
            "risk": others.risk.mean,
            "return_ci95": estimate.ci95,
            "return_iqm_ci95": others.iqm.ci95,
            "risk_ci95": others.risk.ci95,
            "success_rate": succeeded.mean if succeeded else None,
            "success_ci95": succeeded.ci95 if succeeded else None,
            "failure_rate": failed.mean if failed else None,
            "failure_ci95": failed.ci95 if failed else None,
            "ratio_to_float_ann": self._ratio(row, ann) if ann else None,
            "normalised_score": _score(row, baseline, ann) if ann and baseline else None,
            "returns": row.returns,
            "successes": row.successes,
            "failures": row.failures,
        }

    def _ratio(self, row: Row, other: Row) -> float | None:
        """Share of a return; None if the other is not positive, so that a share has no meaning."""
        return row.mean / other.mean if other.mean > 0 or not self.foreign else None

    def _agreement(self, row: Row) -> dict[str, Any]:
        """Differences to the reference and to the float ANN."""
        reference = self.row(row.entry.reference) if row.entry.reference else None
        if reference is None:
            return dict.fromkeys(_AGREEMENT)
        difference = paired_difference(row.returns, reference.returns, _rng())
        known = row.successes and reference.successes
        success = paired_difference(row.successes, reference.successes, _rng()) if known else None
        agreements = {
            name: [episode.agreement[name] for episode in row.episodes]
            for name in row.episodes[0].agreement
        }
        with_reference = agreements[reference.entry.label]
        ann = self.of_kind("ann")
        with_ann = agreements.get(ann.entry.label) if ann else None
        found = (
            reference.entry.label,
            difference.mean,
            difference.ci95,
            self._ratio(row, reference),
            success.mean if success else None,
            success.ci95 if success else None,
            pooled_rmse(with_reference),
            pooled_rmse(with_ann) if with_ann else None,
            pooled_equality(with_reference),
            pooled_equality(with_ann) if with_ann else None,
            median_divergence(with_reference),
        )
        return dict(zip(_AGREEMENT, found, strict=True))

    def _costs(self, row: Row) -> dict[str, Any]:
        """Operations, memory and energy of an inference."""
        found, chip = row.costs, row.entry.chip
        ann = self.of_kind("ann") if row.entry.candidate.kind == "snn" else None
        tables = self.setup.energy or (
            FLOAT_TABLES if chip is None else priced_by(chip_or_float(chip))
        )
        energy, latency = (
            _select_tables(tables, found.energy_j),
            _select_tables(tables, found.latency_s),
        )
        terms = _select_tables(tables, found.energy_terms_j)
        return {
            "clock": found.clock,
            **self._late(found.control_steps_late),
            **found.counts(),
            "macs_effective": found.effective_macs,
            "energy_per_inference_j": {name: each.value for name, each in energy.items()},
            "energy_interval_j": {name: [each.low, each.high] for name, each in energy.items()},
            "latency_per_inference_s": {name: each.value for name, each in latency.items()},
            "latency_interval_s": {name: [each.low, each.high] for name, each in latency.items()},
            "energy_zero_skipping_j": _select_tables(tables, found.energy_zero_skipping_j),
            "energy_terms_j": terms,
            "energy_unknown": {
                n: [*each] for n, each in _select_tables(tables, found.energy_unknown).items()
            },
            "energy_total_j": {name: found.total_j(name) for name in terms},
            "messages_placed_j": _select_tables(tables, found.messages_placed_j),
            "static_energy_j": static(chip, self.env, self.period),
            **_break_even(found, ann.costs if ann else None, tables),
        }

    def _late(self, steps: tuple[int, int] | None) -> dict[str, Any]:
        """Delay from an observation to the first and the last action that it reaches."""
        if steps is None or not any(steps):
            return {}
        period = self.period or control_period(self.env)
        seconds = None if period is None else [n * period for n in steps]
        return {"control_steps_late": list(steps), "late_s": seconds}


def static(chip: str | None, env: str, period: float | None = None) -> dict[str, float]:
    """Measurement -> energy [J] of the chip's static power in a control step; never added.

    period: time of a control step [s] where it is known, else as the environment's class says
    """
    called = chip_or_float(chip) if chip else None
    powers = STATIC.get(called.name, ()) if called else ()
    period = period or (control_period(env) if powers else None)
    return {power.name: static_energy(period, power) for power in powers} if period else {}


def control_period(env: str) -> float | None:
    """Time of a control step [s], as the class of one of ours says; None where it does not."""
    if envs.spec(env).foreign:
        return None
    module, _, name = envs.spec(env).target.partition(":")
    world = getattr(import_module(module), name)
    rate = world.metadata.get("render_fps")
    return getattr(world, "CONTROL_DT", 1.0 / rate if rate else None)


def _select_tables(tables: Sequence[str], found: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of the tables."""
    return {name: found[name] for name in tables if name in found}


def _break_even(found: Costs, ann: Costs | None, tables: Sequence[str]) -> dict[str, Any]:
    """Synaptic operations at which a spiking row would cost what the float ANN costs, by table.

    Of all known terms; against the dense network, and against the one that skips zeros.
    """
    dense: dict[str, float] = {}
    skipping: dict[str, float] = {}
    for name in (n for n in tables if n in BREAK_EVEN_TABLES):
        terms, sops = found.energy_terms_j.get(name), found.sops
        total = ann.total_j(name) if ann else None
        if ann is None or terms is None or sops is None or total is None:
            continue
        dense[name] = break_even_sops(terms, sops, total, TABLES[name])
        if name in ann.energy_zero_skipping_j:
            saved = ann.energy_terms_j[name]["operations"] - ann.energy_zero_skipping_j[name]
            skipping[name] = break_even_sops(terms, sops, total - saved, TABLES[name])
    return {"break_even_sops": dense, "break_even_sops_zero_skipping": skipping}


def _score(row: Row, baseline: Row, ann: Row) -> float | None:
    """Normalised return: 0 for the baseline, 1 for the float ANN; None if the ANN is no better."""
    # score = (return - baseline) / (ANN - baseline)
    span = ann.mean - baseline.mean
    return (row.mean - baseline.mean) / span if span > 0 else None


def _rng() -> np.random.Generator:
    """A generator with a fixed seed: the same episodes give the same interval in any report."""
    return np.random.default_rng(0)
