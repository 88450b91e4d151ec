"""What runs of a network in open loop have in common: counts, energies, remarks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from spikedeploy.policies.costs import priced_by
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.emulator.running_network import chip_or_float
from spikedeploy.runtime.metrics.energy import EnergyEstimate, energy_estimate, energy_table

# networks of other tools are often silent because they mean other units
SILENT = (
    "no neuron spikes: unless the input is too weak, time constants or thresholds are read "
    "otherwise than meant; --from names the tool that wrote the file"
)
# key of a record -> event
_TOTALS = {
    "sops": "sop",
    "bias_sops": "bias_sop",
    "neuron_updates": "neuron_update",
    "saturations": "saturation",
}


@dataclass(frozen=True, kw_only=True, repr=False)
class CountedRun:
    """A network that has run.

    artifact: the network and its convention
    chip: it ran on, or "float"
    ledger: counts; None where `uncounted` says why
    uncounted: why the events could not be counted
    remarks: remarks of the compiler, on where the chip departs from the file; and SILENT
    tables: energy tables to price by; empty for those of the chip
    clock: how the layers advanced, in words; empty in float
    """

    artifact: Artifact
    chip: str
    ledger: Ledger | None = None
    uncounted: str = ""
    remarks: tuple[str, ...] = ()
    tables: Sequence[str] = ()
    clock: str = ""

    @property
    def energies(self) -> dict[str, EnergyEstimate]:
        """Energy table -> [J] of an inference, with its interval."""
        if not self.ledger:
            return {}
        names = self.tables or priced_by(chip_or_float(self.chip))
        return {name: energy_estimate(self.ledger, energy_table(name)) for name in names}

    def counts(self) -> dict[str, Any]:
        """Counts, energies and remarks as plain data."""
        energies, ledger = self.energies, self.ledger
        return {
            "chip": self.chip,
            "convention": self.artifact.convention.to_record(),
            "clock": self.clock or None,
            **{key: ledger.total(event) if ledger else None for key, event in _TOTALS.items()},
            "energy_j": {name: each.value for name, each in energies.items()},
            "energy_interval_j": {name: [each.low, each.high] for name, each in energies.items()},
            "uncounted": self.uncounted or None,
            "remarks": list(self.remarks),
        }


def several_remark(several: Mapping[str, int], artifact: Artifact, chip: str) -> list[str]:
    """A remark on neurons that sent several spikes in a timestep, where the file's send one.

    several: node -> how often
    """
    found = [f"{count:,} times in {name!r}" for name, count in several.items() if count]
    if not found or artifact.convention.spikes == "many":
        return []
    return [
        f"neurons of {chip} sent several spikes in one timestep, {', '.join(found)}; those of the "
        "file send one. Larger thresholds beside the weights make it rarer, and sd.on_chip trains "
        "with it (docs/own-network.md)"
    ]
