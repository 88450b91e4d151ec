"""Recordings of event cameras into a network: one long run in bounded memory, every event counted.

States are kept over the whole recording, even where the file resets them at each inference. A chip
runs on from timestep to timestep, as behind a camera. Its layers send what they send in one
inference over all timesteps (tests/spikedeploy/commands/test_emulate_events.py), if the spikes of a
layer that starts later are counted from its start.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain, islice, repeat
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.event_input import EventInput
from spikedeploy.emulation.raster_emulation import (
    NIR_DATA,
    SILENT,
    CountedRun,
    several_remark,
)
from spikedeploy.outputs import mark
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.artifact.nir_data import EventDataWriter
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.emulator.running_network import (
    FloatMachine,
    RunningNetwork,
    chip_or_float,
    run_network,
)
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.integrate_and_fire.event_machine import EventMachine
from spikedeploy.runtime.files import replacing, suffix
from spikedeploy.runtime.graph.ports import ports, split
from spikedeploy.runtime.metrics.energy import energy_estimate, energy_table, static_energy
from spikedeploy.runtime.metrics.energy_tables import STATIC

_FLOAT_ROWS = 64  # timesteps that the float twin computes at once


class Listener(Protocol):
    """Receiver of all spikes and outputs of a run; those of each layer in the order of time."""

    def add_spikes(
        self, name: str, at: NDArray[Any], neurons: NDArray[Any], counts: NDArray[Any]
    ) -> None:
        """Add spikes of the input or a layer: times [us], neurons, and how many, (k,) each.

        Times count from the first timestep, or from the first event where there are none.
        """

    def add_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Add the output (act,) at a time [us]."""


@dataclass(frozen=True, kw_only=True, repr=False)
class EventRun(CountedRun):
    """A network that has run over a recording, which its ledger has as one inference.

    given: what it saw.
    clipped: events that a timestep had beyond what the chip takes of one neuron.
    spikes: node -> how many.
    sizes: node -> neurons.
    outputs: Output -> sum (*act) of its values; a single one is called "output".
    """

    given: EventInput
    clipped: int
    spikes: Mapping[str, int]
    sizes: Mapping[str, int]
    outputs: Mapping[str, NDArray[np.float64]]

    @property
    def seconds(self) -> float:
        """Time that the network ran [s of the recording]."""
        return self.given.duration / 1e6

    def layer_energies(self, table: str) -> dict[str, float]:
        """Layer -> [J] of the recording by an energy table."""
        if (ledger := self.ledger) is None:
            return {}
        prices = energy_table(table)
        return {n: energy_estimate(ledger.of_layer(n), prices).value for n in ledger.layers}

    def as_json(self) -> dict[str, Any]:
        """All numbers as plain data; those of a second are of a second of the recording."""
        given, ledger, seconds = self.given, self.ledger, self.seconds
        sops = ledger.by_layer("sop") if ledger else {}
        on, found = chip_or_float(self.chip), self.counts()
        power = next(iter(STATIC.get(on.name, ()) if on else ()), None)
        per_layer = {name: self.layer_energies(name) for name in found["energy_j"]}
        return {
            **found,
            "recording": str(given.recording.path),
            "camera": list(given.recording.size) if given.recording.size else None,
            "seconds": seconds,
            "time_step_s": given.step_us and given.step_us / 1e6,
            "timesteps": given.timesteps or None,
            "events": given.events,
            "events_seen": given.seen,
            "events_of_channels": list(given.channels),
            "events_clipped": self.clipped,
            "spikes": sum(self.spikes.values()),
            "lost_spikes": ledger.total("lost_spike") if ledger else None,
            "power_w": {name: value / seconds for name, value in found["energy_j"].items()},
            "static_energy_j": {power.name: static_energy(seconds, power)} if power else {},
            "layers": {
                name: {
                    "neurons": size,
                    "spikes": self.spikes.get(name),
                    "spikes_per_s": self.spikes[name] / seconds if name in self.spikes else None,
                    "sops": sops.get(name),
                    "sops_per_s": sops[name] / seconds if name in sops else None,
                    "energy_j": {t: each[name] for t, each in per_layer.items() if name in each},
                }
                for name, size in self.sizes.items()
            },
            "outputs": {name: values.tolist() for name, values in self.outputs.items()},
        }


