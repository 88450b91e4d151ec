"""Recordings of event cameras into a network: one long run in bounded memory, every event counted.

States are kept over the whole recording, even where the file resets them at each inference. A chip
runs on from timestep to timestep, as behind a camera. Its layers send what they send in one
inference over all timesteps (tests/spikedeploy/commands/test_emulate_events.py), if the spikes of a
layer that starts later are counted from its start.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice, repeat
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikedeploy.emulation.event_input import EventView, Survey, TimeSteps, count_rows
from spikedeploy.emulation.event_recording import Recording
from spikedeploy.emulation.raster_emulation import SILENT, TOTALS, several_remark, totals
from spikedeploy.policies.costs import priced_by
from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.emulator.running_network import (
    FloatMachine,
    RunningNetwork,
    chip_or_float,
    run_network,
)
from spikedeploy.runtime.errors import ConfigError, RuleError
from spikedeploy.runtime.families.integrate_and_fire.event_machine import EventMachine
from spikedeploy.runtime.graph.ports import ports, split
from spikedeploy.runtime.metrics.energy import (
    EnergyEstimate,
    energy_estimate,
    energy_table,
    static_energy,
)
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


@dataclass(frozen=True)
class EventRun:
    """A network that has run over a recording.

    artifact: the network.
    chip: it ran on, or "float".
    recording, view, survey: what it saw.
    steps: timesteps; None where the chip took event by event.
    clipped: events that a timestep had beyond what the chip takes of one neuron.
    spikes: node -> how many.
    sizes: node -> neurons.
    outputs: Output -> sum (*act) of its values; a single one is called "output".
    ledger: counts; None where `uncounted` says why.
    uncounted: why events could not be counted.
    remarks: remarks of the compiler, and on what was lost.
    clock: how the layers advanced, in words.
    tables: energy tables to price by; empty for those of the chip.
    """

    artifact: Artifact
    chip: str
    recording: Recording
    view: EventView
    survey: Survey
    steps: TimeSteps | None
    clipped: int
    spikes: Mapping[str, int]
    sizes: Mapping[str, int]
    outputs: Mapping[str, NDArray[np.float64]]
    ledger: Ledger | None
    uncounted: str = ""
    remarks: tuple[str, ...] = ()
    clock: str = ""
    tables: Sequence[str] = ()

    @property
    def seconds(self) -> float:
        """Time that the network ran [s of the recording]."""
        return self.survey.duration(self.steps) / 1e6

    @property
    def energies(self) -> dict[str, EnergyEstimate]:
        """Energy table -> [J] of the recording, with its interval."""
        if self.ledger is None:
            return {}
        whole = replace(self.ledger, inferences=1)
        names = self.tables or priced_by(chip_or_float(self.chip))
        return {name: energy_estimate(whole, energy_table(name)) for name in names}

    def layer_energies(self, table: str) -> dict[str, float]:
        """Layer -> [J] of the recording by an energy table."""
        if (ledger := self.ledger) is None:
            return {}
        whole, prices = replace(ledger, inferences=1), energy_table(table)
        return {n: energy_estimate(whole.of_layer(n), prices).value for n in ledger.layers}

    def as_json(self) -> dict[str, Any]:
        """All numbers as plain data; those of a second are of a second of the recording."""
        ledger, seconds = self.ledger, self.seconds
        sops = ledger.by_layer("sop") if ledger else {}
        on = chip_or_float(self.chip)
        power = next(iter(STATIC.get(on.name, ()) if on else ()), None)
        energies = {name: each.value for name, each in self.energies.items()}
        per_layer = {name: self.layer_energies(name) for name in energies}
        return {
            "chip": self.chip,
            "recording": str(self.recording.path),
            "camera": list(self.recording.size) if self.recording.size else None,
            "seconds": seconds,
            "time_step_s": self.steps and self.steps.us_each / 1e6,
            "timesteps": self.steps and self.steps.count,
            "events": self.survey.events,
            "events_seen": self.survey.seen,
            "events_of_channels": list(self.survey.channels),
            "events_clipped": self.clipped,
            "convention": self.artifact.convention.to_record(),
            "clock": self.clock or None,
            "spikes": sum(self.spikes.values()),
            **totals(ledger, {**TOTALS, "lost_spikes": "lost_spike"}),
            "energy_j": energies,
            "energy_interval_j": {n: [each.low, each.high] for n, each in self.energies.items()},
            "power_w": {name: value / seconds for name, value in energies.items()},
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
            "uncounted": self.uncounted or None,
            "remarks": list(self.remarks),
        }


def emulate_events(
    artifact: Artifact,
    chip: str,
    recording: Recording,
    view: EventView,
    found: Survey,
    steps: TimeSteps | None,
    listeners: Sequence[Listener] = (),
    backend: BackendName | None = None,
    limits: bool = True,
    quantisation: Quantisation = PLAIN,
) -> EventRun:
    """Run a network over a recording.

    found: the survey of the recording.
    steps: timesteps, in which the events of each neuron are counted; None gives the chip one event
        after another, which must go event by event.
    listeners: receive every spike, and in timesteps every output.
    backend, limits, quantisation: as in `emulate_artifact`.
    """
    artifact = artifact.with_convention(artifact.convention.with_options({"state": "kept"}))
    on = chip_or_float(chip)
    options: dict[str, Any] = {"limits": limits, "quantisation": quantisation}
    network: RunningNetwork | EventMachine
    if steps is None:
        if on is None:
            raise ConfigError("--step event is for chips; float computes timesteps. Name a chip.")
        network = EventMachine(compile_program(artifact, on, **options), backend or "auto")
        tally = _Tally(artifact, network)
        _play_events(network, recording, view, found.first, (tally, *listeners))
    else:
        network = run_network(artifact, on, "total", backend=backend, **options if on else {})
        tally = _Tally(artifact, network)
        rows, everyone = count_rows(recording, view, steps), (tally, *listeners)
        if isinstance(network, FloatMachine):
            _play_float(network, rows, steps.us_each, everyone)
        else:
            most = network.program.chip.input_spikes_max
            _play_chip(network, tally.clip(rows, most), steps, everyone)
    ledger, uncounted = None, ""
    try:
        ledger = network.ledger
    except RuleError as error:
        uncounted = str(error)
    remarks = [*network.remarks, *recording.remarks, *found.remarks]
    if tally.clipped:
        remarks.append(
            f"{tally.clipped:,} of {found.seen:,} events found their neuron with as many as the "
            f"chip takes in a timestep already, and are lost: a shorter --time-step loses fewer"
        )
    if steps and on is not None:
        remarks += several_remark(tally.several, artifact, chip)
    if view.shape[0] == 1:
        remarks.append("the network has one channel, which takes events of both polarities")
    if isinstance(network, Machine) and network.program.chip.arithmetic.by_events:
        remarks.append(
            "the chip takes the events of a timestep in the order of their neurons; --step event "
            "gives it each when it came"
        )
    if isinstance(network, EventMachine) and _has_host(network.program):
        remarks.append("the output, which the host computes in timesteps, is left out")
    if tally.spikes and not any(tally.spikes.values()):
        remarks.append(SILENT)
    clock = "" if isinstance(network, FloatMachine) else network.program.describe_clock()
    return EventRun(
        artifact,
        chip,
        recording,
        view,
        found,
        steps,
        tally.clipped,
        tally.spikes,
        tally.sizes,
        tally.outputs,
        ledger,
        uncounted,
        tuple(remarks),
        clock if steps else "event by event",
    )


class _Tally:
    """Sums of what a run sends; a Listener.

    spikes: node -> how many.
    clipped: events that were too many for a timestep.
    several: node -> how often a neuron sent several spikes at once; not of graded ones.
    """

    def __init__(self, artifact: Artifact, network: RunningNetwork | EventMachine) -> None:
        self._artifact, self._ports = artifact, ports(artifact.graph.outputs)
        self.spikes: dict[str, int] = {}
        self.several: Counter[str] = Counter()
        self.clipped = 0
        program = None if isinstance(network, FloatMachine) else network.program
        self._layers = program.layers if program else ()
        self._sum: NDArray[np.float64] | None = None
        # the layer whose spikes are the output, where no timestep computes one
        self._output = ""
        if isinstance(network, EventMachine) and not _has_host(network.program):
            self._output = network.program.output

    def clip(self, rows: Iterator[NDArray[np.int64]], most: int) -> Iterator[NDArray[np.int64]]:
        """The rows with at most so many events of a neuron."""
        for row in rows:
            taken = np.minimum(row, most)
            self.clipped += int(row.sum() - taken.sum())
            yield taken

    def add_spikes(
        self, name: str, at: NDArray[Any], neurons: NDArray[Any], counts: NDArray[Any]
    ) -> None:
        """Add spikes up; graded ones of any size are one each."""
        if name not in self._artifact.graph.inputs:
            is_graded = name in self._artifact.sigma_delta
            sent = len(neurons) if is_graded else int(counts.sum())
            self.several[name] += 0 if is_graded else int((counts > 1).sum())
            self.spikes[name] = self.spikes.get(name, 0) + sent
        if name == self._output:
            size = int(np.prod(node_shape(self._artifact, name)))
            self._add(np.bincount(neurons, counts, size).astype(np.float64))

    def add_output(self, at: float, values: NDArray[np.float64]) -> None:
        """Add an output up."""
        self._add(values)

    def _add(self, values: NDArray[np.float64]) -> None:
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


def _has_host(program: Program) -> bool:
    """True where the host computes the output."""
    return bool(program.readout or program.host_outputs or program.reads_membranes)


def node_shape(artifact: Artifact, name: str) -> tuple[int, ...]:
    """(*N) of what a node sends in a timestep."""
    return tuple(map(int, artifact.graph.nodes[name].output_type["output"]))


def _play_chip(
    machine: Machine,
    rows: Iterator[NDArray[np.int64]],
    steps: TimeSteps,
    listeners: Sequence[Listener],
) -> None:
    """Step a chip through the rows (M,), and on until the last layer has ended."""
    program, us = machine.program, steps.us_each
    starts = {layer.name: layer.start for layer in program.spiking}
    late = _output_start(program)
    silent = np.zeros(program.width, np.int64)
    dtype = np.uint8 if program.chip.input_spikes_max < 256 else np.uint32
    fill = max(layer.start for layer in program.layers)
    for step, row in enumerate(chain(rows, repeat(silent, fill))):
        output = machine.step(row.astype(dtype)[None])[0]
        if step < steps.count:
            _tell(listeners, program.input, step * us, row)
        for name, start in starts.items():
            if 0 <= step - start < steps.count:
                _tell(listeners, name, (step - start) * us, machine.sent(name)[0])
        if 0 <= step - late < steps.count:
            for each in listeners:
                each.add_output((step - late) * us, output)


def _output_start(program: Program) -> int:
    """[timesteps] by which outputs come later than the input, as layers start later."""
    names = program.output_layers | {program.output}
    return max(layer.start for layer in program.layers if layer.name in names)


def _play_float(
    network: FloatMachine,
    rows: Iterator[NDArray[np.int64]],
    us: float,
    listeners: Sequence[Listener],
) -> None:
    """Run the float twin through the rows (M,), some timesteps at once."""
    (port,), first = network.graph.inputs, 0
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


def _play_events(
    machine: EventMachine,
    recording: Recording,
    view: EventView,
    start: int,
    listeners: Sequence[Listener],
) -> None:
    """Give a chip event after event; its spikes have the time of the event that they follow from.

    start: time of the first event [us].
    """
    for events in recording.events():
        neurons = view.neurons(events)
        is_seen = neurons >= 0
        neurons, times = neurons[is_seen], events["t"][is_seen] - start
        sent = machine.process(neurons)
        each_once = [(machine.program.input, times, neurons)]
        each_once += [(name, times[rows.cause], rows.neuron) for name, rows in sent.items()]
        for name, at, who in each_once:
            for listener in listeners:
                listener.add_spikes(name, at, who, np.ones(len(who), np.int64))
