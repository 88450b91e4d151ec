"""The result of a comparison: every row beside its reference, and where its energy goes.

A row of a report is made of `Performance`, `ReferenceAgreement`, `policies.costs.Costs` and the
metrics of episodes, whose fields say how a report shows them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from spikedeploy import zoo
from spikedeploy.comparison.episodes import (
    Episode,
    median_divergence,
    pooled_equality,
    pooled_rmse,
)
from spikedeploy.comparison.statistics import (
    bootstrap,
    paired_difference,
    share,
    stratified_bootstrap,
)
from spikedeploy.evaluation_setup import Setup
from spikedeploy.policies import costs
from spikedeploy.policies.costs import FLOAT_TABLES, Costs, priced_by, reported
from spikedeploy.policies.registry import BASELINES, UNTRAINED, Entry
from spikedeploy.runtime.chips.damage import sum_damage
from spikedeploy.runtime.emulator.running_network import chip_or_float
from spikedeploy.runtime.metrics.energy import BREAK_EVEN_TABLES, break_even_sops, static_energy
from spikedeploy.runtime.metrics.energy_tables import STATIC, TABLES

Interval = tuple[float, float]


@dataclass(frozen=True)
class PolicyRow:
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


@dataclass(frozen=True, kw_only=True)
class Performance:
    """Returns and successes of a row, alone and beside the float ANN and the baseline.

    A `reported` field is a column, whose place `reports.columns` names; the table of 80 columns has
    those that `short_columns` picks there.

    training_seeds: trainings that it is of: a file holds one; None for what was not trained
    return_std: standard deviation of the episodes
    return_ci95, ...: 95 % intervals, of rates by Wilson, else by the bootstrap
    success_rate: by the environment, the key of --success, or the registered threshold of returns
    failure_rate: a terminal state other than success: a fall, a crash, a stall
    normalised_score: (return - baseline) / (ANN - baseline); random actions, or the gait alone
    returns, successes, failures: of each episode (n,)
    """

    training_seeds: int | None
    episodes: int
    return_mean: float = reported("mean of the episodes, with its 95% interval", "return", ",.Rf")
    return_std: float
    return_ci95: Interval
    return_iqm: float = reported("mean of the middle half of the returns", "IQM", ",.Rf")
    return_iqm_ci95: Interval
    risk: float = reported("mean return of the worst 5% of the episodes", "risk", ",.Rf")
    risk_ci95: Interval
    success_rate: float | None = reported("episodes that succeed", "success", ".0%")
    success_ci95: Interval | None
    failure_rate: float | None = reported("episodes that end in a failure", "ended early", ".0%")
    failure_ci95: Interval | None
    ratio_to_float_ann: float | None = reported("return / that of the float ANN", "of ANN", ".1%")
    normalised_score: float | None = reported("0: the baseline; 100: the ANN", "score", ".0p")
    returns: list[float]
    successes: list[bool]
    failures: list[bool]

    @classmethod
    def from_row(
        cls, row: PolicyRow, ann: PolicyRow | None, baseline: PolicyRow | None, foreign: bool
    ) -> "Performance":
        """Return that of a row; intervals of one row are the same in any report."""
        estimate = bootstrap(row.returns, _rng())
        others = stratified_bootstrap([row.returns], _rng())
        succeeded = share(row.successes) if row.successes else None
        failed = share(row.failures) if row.failures else None
        return cls(
            training_seeds=None if row.entry.candidate.format in UNTRAINED else 1,
            episodes=len(row.episodes),
            return_mean=estimate.mean,
            return_std=float(np.std(row.returns)),
            return_iqm=others.iqm.mean,
            risk=others.risk.mean,
            return_ci95=estimate.ci95,
            return_iqm_ci95=others.iqm.ci95,
            risk_ci95=others.risk.ci95,
            success_rate=succeeded.mean if succeeded else None,
            success_ci95=succeeded.ci95 if succeeded else None,
            failure_rate=failed.mean if failed else None,
            failure_ci95=failed.ci95 if failed else None,
            ratio_to_float_ann=_ratio(row, ann, foreign) if ann else None,
            normalised_score=_score(row, baseline, ann) if ann and baseline else None,
            returns=row.returns,
            successes=row.successes,
            failures=row.failures,
        )


@dataclass(frozen=True, kw_only=True)
class ReferenceAgreement:
    """Differences of a row to its reference and to the float ANN; None where there is none.

    reference: on a chip its float twin, else the float ANN
    difference_mean: on the same seeds, paired, with its 95 % interval
    actions_equal, action_rmse: on observations of the reference; ..._to_ann: of the float ANN
    first_divergence: median control step; None where half of the episodes never diverge
    """

    reference: str | None = reported("policy of comparison", "reference", "")
    difference_mean: float | None = reported("of return, paired", "difference", "+,.Rf")
    difference_ci95: Interval | None = None
    ratio_to_reference: float | None = reported("of the mean returns", "ratio", ".1%")
    success_difference_mean: float | None = reported("in percentage points", "finished", "+.1p")
    success_difference_ci95: Interval | None = None
    actions_equal: float | None = reported("equal actions", "same action", ".1%")
    actions_equal_to_ann: float | None = reported("the same, with the float ANN", "as ANN", ".1%")
    action_rmse: float | None = reported("of all actions", "action RMSE", ".4f")
    rmse_to_ann: float | None = reported("the same, with the float ANN", "to ANN", ".4f")
    first_divergence: float | None = reported("actions differ by 0.01", "diverges", ",.0f")

    @classmethod
    def from_rows(
        cls, row: PolicyRow, reference: PolicyRow, ann: PolicyRow | None, foreign: bool
    ) -> "ReferenceAgreement":
        """Return that of two rows on the same seeds."""
        difference = paired_difference(row.returns, reference.returns, _rng())
        known = row.successes and reference.successes
        success = paired_difference(row.successes, reference.successes, _rng()) if known else None
        agreements = {
            name: [episode.agreement[name] for episode in row.episodes]
            for name in row.episodes[0].agreement
        }
        with_reference = agreements[reference.entry.label]
        with_ann = agreements.get(ann.entry.label) if ann else None
        return cls(
            reference=reference.entry.label,
            difference_mean=difference.mean,
            difference_ci95=difference.ci95,
            ratio_to_reference=_ratio(row, reference, foreign),
            success_difference_mean=success.mean if success else None,
            success_difference_ci95=success.ci95 if success else None,
            action_rmse=pooled_rmse(with_reference),
            rmse_to_ann=pooled_rmse(with_ann) if with_ann else None,
            actions_equal=pooled_equality(with_reference),
            actions_equal_to_ann=pooled_equality(with_ann) if with_ann else None,
            first_divergence=median_divergence(with_reference),
        )


@dataclass(frozen=True)
class Comparison:
    """Rows that played the same seeds.

    env: id of the environment
    seeds: (n,)
    rows: in the order of the line-up
    foreign: whether the environment is not ours
    period: time of a control step [s]; None where it is not known
    """

    env: str
    seeds: Sequence[int]
    rows: Sequence[PolicyRow]
    foreign: bool = False
    period: float | None = None

    @property
    def setup(self) -> Setup:
        """The setup, which all rows share."""
        return self.rows[0].entry.setup

    def row(self, entry: Entry | None) -> PolicyRow | None:
        """The row of an entry."""
        return next((row for row in self.rows if row.entry == entry), None)

    def of_kind(self, *kinds: str) -> PolicyRow | None:
        """The first row of one of the kinds."""
        return next((row for row in self.rows if row.entry.candidate.kind in kinds), None)

    def as_json(self) -> list[dict[str, Any]]:
        """The rows as plain data, for a report."""
        ann, baseline = self.of_kind("ann"), self.of_kind(*BASELINES)
        found = []
        for row in self.rows:
            reference = self.row(row.entry.reference) if row.entry.reference else None
            agreement = (
                ReferenceAgreement.from_rows(row, reference, ann, self.foreign)
                if reference
                else ReferenceAgreement()
            )
            found.append(
                row.identity()
                | vars(Performance.from_row(row, ann, baseline, self.foreign))
                | vars(agreement)
                | self._costs(row)
                | row.metrics()
                | ({"foreign": True} if self.foreign else {})
            )
        return found

    def _costs(self, row: PolicyRow) -> dict[str, Any]:
        """Operations, memory and energy of an inference."""
        found, chip = row.costs, row.entry.chip
        ann = self.of_kind("ann") if row.entry.candidate.kind == "snn" else None
        tables = self.setup.energy or (
            FLOAT_TABLES if chip is None else priced_by(chip_or_float(chip))
        )

        def by_table(values: Mapping[str, Any]) -> dict[str, Any]:
            return {name: values[name] for name in tables if name in values}

        energy, latency = by_table(found.energy_j), by_table(found.latency_s)
        terms = by_table(found.energy_terms_j)
        return {
            "clock": found.clock,
            **self._late(found.control_steps_late),
            **found.counts(),
            "macs_effective": found.effective_macs,
            "energy_per_inference_j": {name: each.value for name, each in energy.items()},
            "energy_interval_j": {name: [each.low, each.high] for name, each in energy.items()},
            "latency_per_inference_s": {name: each.value for name, each in latency.items()},
            "latency_interval_s": {name: [each.low, each.high] for name, each in latency.items()},
            "energy_zero_skipping_j": by_table(found.energy_zero_skipping_j),
            "energy_terms_j": terms,
            "energy_unknown": {n: [*each] for n, each in by_table(found.energy_unknown).items()},
            "energy_total_j": {name: found.total_j(name) for name in terms},
            "messages_placed_j": by_table(found.messages_placed_j),
            "static_energy_j": static(chip, self.period),
            **_break_even(found, ann.costs if ann else None, tables),
        }

    def _late(self, steps: tuple[int, int] | None) -> dict[str, Any]:
        """Delay from an observation to the first and the last action that it reaches."""
        if steps is None or not any(steps):
            return {}
        seconds = None if self.period is None else [n * self.period for n in steps]
        return {"control_steps_late": list(steps), "late_s": seconds}


def static(chip: str | None, period: float | None) -> dict[str, float]:
    """Measurement -> energy [J] of the chip's static power in a control step; never added.

    period: time of a control step [s]
    """
    called = chip_or_float(chip) if chip else None
    powers = STATIC.get(called.name, ()) if called else ()
    return {power.name: static_energy(period, power) for power in powers} if period else {}


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


def _ratio(row: PolicyRow, other: PolicyRow, foreign: bool) -> float | None:
    """Share of a return; None if the other is not positive, so that a share has no meaning."""
    return row.mean / other.mean if other.mean > 0 or not foreign else None


def _score(row: PolicyRow, baseline: PolicyRow, ann: PolicyRow) -> float | None:
    """Normalised return: 0 for the baseline, 1 for the float ANN; None if the ANN is no better."""
    # score = (return - baseline) / (ANN - baseline)
    span = ann.mean - baseline.mean
    return (row.mean - baseline.mean) / span if span > 0 else None


def _rng() -> np.random.Generator:
    """A generator with a fixed seed: the same episodes give the same interval in any report."""
    return np.random.default_rng(0)
