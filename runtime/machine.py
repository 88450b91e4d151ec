"""The machine: a chip with a program on it, running."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from runtime.errors import ConfigError, ObservationError, RuleError
from runtime.ledger import EVENTS, Ledger
from runtime.pipeline import Pipeline, Recording, Schedule, joined
from runtime.program import Program
from runtime.recorder import Recorder, Rows

Floats = NDArray[np.float64]

# "window": all timesteps of a layer at once; "row": one timestep of all layers; "step": the same,
# with the chip's own delays
Way = Literal["window", "row", "step"]

IDLE = EVENTS.index("neuron_idle")


class Machine:
    """A running chip: spikes in; out comes what the readout makes of them, or spikes.

    Use `infer` for whole inferences, or `step` for one chip timestep after another.

    program: what it runs.
    batch: B, copies of the network that run side by side.
    ledger: rows to keep, as in Recorder, or the recorder of another machine, to go on with; one
        row per inference and copy, or per step and copy.
    trace: whether `infer` leaves a Recording of each layer in `recordings`.
    """

    def __init__(
        self,
        program: Program,
        batch: int = 1,
        ledger: Rows | Recorder = "each",
        trace: bool = False,
    ) -> None:
        if batch < 1:
            raise ConfigError(f"batch is {batch}; the least is 1.")
        _check_fast(program)
        self.program, self.batch = program, batch
        self.recordings: dict[str, Recording] = {}
        self._trace = trace
        self._kept = program.convention.state == "kept"
        self._recorder = ledger if isinstance(ledger, Recorder) else Recorder(program, ledger)
        self._prepared_for: tuple[Way, int] = ("row", 1)
        self._pipeline = self._build("row", 1)
        self._running = False
        self._step = 0

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""
        self._pipeline.reset()
        self._running = False
        self._step = 0

    def infer(self, spikes: NDArray[Any]) -> Floats:
        """Output (B, T, act) of the spikes (B, T, M); states as the convention says."""
        rows = self._checked(spikes, 3).swapaxes(0, 1)
        if not self._kept:
            self.reset()
        heard = self._window(rows) if self.program.feed_forward else self._rows(rows)
        return self._output(heard)

    def step(self, spikes: NDArray[Any]) -> Floats:
        """Output (B, act) after one chip timestep with the input spikes (B, M).

        Layers run on from step to step until `reset`; spikes travel as late as on the chip.
        """
        rows = self._checked(spikes, 2)[None]
        pipeline = self._prepared("step", 1)
        heard = pipeline.run(rows, self._step)
        if self._recorder.keeps:
            self._recorder.observe(pipeline.tally, pipeline.observe())
        self._step += 1
        return np.asarray(self._output(heard)[:, 0])

    @property
    def ledger(self) -> Ledger:
        """What happened since the machine was made."""
        return self._recorder.ledger()

    @property
    def current(self) -> dict[str, NDArray[Any]]:
        """(B, N) of each layer now [state units]."""
        return {name: last.current[:, -1] for name, last in self._last().items()}

    @property
    def membrane(self) -> dict[str, NDArray[Any]]:
        """(B, N) of each layer now [state units]."""
        return {name: last.membrane[:, -1] for name, last in self._last().items()}

    def _last(self) -> dict[str, Recording]:
        running = self._pipeline if self._running else self._build("row", 1)
        return running.recordings()

    def _checked(self, spikes: NDArray[Any], axes: int) -> NDArray[Any]:
        width = self.program.width
        if spikes.ndim != axes or len(spikes) != self.batch or spikes.shape[-1] != width:
            wanted = ", ".join([str(self.batch), *["T"] * (axes - 2), str(width)])
            raise ObservationError(
                f"the spikes have shape {spikes.shape}; this machine takes ({wanted}). Give the "
                "raster of this network, or make a machine with another batch."
            )
        if not spikes.size or spikes.dtype.kind not in "bu" or _largest(spikes) > 1:
            raise ObservationError(
                f"the raster holds {spikes.dtype} values; it must hold at least one timestep, and "
                "0 or 1 in bool or unsigned integers. Convert it with spikes.astype(bool)."
            )
        return spikes

    def _prepared(self, way: Way, timesteps: int) -> Pipeline:
        """The memory for a way of running, which has to stay the same while states are kept."""
        if (way, timesteps) != self._prepared_for:
            if self._running and self._pipeline.schedule.kept:
                raise ConfigError(
                    "the machine holds the state of a run with another number of timesteps, or of "
                    "step and not infer. Call reset() first."
                )
            self._pipeline = self._build(way, timesteps)
            self._prepared_for = (way, timesteps)
        self._running = True
        return self._pipeline

    def _build(self, way: Way, timesteps: int) -> Pipeline:
        program = self.program
        if way == "window":
            steps = program.steps(timesteps)
            schedule = Schedule(timesteps, program.lags, self._kept, steps)
        else:
            late = program.delays if way == "step" else program.lags
            schedule = Schedule(1, late, kept=True, steps=1)
        return Pipeline(program, schedule, self.batch)

    def _window(self, rows: NDArray[Any]) -> NDArray[Any]:
        """What the readout hears (T, B, N) when each layer runs all timesteps at once."""
        pipeline = self._prepared("window", len(rows))
        heard = pipeline.run(rows)
        if self._recorder.keeps:
            self._recorder.observe(pipeline.tally, pipeline.observe())
        if self._trace:
            self.recordings = pipeline.recordings()
        return heard

    def _rows(self, rows: NDArray[Any]) -> NDArray[Any]:
        """The same when all layers run one timestep after another, which closes loops."""
        pipeline, steps = self._prepared("row", 1), self.program.steps(len(rows))
        heard, seen, traced = [], [], []
        for row in rows:
            # the pipeline uses its memory again for the next row
            heard.append(pipeline.run(row[None])[0].copy())
            seen.append(pipeline.observe())
            if self._trace:
                traced.append(pipeline.recordings())
        if self._recorder.keeps:
            counts = pipeline.tally.count(seen).reshape(len(rows), self.batch, -1, len(EVENTS))
            total = counts.sum(axis=0)
            total[:, :, IDLE] += [(steps - len(rows)) * a.size for a in self.program.layers]
            self._recorder.add(total, len(rows), steps)
        self.recordings = joined(traced)
        return np.stack(heard)

    def _output(self, heard: NDArray[Any]) -> Floats:
        """Output (B, T, act) of the rows (T, B, N) that leave the chip."""
        spikes = heard.astype(np.float64)
        output = self.program.readout(spikes) if self.program.readout else spikes
        return np.asarray(output.swapaxes(0, 1))


def _check_fast(program: Program) -> None:
    """Refuse what only the interpreter computes."""
    if program.chip.events is not None:
        raise RuleError(
            f"{program.chip.name} adds up event by event, which is not fast. Run the program with "
            "runtime.interpreter.trace."
        )
    for layer in program.layers:
        if any(synapses.shift for synapses in layer.synapses):
            raise RuleError(
                f"layer {layer.name!r}: its weights have a negative exponent, by which "
                f"{program.chip.name} rounds sums. Run the program with runtime.interpreter.trace."
            )


def _largest(spikes: NDArray[Any]) -> int:
    # what spikes.max() does, without its detour through Python
    return int(np.maximum.reduce(spikes, axis=None))
