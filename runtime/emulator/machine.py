"""A chip with a program on it, running."""

from collections.abc import Sequence
from copy import deepcopy
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.damage import Damage
from spikedeploy.runtime.compiler.program import Program, leaving
from spikedeploy.runtime.emulator.backend import (
    Backend,
    BackendName,
    Recording,
    RunMode,
    SavedState,
    backend_class,
    not_spikes,
    schedule,
)
from spikedeploy.runtime.emulator.host import Host
from spikedeploy.runtime.emulator.interpreter import Interpreter
from spikedeploy.runtime.emulator.ledger import Ledger, LedgerBuilder, Rows
from spikedeploy.runtime.emulator.upset_backend import UpsetBackend
from spikedeploy.runtime.errors import ConfigError, ObservationError
from spikedeploy.runtime.graph.ports import check_unmasked

Floats = NDArray[np.float64]
T = TypeVar("T")


class SerialCalls:
    """Makes calls from several threads wait for one another; a copy has a lock of its own.

    lock: to be held during a call.
    """

    __slots__ = ("lock",)

    def __init__(self) -> None:
        self.lock = Lock()

    def __reduce__(self) -> "tuple[type[SerialCalls], tuple[()]]":
        return SerialCalls, ()


def snapshot(state: T, program: Program | None) -> T:
    """A copy of what changes; the program, which does not, is shared."""
    return deepcopy(state, {id(program): program})


