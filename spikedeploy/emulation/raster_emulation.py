"""Open loop: rasters into a network; spikes, outputs, events, measurements and costs out of it.

`CountedRun` is what runs over rasters and over recordings of cameras have in common.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.rasters import Raster, in_batch, write_rasters
from spikedeploy.outputs import mark
from spikedeploy.policies.costs import priced_by
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.artifact.nir_data import write_nir_data
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.emulator.running_network import RunningNetwork, chip_or_float, run_network
from spikedeploy.runtime.errors import ArtifactError, ObservationError, RuleError
from spikedeploy.runtime.files import replacing, suffix
from spikedeploy.runtime.graph.ports import by_port, ports, split
from spikedeploy.runtime.metrics.energy import (
    TIME_MODELS,
    EnergyEstimate,
    energy_estimate,
    energy_table,
    latency_estimate,
    static_energy,
)
from spikedeploy.runtime.metrics.energy_tables import STATIC, TABLES
from spikedeploy.runtime.metrics.neurobench import neurobench
from spikedeploy.runtime.metrics.traffic import host_work, memory_traffic

# bytes of a neuron in a timestep: current, membrane and spike, while running and recorded
_STATE = 48
LARGEST = 1 << 32
NIR_DATA = (".h5", ".hdf5")
_UNLIMITED = "limits off: `spikedeploy check` says whether the chip has room for this network"


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


@dataclass(frozen=True)
class Measures:
    """Measurements of one inference.

    neurobench: NeuroBench's metrics
    events: layer -> event -> count
    memory: layer -> weights and states read and written
    latencies: energy table -> [s]; for a Xylo from its clock cycles
    static: energy table -> [J] of static power in that time, where it is known
    host: operations of the host for readouts that the chip has no way out for; empty of none
    """

    neurobench: Mapping[str, Any]
    events: Mapping[str, Mapping[str, int]]
    memory: Mapping[str, Mapping[str, int]]
    latencies: Mapping[str, EnergyEstimate]
    static: Mapping[str, float]
    host: Mapping[str, int] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """All measurements as plain data."""
        return {
            "neurobench": dict(self.neurobench),
            "events": {name: dict(each) for name, each in self.events.items()},
            "memory": {name: dict(each) for name, each in self.memory.items()},
            "latency_s": {name: each.value for name, each in self.latencies.items()},
            "latency_interval_s": {n: [each.low, each.high] for n, each in self.latencies.items()},
            "static_energy_j": dict(self.static),
            "host": dict(self.host) or None,
        }


def measure_inference(
    artifact: Artifact, network: RunningNetwork, raster: NDArray[Any], ledger: Ledger
) -> Measures:
    """Measure the last inference of a traced network, which was of the raster (B, T, M)."""
    program, seen, chip = network.program, network.recordings, network.program.chip
    spikes = {program.input: raster, **{name: rows.spikes for name, rows in seen.items()}}
    membranes = {name: rows.membrane for name, rows in seen.items()}
    if (model := chip.arithmetic.time_model) is not None:
        latencies = {model: TIME_MODELS[model](program, spikes)}
    else:
        tables = [TABLES[name] for name in chip.energy_tables if TABLES[name].timed]
        latencies = {table.name: latency_estimate(ledger, table) for table in tables}
    power = next(iter(STATIC.get(chip.name, ())), None)  # that of a chip, named first
    # only sigma-delta neurons send graded spikes, and only queues lose some
    rare = ("graded_sop", "lost_spike")
    counts = {e: ledger.by_layer(e) for e in EVENTS if e not in rare or ledger.total(e)}
    return Measures(
        neurobench(artifact.graph, program, spikes, membranes),
        {name: {event: each[name] for event, each in counts.items()} for name in ledger.layers},
        memory_traffic(ledger, program),
        latencies,
        {name: static_energy(t.value, power) for name, t in latencies.items()} if power else {},
        host_work(program, spikes),
    )


@dataclass(frozen=True, kw_only=True, repr=False)
class Emulation(CountedRun):
    """One inference over a raster of T timesteps.

    spikes: node -> (T, *N) spikes, or how many where a neuron may send several in a timestep
    outputs: Output node -> (T, *act); a single one is called "output"
    measures: NeuroBench's numbers, memory and time; None where events could not be counted
    batch: inferences, B, which all arrays have as their first axis then; None for a single one
    """

    spikes: Mapping[str, NDArray[Any]]
    outputs: Mapping[str, NDArray[np.float64]]
    measures: Measures | None = None
    batch: int | None = None

    def save(self, path: Path) -> None:
        """Write a .npz, or NIRData in .h5: spikes and outputs, each by the name of its node."""
        everything = {**self.spikes, **self.outputs}
        if suffix(path) in NIR_DATA:
            with replacing(path) as part:
                write_nir_data(part, everything, self.artifact.convention.dt, mark("emulate"))
        else:
            write_rasters(path, everything, mark("emulate"))

    @property
    def timesteps(self) -> int:
        """T."""
        rows = next(iter(self.outputs.values()))
        return len(rows) if self.batch is None else len(rows[0])

    def __repr__(self) -> str:
        """A few lines, and no arrays: spikes by layer, outputs, operations, energies."""
        size = self.timesteps * (self.batch or 1)
        sent = {name: np.count_nonzero(rows) for name, rows in self.spikes.items()}
        layers = [f"{n} {s:,} of {self.spikes[n].size // size:,} neurons" for n, s in sent.items()]
        many = "one inference" if self.batch is None else f"{self.batch:,} inferences"
        lines = [f"<{many} of {self.timesteps:,} timesteps on {self.chip}"]
        lines += [f"spikes: {', '.join(layers)}"] * bool(layers)
        lines += [
            f"{name} {rows.shape}, sums {describe(rows)}" for name, rows in self.outputs.items()
        ]
        if self.ledger:
            lines.append(f"synaptic operations: {self.ledger.total('sop'):,}")
        joules = [f"{each.value:.3g} J by {name}" for name, each in self.energies.items()]
        lines += [f"energy an inference: {', '.join(joules)}"] * bool(joules)
        lines += [f"not counted: {self.uncounted}"] * bool(self.uncounted)
        return "\n  ".join(lines) + ">"

    def as_json(self) -> dict[str, Any]:
        """Counts over the whole raster, by layer too, energies, and the convention.

        `layers` are those that spike, with the rate per neuron and timestep; `readouts` never do.
        """
        ledger, graded = self.ledger, self.artifact.sigma_delta
        # graded spikes of any size are one each
        sent = {n: rows != 0 if n in graded else rows for n, rows in self.spikes.items()}
        sops = ledger.by_layer("sop") if ledger else {}
        messages = ledger.by_layer("message") if ledger else {}
        neurons = dict(zip(ledger.layers, ledger.neurons, strict=True)) if ledger else {}
        layers = {
            name: {
                "neurons": rows.size // (self.timesteps * (self.batch or 1)),
                "spikes": int(rows.sum()),
                "rate": float(rows.mean()),
                "sops": sops.get(name),
            }
            for name, rows in sent.items()
        }
        readouts = {
            name: {"neurons": neurons[name], "sops": sops[name], "messages": messages[name]}
            for name in (ledger.readouts if ledger else ())
        }
        return {
            **self.counts(),
            "timesteps": self.timesteps,
            "spikes": sum(each["spikes"] for each in layers.values()),
            **(self.measures.as_json() if self.measures else {"neurobench": None}),
            "layers": layers,
            "readouts": readouts,
            "outputs": {name: list(rows.shape[1:]) for name, rows in self.outputs.items()},
        }


def emulate_artifact(
    artifact: Artifact,
    chip: str,
    rasters: Raster | Mapping[str, Raster],
    backend: str | None = None,
    limits: bool = True,
    quantisation: Quantisation = PLAIN,
    batched: bool = False,
) -> Emulation:
    """A network on a raster (T, *shape), or one for each Input node, from zero states.

    A chip takes spikes only; in float any numbers will do.

    batched: rasters are (B, T, *shape), an inference each

    backend: as Machine takes it; None for its default
    limits: refuse what breaks a design rule of the chip
    quantisation: on a chip
    """
    rows = by_port(ports(artifact.graph.inputs), rasters if batched else in_batch(rasters))
    on = chip_or_float(chip)
    options: dict[str, Any] = {"backend": backend}  # whose unknown names the machine refuses
    options |= {"quantisation": quantisation, "limits": limits}
    network = run_network(artifact, on, trace=True, **options)
    if on is not None:
        inferences, timesteps = next(iter(rows.values())).shape[:2]
        _check_memory(network.program, inferences * timesteps)
    found = split(network.outputs, network.infer(rows))
    kept = slice(None) if batched else 0
    outputs = {"output" if len(found) == 1 else name: each[kept] for name, each in found.items()}
    if both := sorted(network.spikes.keys() & outputs.keys()):
        raise ArtifactError(f"node {both[0]!r} spikes, but that name is the output's. Rename it.")
    nodes = artifact.graph.nodes
    spikes = {
        name: seen.reshape(*seen.shape[:2], *nodes[name].output_type["output"])[kept]
        for name, seen in network.spikes.items()
    }
    unlimited = on is not None and not limits and on.limits is not None
    silent = bool(spikes) and not any(rows.any() for rows in spikes.values())
    sent = {n: seen for n, seen in network.spikes.items() if n not in artifact.sigma_delta}
    several = {name: int((seen > 1).sum()) for name, seen in sent.items()} if on else {}
    often = several_remark(several, artifact, chip)
    remarks = (*network.remarks, *often, *[_UNLIMITED] * unlimited, *[SILENT] * silent)
    clock = "" if on is None else network.program.describe_clock()
    batch = len(next(iter(rows.values()))) if batched else None
    emulation = Emulation(
        artifact=artifact,
        chip=chip,
        spikes=spikes,
        outputs=outputs,
        remarks=remarks,
        clock=clock,
        batch=batch,
    )
    try:
        raster, ledger = network.program.joined(rows), network.ledger
        measures = measure_inference(artifact, network, raster, ledger)
    except RuleError as error:  # a graph or a raster that no chip could take
        return replace(emulation, uncounted=str(error))
    return replace(emulation, ledger=ledger, measures=measures)


_SHOWN = 16  # numbers of an output in words


def describe(rows: NDArray[Any]) -> str:
    """An output (…, T, act) in words: sums over time of each number, and the largest.

    Of several inferences the sums of all.
    """
    flat = rows.reshape(-1, rows.shape[-1]) if rows.ndim > 1 else rows[:, None]
    sums = flat.sum(axis=0)
    shown = ", ".join(f"{each:,.6g}" for each in sums[:_SHOWN])
    more = f" … of {sums.size:,}" if sums.size > _SHOWN else ""
    largest = f"; largest {int(sums.argmax())}" if sums.size > 1 and np.ptp(sums) > 0 else ""
    return f"{shown}{more}{largest}"


def _check_memory(program: Program, timesteps: int) -> None:
    """Refuse a raster over which the recorded states would exceed LARGEST bytes."""
    found = _STATE * sum(program.sizes.values()) * program.steps(timesteps)
    if found > LARGEST:
        raise ObservationError(
            f"{timesteps} timesteps of {sum(program.sizes.values())} neurons and inputs take "
            f"{found} bytes; at most {LARGEST}. Play the raster in parts."
        )
