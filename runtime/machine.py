"""The machine: a chip with a program on it, running."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.errors import ConfigError, ObservationError
from runtime.ledger import EVENTS, Ledger, Recorder, Rows
from runtime.pipeline import Pipeline, Recording, Schedule, joined
from runtime.program import Program

Floats = NDArray[np.float64]

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
        self.program, self.batch = program, batch
        self.recordings: dict[str, Recording] = {}
        self._trace = trace
        self._kept = program.convention.state == "kept"
        self._recorder = ledger if isinstance(ledger, Recorder) else Recorder(program, ledger)
        self._pipeline: Pipeline | None = None
        self._running = False
        self._step = 0

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""
        if self._pipeline is not None:
            self._pipeline.reset()
        self._running = False
        self._step = 0

    def infer(self, spikes: NDArray[Any]) -> Floats:
        """Output (B, T, act) of the spikes (B, T, M); states as the convention says."""
        rows = self._checked(spikes, 3).swapaxes(0, 1)
        if not self._kept:
            self.reset()
        counts = self._recorder.open(self.batch)
        steps = self.program.steps(len(rows))
        if self.program.feed_forward:
            schedule = Schedule(len(rows), self.program.lags, self._kept, steps)
            heard = self._run(self._prepared(schedule), [rows], counts)
        else:
            # a loop is closed by going through it timestep by timestep
            schedule = Schedule(1, self.program.lags, True, 1)
            heard = self._run(self._prepared(schedule), np.split(rows, len(rows)), counts)
            counts[:, :, IDLE] += [(steps - len(rows)) * a.size for a in self.program.layers]
        self._recorder.close(counts, len(rows), steps)
        return self._output(heard)

    def step(self, spikes: NDArray[Any]) -> Floats:
        """Output (B, act) after one chip timestep with the input spikes (B, M).

        Layers run on from step to step until `reset`; spikes travel as late as on the chip.
        """
        rows = self._checked(spikes, 2)[None]
        pipeline = self._prepared(Schedule(1, self.program.delays, True, 1))
        counts = self._recorder.open(self.batch)
        heard = pipeline.run(rows, counts, self._step)
        self._recorder.close(counts, 1, 1)
        self._step += 1
        return self._output(heard)[:, 0]

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
        if self._pipeline is None or not self._running:
            blank = Pipeline(self.program, Schedule(1, self.program.lags, True, 1), self.batch)
            return blank.recordings()
        return self._pipeline.recordings()

    def _checked(self, spikes: NDArray[Any], axes: int) -> NDArray[Any]:
        width = self.program.width
        if spikes.ndim != axes or len(spikes) != self.batch or spikes.shape[-1] != width:
            wanted = ", ".join([str(self.batch), *["T"] * (axes - 2), str(width)])
            raise ObservationError(
                f"the spikes have shape {spikes.shape}; this machine takes ({wanted}). Give the "
                "raster of this network, or make a machine with another batch."
            )
        if not spikes.size or spikes.dtype.kind not in "bu" or spikes.max() > 1:
            raise ObservationError(
                f"the raster holds {spikes.dtype} values; it must hold at least one timestep, and "
                "0 or 1 in bool or unsigned integers. Convert it with spikes.astype(bool)."
            )
        return spikes

    def _prepared(self, schedule: Schedule) -> Pipeline:
        """The pipeline for a schedule, which has to stay the same while states are kept."""
        if self._pipeline is None or self._pipeline.schedule != schedule:
            if self._running:
                raise ConfigError(
                    "the machine holds the state of a run with another number of timesteps, or of "
                    "step and not infer. Call reset() first."
                )
            self._pipeline = Pipeline(self.program, schedule, self.batch)
        self._running = True
        return self._pipeline

    def _run(
        self, pipeline: Pipeline, parts: list[NDArray[Any]], counts: NDArray[np.int64]
    ) -> NDArray[Any]:
        """What the readout hears (T, B, N) of an input that comes in parts."""
        heard, seen = [], []
        for part in parts:
            heard.append(pipeline.run(part, counts).copy())
            if self._trace:
                seen.append(pipeline.recordings())
        self.recordings = joined(seen)
        return np.concatenate(heard)

    def _output(self, heard: NDArray[Any]) -> Floats:
        """Output (B, T, act) of the rows (T, B, N) that leave the chip."""
        spikes = heard.swapaxes(0, 1).astype(np.float64)
        return self.program.readout(spikes) if self.program.readout else spikes
