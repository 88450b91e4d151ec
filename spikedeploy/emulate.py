"""Open loop: rasters into a network, and everything that it did out of it."""

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.comparison.costs import priced_by
from spikedeploy.comparison.measures import Measures, measured, measured_again
from spikedeploy.files import replacing
from spikedeploy.policies.policies import FLOAT
from spikedeploy.rasters import Raster, in_batch
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.compiler.compile import compile_program as compiled
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.emulator.float_machine import FloatMachine
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ArtifactError, ConfigError, ObservationError, RuleError
from spikedeploy.runtime.graph.ports import Port, named, parted, ports
from spikedeploy.runtime.metrics.energy import EnergyEstimate, energy_estimate, energy_table

# bytes that a neuron takes in a timestep: current, membrane and spike, while running and recorded
STATE = 48
LARGEST = 1 << 32
UNLIMITED = "limits off: `spikedeploy check` says whether the chip has room for this network"


@dataclass(frozen=True)
class Emulation:
    """What a network did with a raster of T timesteps.

    artifact  the network and its convention
    chip      it ran on, or "float"
    spikes    node -> (T, *N) spikes, or how many where a neuron may send several in a timestep
    outputs   Output node -> (T, *act) of what it hears; where there is one it is called "output"
    ledger    of this one inference; None where `uncounted` says why
    uncounted why the events could not be counted
    remarks   of the compiler, on what the chip does otherwise than the file says
    measures  NeuroBench's numbers, memory and time; None likewise
    tables    energy tables to price by; none are those of the chip
    """

    artifact: Artifact
    chip: str
    spikes: Mapping[str, NDArray[Any]]
    outputs: Mapping[str, NDArray[np.float64]]
    ledger: Ledger | None
    uncounted: str = ""
    remarks: tuple[str, ...] = ()
    measures: Measures | None = None
    tables: Sequence[str] = ()

    def save(self, path: Path) -> None:
        """Write a .npz with the spikes under each node's name, and the outputs under theirs."""
        with (
            replacing(path) as part,
            zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive,
        ):
            for name, rows in {**self.spikes, **self.outputs}.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asanyarray(rows), allow_pickle=False)

    @property
    def timesteps(self) -> int:
        """T."""
        return len(next(iter(self.outputs.values())))

    def layers(self) -> dict[str, dict[str, Any]]:
        """Of each spiking node neurons, spikes, rate [per neuron and timestep] and SOPs."""
        sops = self.ledger.by_layer("sop") if self.ledger else {}
        return {
            name: {
                "neurons": rows[0].size,
                "spikes": int(rows.sum()),
                "rate": float(rows.mean()),
                "sops": sops.get(name),
            }
            for name, rows in self.spikes.items()
        }

    def as_json(self) -> dict[str, Any]:
        """Counts over the whole raster, by layer too, energies, and the convention."""
        return {
            "chip": self.chip,
            "timesteps": self.timesteps,
            "convention": self.artifact.convention.to_record(),
            "spikes": sum(int(rows.sum()) for rows in self.spikes.values()),
            "sops": self._total("sop"),
            "bias_sops": self._total("bias_sop"),
            "neuron_updates": self._total("neuron_update"),
            "saturations": self._total("saturation"),
            "energy_j": {name: each.value for name, each in self.energies.items()},
            "energy_interval_j": {n: [each.low, each.high] for n, each in self.energies.items()},
            **(self.measures.as_json() if self.measures else {"neurobench": None}),
            "layers": self.layers(),
            "outputs": {name: list(rows.shape[1:]) for name, rows in self.outputs.items()},
            "uncounted": self.uncounted or None,
            "remarks": list(self.remarks),
        }

    def _total(self, event: str) -> int | None:
        return self.ledger.total(event) if self.ledger else None

    @property
    def energies(self) -> dict[str, EnergyEstimate]:
        """[J] by each table, with the interval that it lies in."""
        if self.ledger is None:
            return {}
        names = self.tables or priced_by(None if self.chip == FLOAT else datasheet(self.chip))
        return {name: energy_estimate(self.ledger, energy_table(name)) for name in names}