class Machine:
    """A running chip: spikes in; out comes what the readout makes of them, or spikes.

    Use `infer` for whole inferences, or `step` for one chip timestep after another. Copies made by
    copy.deepcopy and pickle go on exactly as the original does. Calls from several threads wait for
    one another.

    program: what it runs.
    batch: B, copies of the network that run side by side.
    ledger: rows to keep, as in LedgerBuilder, or the LedgerBuilder of another machine, to go on
        with; one row per inference and copy, or per step and copy.
    trace: whether `infer` leaves a Recording of each layer in `recordings`.
    backend: "numpy", or "numba", which computes the same several times faster, and compiles for
        half a minute when it runs for the first time after it was installed; "auto" takes it where
        it is installed and can run the program. "interpreter" computes the same slowly; "numpy" and
        "auto" do so too where nothing faster supports the arithmetic. "The same" is bit for bit on
        chips with integers. On `ideal` it is up to the rounding of float64: backends add up the
        same products in another order, and a membrane that comes within that of its threshold may
        spike with one and not with the other.
    """

    def __init__(
        self,
        program: Program,
        batch: int = 1,
        ledger: Rows | LedgerBuilder = "each",
        trace: bool = False,
        backend: BackendName = "numpy",
    ) -> None:
        if batch < 1:
            raise ConfigError(f"batch is {batch}; the least is 1.")
        self.program, self.batch = program, batch
        self.recordings: dict[str, Recording] = {}
        # where several layers leave the chip, the host needs the spikes of all
        self._trace = trace or (bool(program.outlets) and not program.reads_membranes)
        self._host = Host(program, batch) if program.reads_membranes else None
        self._backend_class = backend_class(program, backend)
        self._ledger = (
            ledger if isinstance(ledger, LedgerBuilder) else LedgerBuilder(program, ledger)
        )
        self._prepared_for: tuple[RunMode, int] = ("row", 1)
        self._backend: Backend | None = None
        self._running = False
        self._step = 0
        self._seeds: tuple[int, ...] = ()
        self._calls = SerialCalls()

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""
        with self._calls.lock:
            self._reset()

    def infer(self, spikes: NDArray[Any]) -> Floats:
        """Output (B, T, act) of the spikes (B, T, M); states as the convention says."""
        with self._calls.lock:
            raster = self._checked(spikes, 3).swapaxes(0, 1)
            rows = self._with_fill(raster)
            if self.program.convention.state == "reset":
                self._reset()
            backend = self._prepared("window" if self.program.feed_forward else "row", len(rows))
            presynaptic = self._run(backend, rows)
            if self._trace:
                recorded = backend.recordings()
                self.recordings = {n: self._heard(n, each) for n, each in recorded.items()}
            if self._host is not None:
                return self._host.output(raster, backend)
            output = self.program.layer(self.program.output)
            return self._output(presynaptic[self.program.window(output, len(rows))])

    def step(self, spikes: NDArray[Any], out: Floats | None = None) -> Floats:
        """Output (B, act) after one chip timestep with the input spikes (B, M).

        Layers run on from step to step until `reset`; spikes travel as late as on the chip.

        out: memory (B, act) for the output, float64; with it the "numba" backend allocates nothing.
        """
        if self.program.outlets and self._host is None:
            raise ConfigError(
                f"{len(self.program.to_host)} layers leave the chip, and a step gives the spikes "
                "of one. Use infer, or give the network one Output connected to one layer."
            )
        with self._calls.lock:
            rows = self._checked(spikes, 2)[None]
            backend = self._prepared("step", 1)
            presynaptic = self._run(backend, rows, self._step)
            self._step += 1
            if self._host is not None:
                output = self._host.output(rows, backend)[:, 0]
                if out is None:
                    return output
                np.copyto(out, output)
                return out
            if out is None:
                return np.asarray(self._output(presynaptic)[:, 0])
            return self._write(presynaptic[0], out)

    def seed(self, seeds: Sequence[int]) -> None:
        """Start the chance of upsets anew, for the episode of each robot (B,)."""
        with self._calls.lock:
            self._seeds = tuple(seeds)
            if isinstance(self._backend, UpsetBackend):
                self._backend.seed(self._seeds)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What has gone wrong by chance since the machine was made."""
        return self._backend.damage if isinstance(self._backend, UpsetBackend) else ()

    @property
    def ledger(self) -> Ledger:
        """What happened since the machine was made."""
        with self._calls.lock:
            return self._ledger.ledger()

    @property
    def current(self) -> dict[str, NDArray[Any]]:
        """(B, N) of each layer now [state units]; (B, K, N) where neurons have K currents."""
        return {name: current for name, (current, _) in self._states().items()}

    @property
    def membrane(self) -> dict[str, NDArray[Any]]:
        """(B, N) of each layer now [state units]."""
        return {name: membrane for name, (_, membrane) in self._states().items()}

    def __getstate__(self) -> dict[str, Any]:
        """Everything between two calls, so that a copy made during one is whole."""
        with self._calls.lock:
            return {**self._snapshot(), "_ledger": snapshot(self._ledger, self.program)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        saved: SavedState | None = state["_backend"]
        self.__dict__.update(state, _backend=None)
        if saved is not None:
            self._backend = self._built(*self._prepared_for)
            self._backend.restore(saved)

    def without_ledger(self) -> dict[str, Any]:
        """State for a copy that another object gives the copy of a shared ledger."""
        with self._calls.lock:
            return {**self._snapshot(), "_ledger": None}

    def _snapshot(self) -> dict[str, Any]:
        """Memory of a backend is full of views of itself, so copies build it anew."""
        saved = self._backend.saved() if self._backend else None
        # the program is shared by all copies
        host = snapshot(self._host, self.program)
        return {**self.__dict__, "_backend": saved, "_host": host}

    def _reset(self) -> None:
        if self._backend is not None:
            self._backend.reset()
        if self._host is not None:
            self._host.reset(streaming=self._prepared_for[0] == "step")
        self._running = False
        self._step = 0

    def _states(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        with self._calls.lock:
            if self._backend is not None and self._running:
                return self._backend.states()
        zero = Interpreter(self.program, self.batch).states
        return {name: (state.current, state.membrane) for name, state in zero.items()}

    def _checked(self, spikes: NDArray[Any], axes: int) -> NDArray[Any]:
        width = self.program.width
        if spikes.ndim != axes or len(spikes) != self.batch or spikes.shape[-1] != width:
            wanted = ", ".join([str(self.batch), *["T"] * (axes - 2), str(width)])
            raise ObservationError(
                f"the spikes have shape {spikes.shape}; this machine takes ({wanted}). Give the "
                "raster of this network, or make a machine with another batch."
            )
        check_unmasked(spikes)
        # their values are looked at by the backends
        if not spikes.size or spikes.dtype.kind not in "bu":
            raise not_spikes(spikes, self.program.chip.input_spikes_max)
        return spikes

    def _with_fill(self, raster: NDArray[Any]) -> NDArray[Any]:
        """The raster (T, B, M) with the silent rows in which layers that run free go on."""
        fill = self.program.rows(len(raster)) - len(raster)
        return np.pad(raster, ((0, fill), (0, 0), (0, 0))) if fill else raster

    def _heard(self, name: str, recorded: Recording) -> Recording:
        """What a layer did in its window."""
        rows = recorded.spikes.shape[1]
        window = self.program.window(self.program.layer(name), rows)
        if window == slice(0, rows):
            return recorded
        parts = recorded.current, recorded.membrane, recorded.spikes
        return Recording(*(part[:, window] for part in parts))

    def _prepared(self, mode: RunMode, timesteps: int) -> Backend:
        """The backend for a way of running, which has to stay the same while states are kept."""
        backend = self._backend
        if backend is None or (mode, timesteps) != self._prepared_for:
            saved: SavedState = {}
            if backend is not None and self._running and backend.schedule.kept:
                if not mode == self._prepared_for[0] == "row":
                    raise ConfigError(
                        "the machine holds the state of a run with another number of timesteps, or "
                        "of step and not infer. Call reset() first."
                    )
                saved = backend.saved()
            self._backend = backend = self._built(mode, timesteps)
            self._prepared_for = (mode, timesteps)
            if saved:
                backend.restore(saved)
            elif self._host is not None:
                self._host.reset(streaming=mode == "step")
        return backend

    def _built(self, mode: RunMode, timesteps: int) -> Backend:
        counting = self._ledger.keeps
        # of a single timestep the membranes are those of now
        trace = self._trace or (self._host is not None and timesteps > 1)
        prepared = schedule(self.program, mode, timesteps, trace=trace, counting=counting)
        built = self._backend_class(self.program, prepared, self.batch)
        if isinstance(built, UpsetBackend) and self._seeds:
            built.seed(self._seeds)
        return built

    def _run(self, backend: Backend, rows: NDArray[Any], step: int | None = None) -> NDArray[Any]:
        """Spikes (T, B, N) as they reach the readout; the ledger counts them."""
        presynaptic = backend.run(rows, step)
        self._running = True
        if self._ledger.keeps:
            backend.report(self._ledger)
        return presynaptic

    def _output(self, presynaptic: NDArray[Any]) -> Floats:
        """Output (B, T, act) of the rows (T, B, N) that leave the chip."""
        if self.program.outlets:
            seen = {name: recording.spikes for name, recording in self.recordings.items()}
            return leaving(self.program.outlets, seen)
        readout = self.program.readout
        # a readout copies; spikes may be memory of the backend
        spikes = presynaptic.astype(np.float64, copy=readout is None)
        output = spikes if readout is None else readout(spikes)
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
