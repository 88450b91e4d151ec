"""The comparison: what every row's episodes say, beside those of its reference."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spikedeploy import costs, zoo
from spikedeploy.agreement import median_divergence, pooled_rmse
from spikedeploy.episodes import Episode
from spikedeploy.lineup import Entry
from spikedeploy.statistics import bootstrap, iqm, paired_difference


@dataclass(frozen=True)
class Row:
    """One policy on one chip.

    entry     who played
    episodes  in the order of the seeds (n,)
    """

    entry: Entry
    episodes: Sequence[Episode]

    @property
    def returns(self) -> list[float]:
        """Return of each episode (n,)."""
        return [episode.total for episode in self.episodes]

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(np.mean(self.returns))


@dataclass(frozen=True)
class Comparison:
    """Rows that played the same seeds.

    env    id of the environment
    seeds  (n,)
    rows   in the order of the line-up
    """

    env: str
    seeds: Sequence[int]
    rows: Sequence[Row]

    def row(self, entry: Entry | None) -> Row | None:
        """The row of an entry."""
        return next((row for row in self.rows if row.entry == entry), None)

    def of_kind(self, kind: str) -> Row | None:
        """The first row of a kind."""
        return next((row for row in self.rows if row.entry.candidate.kind == kind), None)

    def as_json(self) -> list[dict[str, Any]]:
        """The rows as a report has them."""
        return [
            _identity(row) | self._walk(row) | self._agreement(row) | _costs(row) | _metrics(row)
            for row in self.rows
        ]

    def _walk(self, row: Row) -> dict[str, Any]:
        """How well it walks, alone and beside the float ANN and the gait."""
        ann, gait = self.of_kind("ann"), self.of_kind("gait")
        estimate = bootstrap(row.returns, _rng())
        return {
            "episodes": len(row.episodes),
            "return_mean": estimate.mean,
            "return_iqm": iqm(row.returns),
            "return_ci95": estimate.ci95,
            "success_rate": float(np.mean([episode.success for episode in row.episodes])),
            "ratio_to_float_ann": row.mean / ann.mean if ann else None,
            "normalised_score": _score(row, gait, ann) if ann and gait else None,
            "returns": row.returns,
        }

    def _agreement(self, row: Row) -> dict[str, Any]:
        """How it differs from its reference and from the float ANN."""
        reference = self.row(row.entry.reference) if row.entry.reference else None
        if reference is None:
            return dict.fromkeys(_AGREEMENT)
        difference = paired_difference(row.returns, reference.returns, _rng())
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
            "ratio_to_reference": row.mean / reference.mean,
            "action_rmse": pooled_rmse(with_reference),
            "rmse_to_ann": pooled_rmse(with_ann) if with_ann else None,
            "first_divergence": median_divergence(with_reference),
        }


_AGREEMENT = (
    "reference",
    "difference_mean",
    "difference_ci95",
    "ratio_to_reference",
    "action_rmse",
    "rmse_to_ann",
    "first_divergence",
)


def _identity(row: Row) -> dict[str, Any]:
    candidate = row.entry.candidate
    return {
        "policy": candidate.name,
        "kind": candidate.kind,
        "chip": row.entry.chip,
        "file": zoo.called(candidate.path),
    }


def _score(row: Row, gait: Row, ann: Row) -> float | None:
    """0 for the gait alone, 1 for the float ANN; None where the ANN is no better than the gait."""
    # score = (return - gait) / (ANN - gait)
    span = ann.mean - gait.mean
    return (row.mean - gait.mean) / span if span > 0 else None


def _costs(row: Row) -> dict[str, Any]:
    found = costs.mean([e.costs for e in row.episodes], [e.steps for e in row.episodes])
    return {
        "sparsity": found.sparsity,
        "spikes_per_inference": found.spikes,
        "input_spikes_per_inference": found.input_spikes,
        "sops_per_inference": found.sops,
        "bias_sops_per_inference": found.bias_sops,
        "effective_acs": found.effective_acs,
        "effective_macs": found.effective_macs,
        "macs_dense": found.dense,
        "energy_per_inference_j": dict(found.energy_j),
        "latency_per_inference_s": dict(found.latency_s),
        "saturations": found.saturations,
    }


def _metrics(row: Row) -> dict[str, float]:
    """Means over the episodes of every metric that they have."""
    metrics: Mapping[str, float] = row.episodes[0].metrics
    return {name: float(np.mean([e.metrics[name] for e in row.episodes])) for name in metrics}


def _rng() -> np.random.Generator:
    """A fresh generator, so that the same episodes give the same interval in any report."""
    return np.random.default_rng(0)