def emulate_events(
    artifact: Artifact,
    chip: str,
    given: EventInput,
    listeners: Sequence[Listener] = (),
    backend: BackendName | None = None,
    limits: bool = True,
    quantisation: Quantisation = PLAIN,
) -> EventRun:
    """Run a network over a recording; without timesteps the chip must go event by event.

    listeners: receive every spike, and in timesteps every output.
    backend, limits, quantisation: as in `emulate_artifact`.
    """
    artifact = artifact.with_convention(artifact.convention.with_options({"state": "kept"}))
    on = chip_or_float(chip)
    options: dict[str, Any] = {"limits": limits, "quantisation": quantisation} if on else {}
    network: RunningNetwork | EventMachine
    if given.step_us is None:
        if on is None:
            raise ConfigError("--step event is for chips; float computes timesteps. Name a chip.")
        network = EventMachine(compile_program(artifact, on, **options), backend or "auto")
        tally = _Tally(artifact, network)
        _play_events(network, given, (tally, *listeners))
    else:
        network = run_network(artifact, on, "total", backend=backend, **options)
        tally = _Tally(artifact, network)
        if isinstance(network, FloatMachine):
            _play_float(network, given, (tally, *listeners))
        else:
            _play_chip(network, given, (tally, *listeners))
    ledger, uncounted = None, ""
    try:
        ledger = replace(network.ledger, inferences=1)
    except RuleError as error:
        uncounted = str(error)
    clipped = given.seen - tally.taken
    return EventRun(
        artifact=artifact,
        chip=chip,
        given=given,
        clipped=clipped,
        spikes=tally.spikes,
        sizes=tally.sizes,
        outputs=tally.outputs,
        ledger=ledger,
        uncounted=uncounted,
        remarks=tuple(_remarks(artifact, chip, network, given, tally)),
        clock=_clock(network),
    )


def _clock(network: RunningNetwork | EventMachine) -> str:
    if isinstance(network, EventMachine):
        return "event by event"
    return "" if isinstance(network, FloatMachine) else network.program.describe_clock()


def _remarks(
    artifact: Artifact,
    chip: str,
    network: RunningNetwork | EventMachine,
    given: EventInput,
    tally: "_Tally",
) -> Iterator[str]:
    yield from (*network.remarks, *given.remarks)
    if clipped := given.seen - tally.taken:
        yield (
            f"{clipped:,} of {given.seen:,} events found their neuron with as many as the chip "
            "takes in a timestep already, and are lost: a shorter --time-step loses fewer"
        )
    if isinstance(network, Machine):
        yield from several_remark(tally.several, artifact, chip)
    if given.view.shape[0] == 1:
        yield "the network has one channel, which takes events of both polarities"
    if isinstance(network, Machine) and network.program.chip.arithmetic.by_events:
        yield (
            "the chip takes the events of a timestep in the order of their neurons; --step event "
            "gives it each when it came"
        )
    if isinstance(network, EventMachine) and _has_host(network.program):
        yield "the output, which the host computes in timesteps, is left out"
    if tally.spikes and not any(tally.spikes.values()):
        yield SILENT


class _Tally:
    """Sums of what a run sends; a Listener.

    taken: events of the Input.
    spikes: node -> how many.
    several: node -> how often a neuron sent several spikes at once; not of graded ones.
    """

    def __init__(self, artifact: Artifact, network: RunningNetwork | EventMachine) -> None:
        self._artifact, self._ports = artifact, ports(artifact.graph.outputs)
        self.taken = 0
        self.spikes: dict[str, int] = {}
        self.several: Counter[str] = Counter()
        program = None if isinstance(network, FloatMachine) else network.program
        self._layers = program.layers if program else ()
        self._sum: NDArray[np.float64] | None = None
        # the layer whose spikes are the output, where no timestep computes one
        self._output = ""
        if isinstance(network, EventMachine) and not _has_host(network.program):
            self._output = network.program.output

    def add_spikes(
        self, name: str, at: NDArray[Any], neurons: NDArray[Any], counts: NDArray[Any]
    ) -> None:
        """Add spikes up; graded ones of any size are one each."""
        if name in self._artifact.graph.inputs:
            self.taken += int(counts.sum())
            return
        is_graded = name in self._artifact.sigma_delta
        self.several[name] += 0 if is_graded else int((counts > 1).sum())
        sent = len(neurons) if is_graded else int(counts.sum())
        self.spikes[name] = self.spikes.get(name, 0) + sent
        if name == self._output:
            size = int(np.prod(node_shape(self._artifact, name)))
            self.add_output(0, np.bincount(neurons, counts, size).astype(np.float64))

    def add_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Add an output up."""
        self._sum = values.copy() if self._sum is None else self._sum + values

    @property
    def sizes(self) -> dict[str, int]:
        """Node -> neurons; on a chip of readouts too, which never spike."""
        if self._layers:
            return {layer.name: layer.size for layer in self._layers}
        return {name: int(np.prod(node_shape(self._artifact, name))) for name in self.spikes}

    @property
    def outputs(self) -> dict[str, NDArray[np.float64]]:
        """Output -> sum (*act) of its values."""
        if self._sum is None:
            return {}
        found = split(self._ports, self._sum[None, None])
        return {"output" if len(found) == 1 else n: rows[0, 0] for n, rows in found.items()}


@contextmanager
def write_spikes(path: Path, artifact: Artifact, given: EventInput) -> Iterator[Listener]:
    """Yield the listener that writes a file, complete at the end of the block.

    It is NIRData: of each layer its spikes as events, with times [s], and the output as rows.
    """
    if suffix(path) not in NIR_DATA:
        raise ConfigError(f"-o {path}: spikes of a recording are events: name a .h5 file.")
    step = given.step_us
    with replacing(path) as part, EventDataWriter(part, given.duration / 1e6) as writer:
        yield _SpikeWriter(writer, artifact)
        writer.close(mark("emulate"), step and step / 1e6)


class _SpikeWriter:
    """Writes spikes as events of NIRData; a Listener."""

    def __init__(self, writer: EventDataWriter, artifact: Artifact) -> None:
        self._writer, self._artifact = writer, artifact

    def add_spikes(
        self, name: str, at: NDArray[Any], neurons: NDArray[Any], counts: NDArray[Any]
    ) -> None:
        """Write spikes of layers, each as often as it was sent."""
        if name not in self._artifact.graph.inputs:
            size = int(np.prod(node_shape(self._artifact, name)))
            times = np.abs(counts).astype(np.int64)
            self._writer.add(name, size, np.repeat(neurons, times), np.repeat(at / 1e6, times))

    def add_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Write a row of the output."""
        self._writer.add_output("output", values)


