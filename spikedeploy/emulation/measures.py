"""Measurements of an inference: events, NeuroBench's numbers, memory traffic, latency."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from numpy.typing import NDArray

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.emulator.network import RunningNetwork
from spikedeploy.runtime.metrics.energy import (
    STATIC,
    TABLES,
    EnergyEstimate,
    latency_estimate,
    static_energy,
)
from spikedeploy.runtime.metrics.host_work import HostWork, host_work
from spikedeploy.runtime.metrics.memory import MemoryTraffic, memory_traffic
from spikedeploy.runtime.metrics.neurobench import NeuroBench, neurobench
from spikedeploy.runtime.metrics.xylo_clocks import TIME_MODELS


@dataclass(frozen=True)
class Measures:
    """Measurements of one inference.

    neurobench  NeuroBench's metrics
    events      layer -> event -> count
    memory      layer -> weights and states read and written
    latencies   energy table -> [s]; for a Xylo from its clock cycles
    static      energy table -> [J] of static power in that time, where it is known
    host        operations of the host for readouts that the chip has no way out for, or None
    """

    neurobench: NeuroBench
    events: Mapping[str, Mapping[str, int]]
    memory: Mapping[str, MemoryTraffic]
    latencies: Mapping[str, EnergyEstimate]
    static: Mapping[str, float]
    host: HostWork | None = None

    def as_json(self) -> dict[str, Any]:
        """All measurements as plain data."""
        return {
            "neurobench": self.neurobench.as_json(),
            "events": {name: dict(each) for name, each in self.events.items()},
            "memory": {name: asdict(each) for name, each in self.memory.items()},
            "latency_s": {name: each.value for name, each in self.latencies.items()},
            "latency_interval_s": {n: [each.low, each.high] for n, each in self.latencies.items()},
            "static_energy_j": dict(self.static),
            "host": asdict(self.host) if self.host else None,
        }


def measured(
    artifact: Artifact, network: RunningNetwork, raster: NDArray[Any], ledger: Ledger
) -> Measures:
    """Of the last inference of a network with a trace, which was of the raster (B, T, M)."""
    program, seen = network.program, network.recordings
    spikes = {program.input: raster, **{name: rows.spikes for name, rows in seen.items()}}
    membranes = {name: rows.membrane for name, rows in seen.items()}
    latencies = _latencies(program, spikes, ledger)
    power = next(iter(STATIC.get(program.chip.name, ())), None)  # that of a chip, named first
    return Measures(
        neurobench(artifact.graph, program, spikes, membranes),
        _events(ledger),
        memory_traffic(ledger, program),
        latencies,
        {name: static_energy(t.value, power) for name, t in latencies.items()} if power else {},
        host_work(program, spikes),
    )


def _events(ledger: Ledger) -> dict[str, dict[str, int]]:
    # only sigma-delta neurons send graded spikes, and only queues lose some
    rare = ("graded_sop", "lost_spike")
    events = [event for event in EVENTS if event not in rare or ledger.total(event)]
    found = {event: ledger.by_layer(event) for event in events}
    return {name: {event: found[event][name] for event in events} for name in ledger.layers}


def _latencies(
    program: Program, spikes: Mapping[str, NDArray[Any]], ledger: Ledger
) -> dict[str, EnergyEstimate]:
    if (model := program.chip.arithmetic.time_model) is not None:
        return {model: TIME_MODELS[model](program, spikes)}
    tables = [TABLES[name] for name in program.chip.energy_tables]
    return {table.name: latency_estimate(ledger, table) for table in tables if table.timed}