def emulate(
    path: Path,
    chip: str,
    rasters: Raster | Mapping[str, Raster],
    backend: str | None = None,
    limits: bool = True,
    quantisation: Quantisation = PLAIN,
    **convention: Any,  # noqa: ANN401
) -> Emulation:
    """Play the raster (T, *shape), or one for each Input node, into the network from zero states.

    A chip takes spikes; in float the numbers may be any.

    backend     of runtime.backend; None takes the one that a Machine takes by itself
    limits      refuse what breaks a design rule of the chip
    quantisation  on a chip
    convention  options of runtime.artifact.load: go before what the file says, None leaves it
    """
    return played(load(path, **convention), chip, rasters, backend, limits, quantisation)


def played(
    artifact: Artifact,
    chip: str,
    rasters: Raster | Mapping[str, Raster],
    backend: str | None = None,
    limits: bool = True,
    quantisation: Quantisation = PLAIN,
) -> Emulation:
    """The same with a network that is loaded already."""
    rows = named(ports(artifact.graph.inputs), in_batch(rasters))
    if chip != FLOAT:
        found = datasheet(chip)
        program = compiled(artifact, found, quantisation, limits=limits)
        emulation = _on_chip(artifact, program, chip, rows, backend)
        if limits or found.limits is None:
            return emulation
        return replace(emulation, remarks=(*emulation.remarks, UNLIMITED))
    if backend is not None:
        raise ConfigError(
            f"--backend {backend} is for programs of a chip; float runs in NumPy. Leave it out, or "
            "choose a chip."
        )
    return _in_float(artifact, rows)


def _in_float(artifact: Artifact, rows: Mapping[str, Raster]) -> Emulation:
    machine = FloatMachine(artifact)
    outputs = _outputs(machine.graph.outputs, machine.infer(rows))
    spikes = {name: seen[0] for name, seen in machine.spikes.items()}
    try:
        raster = machine.program.joined(rows)
        measures = measured_again(artifact, machine.program, raster, machine.ledger)
        return Emulation(artifact, FLOAT, spikes, outputs, machine.ledger, measures=measures)
    except RuleError as error:  # a graph or a raster that no chip could take
        return Emulation(artifact, FLOAT, spikes, outputs, None, str(error))


def _on_chip(
    artifact: Artifact,
    program: Program,
    chip: str,
    rows: Mapping[str, Raster],
    backend: str | None,
) -> Emulation:
    for name, seen in rows.items():
        if seen.dtype.kind not in "bu":
            raise ObservationError(
                f"the raster of node {name!r} holds {seen.dtype} values; a chip takes spikes, 0 "
                "or 1. Encode them, or play them into --chip float."
            )
    _check_room(program, rows)
    # the machine refuses names that it does not know
    given: dict[str, Any] = {} if backend is None else {"backend": backend}
    machine = Machine(program, trace=True, **given)
    raster = program.joined(rows)
    outputs = _outputs(program.outputs, machine.infer(raster))
    if both := sorted(machine.recordings.keys() & outputs.keys()):
        raise ArtifactError(f"node {both[0]!r} spikes, but that name is the output's. Rename it.")
    spikes = {
        name: seen.spikes[0].reshape(-1, *artifact.graph.nodes[name].v_threshold.shape)
        for name, seen in machine.recordings.items()
    }
    measures = measured(artifact, machine, raster, machine.ledger)
    return Emulation(artifact, chip, spikes, outputs, machine.ledger, "", program.remarks, measures)


def _check_room(program: Program, rows: Mapping[str, Raster]) -> None:
    """Refuse a raster over which currents, membranes and spikes would fill the memory."""
    timesteps = next(iter(rows.values())).shape[1]
    found = STATE * sum(program.sizes.values()) * program.steps(timesteps)
    if found > LARGEST:
        raise ObservationError(
            f"{timesteps} timesteps of {sum(program.sizes.values())} neurons and inputs take "
            f"{found} bytes; at most {LARGEST}. Play the raster in parts."
        )


def _outputs(all_: tuple[Port, ...], rows: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """What each Output node put out (T, *act), of (1, T, act) side by side."""
    found = parted(all_, rows)
    return {"output" if len(found) == 1 else name: each[0] for name, each in found.items()}
