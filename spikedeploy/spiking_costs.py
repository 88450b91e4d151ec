"""The costs of a spiking network, from the ledger of what it did."""

import numpy as np

from runtime.chip import Chip
from runtime.energy import TABLES, energy_estimate, latency_estimate
from runtime.ledger import Ledger
from runtime.program import Program
from spikedeploy.costs import Costs


def spiking_costs(ledger: Ledger, program: Program, chip: Chip | None) -> Costs:
    """The mean inference of the ledger; `chip` None is the float twin."""
    sops = ledger.per_inference("sop")
    return Costs(
        sparsity=ledger.sparsity,
        spikes=ledger.per_inference("spike_out"),
        input_spikes=ledger.by_layer("spike_in")[program.layers[0].name] / ledger.inferences,
        sops=sops,
        bias_sops=ledger.per_inference("bias_sop"),
        effective_acs=sops + _readout_acs(ledger, program),
        effective_macs=0.0,  # every weight matrix hears spikes
        dense=_weights(program) * ledger.timesteps / ledger.inferences,
        saturations=ledger.total("saturation") if chip else None,
        # by all of them, so that a report can choose
        energy_j={name: energy_estimate(ledger, table) for name, table in TABLES.items()},
        latency_s={
            n: latency_estimate(ledger, table) for n, table in TABLES.items() if table.timed
        },
    )


def priced_by(chip: Chip | None) -> tuple[str, ...]:
    """The chip's own energy tables, and the one that a float network of its precision has too."""
    if chip is None or chip.arithmetic is None:
        return ("horowitz45",)
    return (*chip.energy_tables, "horowitz45-int8")


def _weights(program: Program) -> int:
    """All weights of all matrices, zeros and the readout included."""
    weights = [s.weight.size for layer in program.layers for s in layer.synapses]
    return sum(weights) + sum(weight.size for _, weight in program.readouts)


def _readout_acs(ledger: Ledger, program: Program) -> float:
    """Accumulates of the host's readout; exact where all neurons have the same fan-out."""
    spikes = ledger.by_layer("spike_out")
    fan_outs = [(np.count_nonzero(weight, axis=1).mean(), of) for of, weight in program.readouts]
    return float(sum(fan_out * spikes[of] for fan_out, of in fan_outs) / ledger.inferences)
