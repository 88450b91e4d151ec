"""Costs of an inference: spikes, operations, energy; means over the inferences of an episode.

A field of `Costs` says what it is, its key in a report, and its column; a new one is a column of
every report.

Terms of the host are those that it adds to a spiking policy: encoder, readout and resets. A term is
unknown where nothing prices it: Gaussians of a population encoder, random bytes of a rate encoder,
readouts that the host integrates, and resets of states on a chip.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import Ledger, state_count
from spikedeploy.runtime.metrics.energy import (
    EnergyEstimate,
    addition_energy,
    delta_encoder,
    energy_estimate,
    event_counts,
    host_readout,
    latency_estimate,
    mac_energy,
    mac_energy_estimate,
    priced_terms,
    rate_encoder,
    reading_energy,
    reset_energy,
    unpriced_terms,
)
from spikedeploy.runtime.metrics.energy_tables import TABLES, EnergyTable
from spikedeploy.runtime.metrics.neurobench import (
    connection_sparsity,
    dense_products,
    footprint,
    is_identity,
)
from spikedeploy.runtime.metrics.traffic import packed_bytes

# of networks without spikes
FLOAT_TABLES = tuple(name for name, table in TABLES.items() if "mac" in table.joules)


class ReportField(NamedTuple):
    """How a report shows a field of its rows.

    meaning: what it is
    title: title of its column; "" for none
    form: format of a cell, in which R stands for the decimals of a return, p for percentage points
    key: key of a row; "" for the name of the field
    table: table of the report that has the column
    bounds: key of the interval that stands beside returns and points; "" for none
    """

    meaning: str
    title: str = ""
    form: str = ",.0f"
    key: str = ""
    table: str = ""
    bounds: str = ""


def reported(*words: str) -> Any:  # noqa: ANN401
    """Return a field of a dataclass, None by default, with its ReportField."""
    return field(default=None, metadata={"report": ReportField(*words)})


def report_fields(record: type) -> dict[str, ReportField]:
    """Name -> how a report shows it, for the fields of a dataclass that it shows."""
    names, found = {each.name for each in fields(record)}, {}
    for each in fields(record):
        if shown := each.metadata.get("report"):
            interval = f"{each.name.removesuffix('_mean')}_ci95"
            bounds = interval if interval in names else ""
            found[each.name] = shown._replace(key=shown.key or each.name, bounds=bounds)
    return found


def _size(meaning: str, title: str, form: str = ",.0f") -> Any:  # noqa: ANN401
    return reported(meaning, title, form, "", "size")


def _count(meaning: str, key: str, title: str = "", form: str = ",.0f") -> Any:  # noqa: ANN401
    return reported(meaning, title, form, key, "operations")


@dataclass(frozen=True)
class Costs:
    """Means per inference; None where a kind of policy has no such cost.

    sparsity: of the spiking layers; none where a chip's neurons spike several times in a timestep;
        one inference is the sample of NeuroBench's activation sparsity
    bias_sops: operations of the always-on axon that carries the biases
    saturations: in all episodes
    effective_acs, effective_macs, dense: of every weight matrix; the readout counts, though it runs
        on the host; biases do not, nor does an identity into the output, which connects alone
    clock: how layers advance (runtime.convention.Clock), and whether that is assumed
    control_steps_late: from an observation to the first and the last action that it reaches; None
        where states are reset, and it reaches its own
    energy_j, latency_s: by each energy table, with an interval; latency as if one core did
        everything
    energy_terms_j: by each table, then by term (runtime.metrics.energy): those of the chip add up
        to energy_j; a float network has `operations` alone
    energy_unknown: by each table, terms that happen and have no price
    energy_zero_skipping_j: energy of a float network that skips inputs of 0:
        effective_macs alone
    messages_placed_j: energy of messages on the cores that `check` gives to each layer
    """

    sparsity: float | None = _count("1 - spikes / (neurons × T)", "", "sparsity", ".1%")
    spikes: float | None = _count("of the spiking layers", "spikes_per_inference", "spikes")
    input_spikes: float | None = _count("of the encoder", "input_spikes_per_inference", "input")
    sops: float | None = _count("spikes × non-zero fan-out", "sops_per_inference", "SOPs")
    bias_sops: float | None = _count("of the biases' axon", "bias_sops_per_inference", "+ bias")
    effective_acs: float | None = _count("NeuroBench Effective_ACs", "", "ACs")
    effective_macs: float | None = _count("NeuroBench Effective_MACs: no zeros", "", "MACs")
    dense: float | None = _count("NeuroBench Dense: all inputs × weights", "macs_dense", "dense")
    footprint: float | None = _size("NeuroBench Footprint of the file", "bytes")
    footprint_packed: float | None = _size("weights and biases on the chip [bytes]", "packed")
    connection_sparsity: float | None = _size("ConnectionSparsity", "zero weights", ".1%")
    synapses: float | None = _count("inputs × non-zero weights of a timestep", "")
    neuron_updates: float | None = _count("with an addend", "neuron_updates_per_inference")
    neuron_idle: float | None = _count("of other neurons", "neuron_idle_per_inference")
    messages: float | None = _count("between cores", "messages_per_inference")
    messages_placed: float | None = _count("on the cores that `check` gives", "")
    saturations: int | None = _count("numbers that did not fit a register", "", "sat.")
    clock: str | None = None
    control_steps_late: tuple[int, int] | None = None
    energy_j: Mapping[str, EnergyEstimate] = field(default_factory=dict)
    latency_s: Mapping[str, EnergyEstimate] = field(default_factory=dict)
    energy_terms_j: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    energy_unknown: Mapping[str, Sequence[str]] = field(default_factory=dict)
    energy_zero_skipping_j: Mapping[str, float] = field(default_factory=dict)
    messages_placed_j: Mapping[str, float] = field(default_factory=dict)

    def counts(self) -> dict[str, float | None]:
        """Return the numbers that have a key in a report, by key."""
        return {each.key: getattr(self, name) for name, each in report_fields(type(self)).items()}

    def total_j(self, table: str) -> float | None:
        """All known terms by a table [J]; None where it has none."""
        return sum(self.energy_terms_j[table].values()) if table in self.energy_terms_j else None


NOTHING = Costs(effective_acs=0.0, effective_macs=0.0, dense=0.0)
# what is no network that we can count, such as a script: its operations are the unknown
UNCOUNTED = Costs(energy_unknown={name: ("operations",) for name in TABLES})
# fields that are equal in all episodes of a policy, or are no means
_NO_MEANS = ("saturations", "clock", "control_steps_late", "energy_unknown")
_MEANS = tuple(each.name for each in fields(Costs) if each.name not in _NO_MEANS)


def mean(costs: Sequence[Costs], weights: Sequence[int]) -> Costs:
    """Mean costs of several episodes, weighted by their inferences; saturations are summed."""
    means = {name: weighted_mean([getattr(c, name) for c in costs], weights) for name in _MEANS}
    saturations = [c.saturations for c in costs if c.saturations is not None]
    unknown = {
        table: tuple(dict.fromkeys(term for c in costs for term in c.energy_unknown[table]))
        for table in costs[0].energy_unknown
    }
    means["energy_terms_j"] = {
        table: {term: joules for term, joules in terms.items() if term not in unknown[table]}
        for table, terms in means["energy_terms_j"].items()
    }
    return replace(
        costs[0],
        **means,
        energy_unknown=unknown,
        saturations=sum(saturations) if saturations else None,
    )


def weighted_mean(values: Sequence[Any], weights: Sequence[int]) -> Any:  # noqa: ANN401
    """Weighted mean of numbers, of estimates with their bounds, or of lists or mappings of those.

    None where one is None; a value in which an entry is missing had none of it.
    """
    if any(value is None for value in values):
        return None
    if isinstance(values[0], Mapping):
        names = dict.fromkeys(name for value in values for name in value)
        columns = {name: [value.get(name, 0.0) for value in values] for name in names}
        return {name: weighted_mean(column, weights) for name, column in columns.items()}
    if isinstance(values[0], list | tuple):
        return [weighted_mean(column, weights) for column in zip(*values, strict=True)]
    if isinstance(values[0], EnergyEstimate):
        bounds = [[each.value, each.low, each.high] for each in values]
        return EnergyEstimate(*np.average(bounds, axis=0, weights=weights).tolist())
    return float(np.average(values, weights=weights))


def policy_costs(
    artifact: Artifact, ledger: Ledger, program: Program, chip: Chip | None, placed: float | None
) -> Costs:
    """Costs of a spiking policy: of its network, of the host beside it, and of its file.

    placed: messages on the cores of the chip; None where they are not known
    """
    graph, codec, found = artifact.graph, artifact.codec, spiking_costs(ledger, program, chip)
    assert codec is not None
    encoder = _encoding(codec, found.input_spikes or 0.0)
    # of the host's readout: its weights added or multiplied, and its constants
    outputs = program.host_outputs if program.readout is None else [program.readout]
    constants = sum(each.bias.size for each in outputs)
    operations = _readout_operations(ledger, program)
    readout = None if program.host else host_readout(*operations, constants)
    known, unknown = dict(found.energy_terms_j), dict(found.energy_unknown)
    for name, table in TABLES.items():
        terms = {"encoder": encoder, "readout": readout, "resets": _resetting(program, table)}
        known[name] = {**known[name], **{n: j for n, j in terms.items() if j is not None}}
        unknown[name] = (*unknown[name], *(n for n, j in terms.items() if j is None))
    prices = {n: t.joules["message"] for n, t in TABLES.items() if "message" in t.joules}
    return replace(
        found,
        energy_terms_j=known,
        energy_unknown=unknown,
        dense=float(dense_products(graph) * ledger.timesteps / ledger.inferences),
        footprint=footprint(graph),
        footprint_packed=packed_bytes(program) if chip else None,
        connection_sparsity=(zeros := connection_sparsity(graph)),
        synapses=dense_products(graph) * (1 - zeros),
        control_steps_late=program.control_steps_late(codec.timesteps),
        messages_placed=placed,
        messages_placed_j={} if placed is None else {n: placed * j for n, j in prices.items()},
    )


def float_costs(
    dense: float, effective: float | None, biases: int | None, reads: int | None, hidden: bool
) -> Costs:
    """Costs of a float network; None is unknown.

    dense: multiply-accumulates of an inference
    effective: those with non-zero inputs
    biases: units with one
    reads: observations that are read
    hidden: whether there are activations, which nothing prices
    """
    prices = {
        "bias": None if biases is None else addition_energy(biases),
        "encoder": None if reads is None else reading_energy(reads),
    }
    beside = {name: joules for name, joules in prices.items() if joules is not None}
    unknown = tuple(name for name in prices if name not in beside)
    if hidden:
        unknown += ("activations",)
    tables = {name: TABLES[name] for name in FLOAT_TABLES}
    skipping = {} if effective is None else {n: mac_energy(effective, tables[n]) for n in tables}
    terms = {n: {"operations": mac_energy(dense, table)} | beside for n, table in tables.items()}
    return Costs(
        effective_acs=0.0,
        effective_macs=effective,
        dense=dense,
        energy_j={name: mac_energy_estimate(dense, table) for name, table in tables.items()},
        energy_terms_j=terms,
        energy_unknown={n: unknown if n in tables else ("operations", *unknown) for n in TABLES},
        energy_zero_skipping_j=skipping,
    )


def spiking_costs(ledger: Ledger, program: Program, chip: Chip | None) -> Costs:
    """Costs of a spiking network from its ledger; `chip` None is the float twin."""
    counts, (additions, products) = event_counts(ledger), _readout_operations(ledger, program)
    return Costs(
        sparsity=ledger.sparsity,
        spikes=counts["spike_out"],
        input_spikes=_input_spikes(ledger, program) / ledger.inferences,
        sops=counts["sop"],
        bias_sops=counts["bias_sop"],
        effective_acs=counts["sop"] - counts["graded_sop"] + additions,
        effective_macs=counts["graded_sop"] + products,
        neuron_updates=counts["neuron_update"],
        neuron_idle=counts["neuron_idle"],
        messages=counts["message"],
        saturations=ledger.total("saturation") if chip else None,
        clock=f"{ledger.clock}, assumed" if ledger.assumed_clock else ledger.clock,
        # by every table, so that a report can choose
        energy_j={name: energy_estimate(ledger, table) for name, table in TABLES.items()},
        latency_s={
            n: latency_estimate(ledger, table) for n, table in TABLES.items() if table.timed
        },
        energy_terms_j={name: priced_terms(counts, table) for name, table in TABLES.items()},
        energy_unknown={name: unpriced_terms(counts, table) for name, table in TABLES.items()},
    )


def priced_by(chip: Chip | None) -> tuple[str, ...]:
    """The chip's own energy tables, and the one that a float network of its precision has too."""
    if chip is None or not chip.arithmetic.is_rounded:
        return ("horowitz45",)
    return (*chip.energy_tables, "horowitz45-int8")


