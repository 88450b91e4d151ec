"""Open loop: a raster of spikes into a network, and everything that it did out of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.artifact import Artifact, load
from runtime.chip import chip as datasheet
from runtime.compile import compile as compiled
from runtime.energy import energy, energy_table
from runtime.errors import ObservationError, RuleError
from runtime.float_machine import FloatMachine
from runtime.ledger import Ledger
from runtime.machine import Machine
from runtime.quantisation import PLAIN, Quantisation
from spikedeploy.files import replacing
from spikedeploy.policies import FLOAT
from spikedeploy.spiking_costs import priced_by

Raster = NDArray[np.uint8]


@dataclass(frozen=True)
class Emulation:
    """What a network did with a raster of T timesteps.

    artifact  the network and its convention
    chip      it ran on, or "float"
    spikes    node -> (T, N) uint8
    output    (T, act) of the readout, or the spikes of the last node
    ledger    of this one inference; None where `uncounted` says why
    uncounted why the events could not be counted
    """

    artifact: Artifact
    chip: str
    spikes: Mapping[str, Raster]
    output: NDArray[np.float64]
    ledger: Ledger | None
    uncounted: str = ""

    def save(self, path: Path) -> None:
        """Write a .npz with the spikes under each node's name, and `output`."""
        with replacing(path) as part, part.open("wb") as file:
            np.savez_compressed(file, **self.spikes, output=self.output)  # type: ignore[arg-type]

    def as_json(self) -> dict[str, Any]:
        """Counts over the whole raster, by layer too, energies, and the convention."""
        return {
            "chip": self.chip,
            "timesteps": len(self.output),
            "convention": self.artifact.convention.to_record(),
            "spikes": sum(int(rows.sum()) for rows in self.spikes.values()),
            "sops": self._total("sop"),
            "bias_sops": self._total("bias_sop"),
            "neuron_updates": self._total("neuron_update"),
            "saturations": self._total("saturation"),
            "energy_j": self._energies(),
            "layers": {name: {"spikes": int(rows.sum())} for name, rows in self.spikes.items()},
            "uncounted": self.uncounted or None,
        }

    def _total(self, event: str) -> int | None:
        return self.ledger.total(event) if self.ledger else None

    def _energies(self) -> dict[str, float]:
        if self.ledger is None:
            return {}
        chip = None if self.chip == FLOAT else datasheet(self.chip)
        return {name: energy(self.ledger, energy_table(name)) for name in priced_by(chip)}


def emulate(
    path: Path,
    chip: str,
    raster: Raster,
    quantisation: Quantisation = PLAIN,
    **convention: Any,  # noqa: ANN401
) -> Emulation:
    """Play the raster (T, N) into the network once, from zero states.

    quantisation  on a chip
    convention  options of runtime.artifact.load: go before what the file says, None leaves it
    """
    artifact = load(path, **convention)
    if chip == FLOAT:
        return _in_float(artifact, raster)
    return _on_chip(artifact, chip, raster, quantisation)


def read_raster(path: Path) -> Raster:
    """The raster (T, N) of 0 and 1 in a .npy file."""
    try:
        found = np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise ObservationError(f"{path} is not a .npy file with a plain array: {error}") from error
    if not isinstance(found, np.ndarray) or found.ndim != 2 or not found.size:
        raise ObservationError(f"{path} must hold one array (T, N), found {_shape(found)}")
    if not np.isin(found, (0, 1)).all():
        raise ObservationError(f"{path} must hold spikes, 0 or 1, and nothing else")
    return found.astype(np.uint8)


def _in_float(artifact: Artifact, raster: Raster) -> Emulation:
    machine = FloatMachine(artifact)
    output = machine.infer(raster[None])[0]
    spikes = {name: _flat(rows[0]) for name, rows in machine.spikes.items()}
    try:
        return Emulation(artifact, FLOAT, spikes, _flat(output), machine.ledger)
    except RuleError as error:  # a graph that no chip could hold
        return Emulation(artifact, FLOAT, spikes, _flat(output), None, str(error))


def _on_chip(
    artifact: Artifact, chip: str, raster: Raster, quantisation: Quantisation
) -> Emulation:
    machine = Machine(compiled(artifact, datasheet(chip), quantisation), trace=True)
    output = machine.infer(raster[None])[0]
    spikes = {name: seen.spikes[0] for name, seen in machine.recordings.items()}
    return Emulation(artifact, chip, spikes, output, machine.ledger)


def _flat(rows: NDArray[Any]) -> NDArray[Any]:
    """(T, N) of rows (T, *N)."""
    return rows.reshape(len(rows), -1)


def _shape(found: object) -> str:
    return f"shape {found.shape}" if isinstance(found, np.ndarray) else type(found).__name__
