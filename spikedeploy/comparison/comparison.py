"""Where the energy of an inference goes, for a report: terms, totals, unknowns, break-even."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from typing import Any

import numpy as np

from spikedeploy import envs, zoo
from spikedeploy.comparison.episodes import Episode, median_divergence, pooled_equality, pooled_rmse
from spikedeploy.comparison.lineup import Entry
from spikedeploy.comparison.statistics import bootstrap, paired_difference, share, stratified
from spikedeploy.policies import costs
from spikedeploy.policies.costs import FLOAT_TABLES, Costs, priced_by
from spikedeploy.policies.registry import BASELINES, UNTRAINED
from spikedeploy.runtime.chips.damage import summed
from spikedeploy.runtime.emulator.network import chip_called
from spikedeploy.runtime.metrics.energy import (
    BREAK_EVEN_TABLES,
    STATIC,
    TABLES,
    EnergyEstimate,
    break_even_sops,
    static_energy,
)

# Where the energy of an inference goes, for a report: terms, totals, unknowns, br


def accounted(found: Costs, tables: Sequence[str]) -> dict[str, Any]:
    """The fields of a row that say where its energy goes, by the tables."""
    return {
        "macs_effective": found.effective_macs,
        "energy_zero_skipping_j": _of(found.energy_zero_skipping_j, tables),
        "energy_terms_j": _of(found.energy_terms_j, tables),
        "energy_unknown": {n: list(each) for n, each in _of(found.energy_unknown, tables).items()},
        "energy_total_j": {n: found.total_j(n) for n in _of(found.energy_terms_j, tables)},
        "neuron_updates_per_inference": found.neuron_updates,
        "neuron_idle_per_inference": found.neuron_idle,
        "messages_per_inference": found.messages,
        "messages_placed": found.messages_placed,
        "messages_placed_j": _of(found.messages_placed_j, tables),
    }


def _of(found: Mapping[str, Any], tables: Iterable[str]) -> dict[str, Any]:
    """The entries of the tables that are asked for."""
    return {name: found[name] for name in tables if name in found}


def static(chip: str | None, env: str, period: float | None = None) -> dict[str, float]:
    """Measurement -> energy [J] of the chip's static power in a control step; never added.

    period  of a control step [s] where it is known, else as the environment's class says
    """
    called = chip_called(chip) if chip else None
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


def break_even(found: Costs, ann: Costs | None, tables: Sequence[str]) -> dict[str, Any]:
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


# The result of a comparison: every row beside its reference.


@dataclass(frozen=True)
class Row:
    """One policy on one chip.

    entry     policy and chip
    episodes  in the order of the seeds (n,)
    """

    entry: Entry
    episodes: Sequence[Episode]

    @property
    def returns(self) -> list[float]:
        """Return of each episode (n,)."""
        return [episode.total for episode in self.episodes]

    @property
    def successes(self) -> list[bool]:
        """Whether each episode succeeded (n,); empty where the environment does not say."""
        return [episode.success for episode in self.episodes if episode.success is not None]

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(np.mean(self.returns))

    @property
    def training_seeds(self) -> int | None:
        """How many trainings it is of: a file holds one; None for what was not trained."""
        return None if self.entry.candidate.format in UNTRAINED else 1


@dataclass(frozen=True)
class Comparison:
    """Rows that played the same seeds.

    env    id of the environment
    seeds  (n,)
    rows   in the order of the line-up
    tables energy tables to price by; empty for those of each row's chip
    disturb  disturbances of the world
    foreign  whether the environment is not ours
    period   time of a control step [s] of one that is not ours, where it says so
    """

    env: str
    seeds: Sequence[int]
    rows: Sequence[Row]
    tables: Sequence[str] = ()
    disturb: Sequence[str] = ()
    foreign: bool = False
    period: float | None = None

    def row(self, entry: Entry | None) -> Row | None:
        """The row of an entry."""
        return next((row for row in self.rows if row.entry == entry), None)

    def of_kind(self, *kinds: str) -> Row | None:
        """The first row of one of the kinds."""
        return next((row for row in self.rows if row.entry.candidate.kind in kinds), None)

    def as_json(self) -> list[dict[str, Any]]:
        """The rows as plain data, for a report."""
        return [
            _identity(row)
            | self._performance(row)
            | self._agreement(row)
            | self._costs(row)
            | _metrics(row)
            | _faults(row)
            | _measured(row)
            | ({"foreign": True} if self.foreign else {})
            for row in self.rows
        ]

    def _costs(self, row: Row) -> dict[str, Any]:
        """Operations, memory and energy of an inference."""
        found = _mean_costs(row)
        ann = self.of_kind("ann") if row.entry.candidate.kind == "snn" else None
        tables = self.tables or _tables(row)
        energy, latency = _priced(found.energy_j, tables), _priced(found.latency_s, tables)
        return {
            "clock": found.clock,
            **self._late(found.control_steps_late),
            "sparsity": found.sparsity,
            "spikes_per_inference": found.spikes,
            "input_spikes_per_inference": found.input_spikes,
            "sops_per_inference": found.sops,
            "bias_sops_per_inference": found.bias_sops,
            "effective_acs": found.effective_acs,
            "effective_macs": found.effective_macs,
            "macs_dense": found.dense,
            "footprint": found.footprint,
            "footprint_packed": found.footprint_packed,
            "connection_sparsity": found.connection_sparsity,
            "energy_per_inference_j": {name: each.value for name, each in energy.items()},
            "energy_interval_j": {name: [each.low, each.high] for name, each in energy.items()},
            "latency_per_inference_s": {name: each.value for name, each in latency.items()},
            "latency_interval_s": {name: [each.low, each.high] for name, each in latency.items()},
            "saturations": found.saturations,
            **accounted(found, tables),
            "static_energy_j": static(row.entry.chip, self.env, self.period),
            **break_even(found, _mean_costs(ann) if ann else None, tables),
        }

    def _late(self, steps: tuple[int, int] | None) -> dict[str, Any]:
        """From an observation to the first and the last action that it reaches, in time too."""
        if steps is None or not any(steps):
            return {}
        period = self.period or control_period(self.env)
        seconds = None if period is None else [n * period for n in steps]
        return {"control_steps_late": list(steps), "late_s": seconds}

    def _performance(self, row: Row) -> dict[str, Any]:
        """Returns and successes, alone and beside the float ANN and the baseline."""
        ann, baseline = self.of_kind("ann"), self.of_kind(*BASELINES)
        estimate = bootstrap(row.returns, _rng())
        succeeded = share(row.successes) if row.successes else None
        others = stratified([row.returns], _rng())
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
            "ratio_to_float_ann": self._ratio(row, ann) if ann else None,
            "normalised_score": _score(row, baseline, ann) if ann and baseline else None,
            "returns": row.returns,
            "successes": row.successes,
        }

    def _ratio(self, row: Row, other: Row) -> float | None:
        """Share of a return; None of one that is not positive, of which a share says nothing."""
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
        return {
            "reference": reference.entry.label,
            "difference_mean": difference.mean,
            "difference_ci95": difference.ci95,
            "ratio_to_reference": self._ratio(row, reference),
            "success_difference_mean": success.mean if success else None,
            "success_difference_ci95": success.ci95 if success else None,
            "action_rmse": pooled_rmse(with_reference),
            "rmse_to_ann": pooled_rmse(with_ann) if with_ann else None,
            "actions_equal": pooled_equality(with_reference),
            "actions_equal_to_ann": pooled_equality(with_ann) if with_ann else None,
            "first_divergence": median_divergence(with_reference),
        }


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


def _identity(row: Row) -> dict[str, Any]:
    candidate = row.entry.candidate
    return {
        "policy": candidate.name,
        "kind": candidate.kind,
        "chip": row.entry.chip,
        "limits": row.entry.limits,
        "file": zoo.called(candidate.path),
        **({"trained_for": candidate.chip} if candidate.chip else {}),
    }


def _score(row: Row, baseline: Row, ann: Row) -> float | None:
    """Normalised return: 0 for the baseline, 1 for the float ANN; None if the ANN is no better."""
    # score = (return - baseline) / (ANN - baseline)
    span = ann.mean - baseline.mean
    return (row.mean - baseline.mean) / span if span > 0 else None


def _mean_costs(row: Row) -> costs.Costs:
    """Means over the inferences of all episodes."""
    return costs.mean([e.costs for e in row.episodes], [e.steps for e in row.episodes])


def _priced(
    prices: Mapping[str, EnergyEstimate], tables: Sequence[str]
) -> dict[str, EnergyEstimate]:
    """The estimates by the tables that are asked for."""
    return {name: prices[name] for name in tables if name in prices}


def _tables(row: Row) -> tuple[str, ...]:
    """The energy tables of a row: those of its chip, or those that price a float network."""
    if row.entry.chip is None:
        return FLOAT_TABLES
    return priced_by(chip_called(row.entry.chip))


def _metrics(row: Row) -> dict[str, float]:
    """Mean of every metric over the episodes that have it."""
    names = dict.fromkeys(name for episode in row.episodes for name in episode.metrics)
    return {
        name: float(np.mean([e.metrics[name] for e in row.episodes if name in e.metrics]))
        for name in names
    }


def _measured(row: Row) -> dict[str, Any]:
    """Metrics that were asked for, means over the episodes; nothing where none were."""
    names = row.episodes[0].measured
    found = {name: float(np.mean([e.measured[name] for e in row.episodes])) for name in names}
    return {"measured": found} if found else {}


def _faults(row: Row) -> dict[str, Any]:
    """What faults of the chip hit, of those over time in all episodes; nothing without faults."""
    first = row.episodes[0].damage
    over_time = summed([[d for d in e.damage if d.over_time] for e in row.episodes])
    found = [asdict(d) for d in (*(d for d in first if not d.over_time), *over_time)]
    return {"faults": found} if found else {}


def _rng() -> np.random.Generator:
    """A generator with a fixed seed: the same episodes give the same interval in any report."""
    return np.random.default_rng(0)