def _input_spikes(ledger: Ledger, program: Program) -> int:
    """Spikes of the input, as the first layer received them."""
    first, sent = program.layers[0], ledger.by_layer("spike_out")
    others = sum(sent[s.source] for s in first.synapses if s.source != program.input)
    return ledger.by_layer("spike_in")[first.name] - others


def _readout_operations(ledger: Ledger, program: Program) -> tuple[float, float]:
    """Accumulates and multiply-accumulates of the host's readout in an inference.

    It multiplies membranes; all other matrices take spikes, of which the accumulates are exact
    where all neurons have the same fan-out.
    """
    # layer that the host applies weights to, and those weights (N, act)
    readouts: list[tuple[str, NDArray[np.float64]]] = [
        (of, weight) for of, weight in program.readout_weights if not is_identity(weight)
    ]
    fan_outs = [(of, np.count_nonzero(weight, axis=1)) for of, weight in readouts]
    fan_outs += [(s.source, s.fan_out) for layer in program.host for s in layer.synapses]
    spikes = {**ledger.by_layer("spike_out"), program.input: _input_spikes(ledger, program)}
    additions = sum(fan_out.mean() * spikes[of] for of, fan_out in fan_outs if of in spikes)
    graded = {layer.name for layer in (*program.layers, *program.host) if not layer.spiking}
    products = sum(np.count_nonzero(weight) for of, weight in readouts if of in graded)
    return float(additions / ledger.inferences), float(
        products * ledger.timesteps / ledger.inferences
    )


def _encoding(codec: Codec, spikes: float) -> float | None:
    """Energy [J] of the encoder in an inference in which it sends so many spikes."""
    encoder = codec.encoder
    if isinstance(encoder, DeltaEncoder):
        read = int(np.isfinite(encoder.step).sum())  # a step of infinity never sends
        return delta_encoder(read, spikes, codec.timesteps)
    if isinstance(encoder, RateEncoder) and not encoder.random:
        return rate_encoder(encoder.observed, codec.timesteps)
    return None


def _resetting(program: Program, table: EnergyTable) -> float | None:
    """Energy [J] of setting all states of the chip to 0 before an inference, if it is done."""
    if program.convention.state == "kept" or "resets" in table.included:
        return 0.0
    states = sum(layer.size * state_count(layer, program) for layer in program.layers)
    return reset_energy(states, table)