def _has_host(program: Program) -> bool:
    """True where the host computes the output."""
    return bool(program.readout or program.host_outputs or program.reads_membranes)


def node_shape(artifact: Artifact, name: str) -> tuple[int, ...]:
    """(*N) of what a node sends in a timestep."""
    return tuple(map(int, artifact.graph.nodes[name].output_type["output"]))


def _play_chip(machine: Machine, given: EventInput, listeners: Sequence[Listener]) -> None:
    """Step a chip through the timesteps, and on until the last layer has ended."""
    program, us, count = machine.program, given.step_us or 1.0, given.timesteps
    starts = {layer.name: layer.start for layer in program.spiking}
    # as layers start later, outputs come later than the input
    names = program.output_layers | {program.output}
    late = max(layer.start for layer in program.layers if layer.name in names)
    silent = np.zeros(program.width, np.int64)
    fill = max(layer.start for layer in program.layers)
    most = program.chip.input_spikes_max
    dtype = np.uint8 if most < 256 else np.uint32
    for step, row in enumerate(chain(given.rows(), repeat(silent, fill))):
        taken = np.minimum(row, most)
        output = machine.step(taken.astype(dtype)[None])[0]
        if step < count:
            _tell(listeners, program.input, step * us, taken)
        for name, start in starts.items():
            if 0 <= step - start < count:
                _tell(listeners, name, (step - start) * us, machine.sent(name)[0])
        if 0 <= step - late < count:
            for each in listeners:
                each.add_output((step - late) * us, output)


def _play_float(network: FloatMachine, given: EventInput, listeners: Sequence[Listener]) -> None:
    """Run the float twin through the timesteps, some at once."""
    (port,), first, rows, us = network.graph.inputs, 0, given.rows(), given.step_us or 1.0
    while len(part := np.array(list(islice(rows, _FLOAT_ROWS)))):
        binary = part.max(initial=0) <= 1
        raster = part.astype(np.uint8 if binary else np.float64)
        outputs = network.infer(raster.reshape(1, len(part), *port.shape))[0]
        for k, row in enumerate(part):
            at = (first + k) * us
            _tell(listeners, port.name, at, row)
            for name, spikes in network.spikes.items():
                _tell(listeners, name, at, spikes[0, k].ravel())
            for each in listeners:
                each.add_output(at, outputs[k])
        first += len(part)


def _tell(listeners: Sequence[Listener], name: str, at: float, row: NDArray[Any]) -> None:
    neurons = np.flatnonzero(row)
    counts, times = row[neurons], np.full(len(neurons), at)
    for each in listeners:
        each.add_spikes(name, times, neurons, counts)


def _play_events(machine: EventMachine, given: EventInput, listeners: Sequence[Listener]) -> None:
    """Give a chip event after event; spikes have the time of the event that they follow from."""
    for events in given.recording.events():
        neurons = given.view.neurons(events)
        times, neurons = events["t"][neurons >= 0] - given.first, neurons[neurons >= 0]
        sent = machine.process(neurons)
        spikes = [(machine.program.input, times, neurons)]
        spikes += [(name, times[rows.cause], rows.neuron) for name, rows in sent.items()]
        for name, at, who in spikes:
            for listener in listeners:
                listener.add_spikes(name, at, who, np.ones(len(who), np.int64))
