"""The machine: a chip with a program on it, running."""

from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.compiler.program import Program, leaving
from spikedeploy.runtime.emulator.backend import Backend, compiles, interprets
from spikedeploy.runtime.emulator.interpreted import InterpretedPipeline
from spikedeploy.runtime.emulator.ledger import EVENTS, Ledger
from spikedeploy.runtime.emulator.ledger_builder import LedgerBuilder, Rows
from spikedeploy.runtime.emulator.raster import not_spikes
from spikedeploy.runtime.errors import ConfigError, ObservationError
from spikedeploy.runtime.families.cuba_numpy.pipeline import Pipeline, Recording, Schedule, joined

if TYPE_CHECKING:
    from spikedeploy.runtime.families.cuba_numba.pipeline import NativePipeline

AnyPipeline: TypeAlias = "Pipeline | InterpretedPipeline | NativePipeline"
Floats = NDArray[np.float64]

# "window": all timesteps of a layer at once; "row": one timestep of all layers; "step": the same,
# with the chip's own delays
RunMode = Literal["window", "row", "step"]

IDLE = EVENTS.index("neuron_idle")


class Machine:
    """A running chip: spikes in; out comes what the readout makes of them, or spikes.

    Use `infer` for whole inferences, or `step` for one chip timestep after another.

    program: what it runs.
    batch: B, copies of the network that run side by side.
    ledger: rows to keep, as in Recorder, or the recorder of another machine, to go on with; one
        row per inference and copy, or per step and copy.
    trace: whether `infer` leaves a Recording of each layer in `recordings`.
    backend: "numpy", or "numba", which computes the same several times faster, and compiles for
        half a minute when it runs for the first time after it was installed; "auto" takes it where
        it is installed and can run the program. "interpreter" computes the same slowly; "numpy" and
        "auto" do so too where nothing faster knows the chip's arithmetic.
    """

    def __init__(
        self,
        program: Program,
        batch: int = 1,
        ledger: Rows | LedgerBuilder = "each",
        trace: bool = False,
        backend: Backend = "numpy",
    ) -> None:
        if batch < 1:
            raise ConfigError(f"batch is {batch}; the least is 1.")
        self.program, self.batch = program, batch
        self.recordings: dict[str, Recording] = {}
        # where several layers leave the chip, the host needs the spikes of all
        self._trace = trace or bool(program.outlets)
        self._native = compiles(program, backend)
        self._interpreted = interprets(program, backend)
        # of these, a pipeline closes loops by itself
        self._whole = self._native or self._interpreted
        self._most = program.chip.input_spikes_max
        self._kept = program.convention.state == "kept"
        self._recorder = (
            ledger if isinstance(ledger, LedgerBuilder) else LedgerBuilder(program, ledger)
        )
        self._prepared_for: tuple[RunMode, int] = ("row", 1)
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
        if self.program.feed_forward:
            return self._output(self._window(rows, "window"))
        return self._output(self._window(rows, "row") if self._whole else self._rows(rows))

    def step(self, spikes: NDArray[Any], out: Floats | None = None) -> Floats:
        """Output (B, act) after one chip timestep with the input spikes (B, M).

        Layers run on from step to step until `reset`; spikes travel as late as on the chip.

        out: memory (B, act) for the output, float64; with it the "numba" backend allocates nothing.
        """
        if self.program.outlets:
            raise ConfigError(
                f"{len(self.program.to_host)} layers leave the chip, and a step gives the spikes "
                "of one. Use infer, or give the network one Output that hears one layer."
            )
        rows = self._checked(spikes, 2)[None]
        pipeline = self._prepared("step", 1)
        presynaptic = pipeline.run(rows, self._step)
        if self._recorder.keeps:
            pipeline.report(self._recorder)
        self._step += 1
        return (
            np.asarray(self._output(presynaptic)[:, 0])
            if out is None
            else self._write(presynaptic[0], out)
        )

    @property
    def ledger(self) -> Ledger:
        """What happened since the machine was made."""
        return self._recorder.ledger()

    @property
    def current(self) -> dict[str, NDArray[Any]]:
        """(B, N) of each layer now [state units]; (B, K, N) where neurons have K currents."""
        return {name: current for name, (current, _) in self._now().items()}

    @property
    def membrane(self) -> dict[str, NDArray[Any]]:
        """(B, N) of each layer now [state units]."""
        return {name: membrane for name, (_, membrane) in self._now().items()}

    def _now(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        running = self._pipeline if self._running else self._build("row", 1)
        return running.now()

    def _checked(self, spikes: NDArray[Any], axes: int) -> NDArray[Any]:
        width = self.program.width
        if spikes.ndim != axes or len(spikes) != self.batch or spikes.shape[-1] != width:
            wanted = ", ".join([str(self.batch), *["T"] * (axes - 2), str(width)])
            raise ObservationError(
                f"the spikes have shape {spikes.shape}; this machine takes ({wanted}). Give the "
                "raster of this network, or make a machine with another batch."
            )
        if not spikes.size or spikes.dtype.kind not in "bu":
            raise not_spikes(spikes, self._most)
        # compiled kernels look themselves
        if not self._native and spikes.dtype.kind == "u" and _largest(spikes) > self._most:
            raise not_spikes(spikes, self._most)
        return spikes

    def _prepared(self, way: RunMode, timesteps: int) -> AnyPipeline:
        """The memory for a way of running, which has to stay the same while states are kept."""
        if (way, timesteps) != self._prepared_for:
            before, goes_on = self._pipeline, self._running and self._pipeline.schedule.kept
            if goes_on and not way == self._prepared_for[0] == "row":
                raise ConfigError(
                    "the machine holds the state of a run with another number of timesteps, or of "
                    "step and not infer. Call reset() first."
                )
            self._pipeline = self._build(way, timesteps)
            self._prepared_for = (way, timesteps)
            if goes_on:
                # only these run several rows at once
                cast("NativePipeline", self._pipeline).resume(cast("NativePipeline", before))
        self._running = True
        return self._pipeline

    def _build(self, way: RunMode, timesteps: int) -> AnyPipeline:
        program, native = self.program, self._native
        late = program.delays if way == "step" else program.lags
        steps = program.steps(timesteps) if way == "window" or (self._whole and way == "row") else 1
        kept = self._kept or way != "window"
        schedule = Schedule(timesteps, late, kept, steps)
        if self._interpreted:
            return InterpretedPipeline(program, schedule, self.batch, streaming=way == "step")
        if not native:
            return Pipeline(program, schedule, self.batch)
        # loads the compiler, which takes longer than everything else
        from spikedeploy.runtime.families.cuba_numba.pipeline import NativePipeline

        return NativePipeline(
            program,
            schedule,
            self.batch,
            rowwise=way == "row",
            trace=self._trace,
            counting=self._recorder.keeps,
        )

    def _window(self, rows: NDArray[Any], way: RunMode) -> NDArray[Any]:
        """What the readout hears (T, B, N) when the pipeline runs all timesteps at once."""
        pipeline = self._prepared(way, len(rows))
        presynaptic = pipeline.run(rows)
        if self._recorder.keeps:
            pipeline.report(self._recorder)
        if self._trace:
            self.recordings = pipeline.recordings()
        return presynaptic

    def _rows(self, rows: NDArray[Any]) -> NDArray[Any]:
        """The same when all layers run one timestep after another, which closes loops."""
        pipeline = cast("Pipeline", self._prepared("row", 1))
        steps = self.program.steps(len(rows))
        presynaptic, seen, traced = [], [], []
        for row in rows:
            # the pipeline uses its memory again for the next row
            presynaptic.append(pipeline.run(row[None])[0].copy())
            seen.append(pipeline.observe())
            if self._trace:
                traced.append(pipeline.recordings())
        if self._recorder.keeps:
            counts = pipeline.tally.count(seen).reshape(len(rows), self.batch, -1, len(EVENTS))
            total = counts.sum(axis=0)
            total[:, :, IDLE] += [(steps - len(rows)) * a.size for a in self.program.layers]
            self._recorder.add(total, len(rows), steps)
        self.recordings = joined(traced)
        return np.stack(presynaptic)

    def _output(self, presynaptic: NDArray[Any]) -> Floats:
        """Output (B, T, act) of the rows (T, B, N) that leave the chip."""
        if self.program.outlets:
            seen = {name: recording.spikes for name, recording in self.recordings.items()}
            return leaving(self.program.outlets, seen)
        spikes = presynaptic.astype(np.float64)
        output = self.program.readout(spikes) if self.program.readout else spikes
        return np.asarray(output.swapaxes(0, 1))

    def _write(self, presynaptic: NDArray[Any], out: Floats) -> Floats:
        """The same of one row (B, N), into memory that is there."""
        readout, spikes = self.program.readout, presynaptic.astype(np.float64, copy=False)
        if readout is None:
            np.copyto(out, spikes)
        else:
            np.dot(spikes, readout.weight, out)
            np.add(out, readout.bias, out)
        return out


def _largest(spikes: NDArray[Any]) -> int:
    # what spikes.max() does, without its detour through Python
    return int(np.maximum.reduce(spikes, axis=None))
