"""A chip that runs a program, and the host, which computes an output from what leaves it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.damage import Damage, sum_damage
from spikedeploy.runtime.chips.layer import Layer, Recording
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.copies import Copyable
from spikedeploy.runtime.emulator.backend import (
    Backend,
    BackendMaker,
    BackendName,
    RunMode,
    Schedule,
    backend_class,
    concatenate_recordings,
    not_spikes,
)
from spikedeploy.runtime.emulator.interpreter import Interpreter, InterpreterBackend
from spikedeploy.runtime.emulator.ledger import Ledger, LedgerBuilder, Rows
from spikedeploy.runtime.errors import ConfigError, ObservationError
from spikedeploy.runtime.graph.ports import Port, check_unmasked

Floats = NDArray[np.float64]

# inferences that are computed at once: enough to fill matrix products, few enough for the cache
CHUNK = 64


class Machine(Copyable):
    """A running chip: spikes in, output of the readout or spikes out.

    Use `infer` for whole inferences, or `step` for one chip timestep after another. Copies go on
    from the present state; a machine whose backend a function makes cannot be copied.

    program: what it runs.
    batch: B, copies of the network that run side by side; None takes any number, which has to stay
        the same until `reset` where states are kept.
    ledger: rows to keep, as in LedgerBuilder; one row per inference and copy, or per step and copy.
    trace: whether `infer` leaves a Recording of each layer in `recordings`.
    backend: "numpy", or "numba", which computes the same several times faster, and compiles for
        half a minute when it runs for the first time after it was installed; "auto" takes it where
        it is installed and can run the program. "interpreter" computes the same slowly; "numpy" and
        "auto" do so too where nothing faster supports the arithmetic. "The same" is bit for bit on
        chips with integers. On `ideal` it is up to the rounding of float64: backends add up the
        same products in another order, and a membrane that comes within that of its threshold may
        spike with one and not with the other. A function makes one of another kind.
    """

    def __init__(
        self,
        program: Program,
        batch: int | None = 1,
        ledger: Rows = "each",
        trace: bool = False,
        backend: BackendName | BackendMaker = "numpy",
    ) -> None:
        if batch is not None and batch < 1:
            raise ConfigError(f"batch is {batch}; the least is 1.")
        self.program, self.batch = program, batch
        self.recordings: Mapping[str, Recording] = {}
        self._trace = trace
        self._make_backend: BackendMaker = (
            backend_class(program, backend) if isinstance(backend, str) else backend
        )
        self._ledger = LedgerBuilder(program, ledger)
        # by batch size; since the last reset only that of `_active` has run
        self._backends: dict[int, Backend] = {}
        self._hosts: dict[int, Host] = {}
        self._active: int | None = None
        self._step = 0
        self._seeds: tuple[int, ...] = ()
        # of a copy, until it runs: what was sent in the last step
        self._sent: Mapping[str, NDArray[Any]] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Return the state with the backends' states in place of the backends, which hold views.

        Raises ConfigError where a function makes them, which may share something between them.
        """
        if not isinstance(self._make_backend, type):
            raise ConfigError(
                "a machine whose backend is made by a function, such as hardware in simulation, "
                "cannot be copied or pickled: both would act on one. Make another machine."
            )
        ran = {n: (each.schedule, each.saved()) for n, each in self._backends.items()}
        sent: dict[str, NDArray[Any]] = {}
        if self._active is not None and ran[self._active][0].mode == "step":
            sent = {layer.name: self.sent(layer.name) for layer in self.program.layers}
        return {**vars(self), "_backends": ran, "_sent": sent}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _backends={})
        for batch, (schedule, saved) in state["_backends"].items():
            self._backends[batch] = backend = self._make_backend(self.program, schedule, batch)
            backend.restore(saved)

    def reset(self) -> None:
        """Forget every current, membrane and spike; the ledger stays."""
        for batch, backend in self._backends.items():
            backend.reset()
            if host := self._hosts.get(batch):
                host.reset(streaming=backend.schedule.mode == "step")
        self._active = None
        self._step = 0

    def infer(self, spikes: NDArray[Any] | Mapping[str, NDArray[Any]]) -> Floats:
        """Output (B, T, act) of the spikes (B, T, M); states as the convention says.

        spikes: or a raster (B, T, *shape) of each Input node, by name.
        """
        raster = spikes if isinstance(spikes, np.ndarray) else self._join(spikes)
        kept = self.program.convention.state == "kept" or self.program.upsets is not None
        if self.batch is not None or len(raster) <= CHUNK or kept:
            return self._infer(raster)
        outputs, recorded = [], []
        for first in range(0, len(raster), CHUNK):
            outputs.append(self._infer(raster[first : first + CHUNK]))
            recorded.append(self.recordings)
        self.recordings = concatenate_recordings(recorded, axis=0)
        return np.concatenate(outputs)

    def step(self, spikes: NDArray[Any]) -> Floats:
        """Output (B, act) after one chip timestep with the input spikes (B, M).

        Layers run on from step to step until `reset`; spikes travel as late as on the chip.
        """
        rows = self._checked(spikes, 2)[None]
        backend = self._prepare("step", 1, len(spikes))
        presynaptic = self._run(backend, rows, self._step)[0]
        self._step += 1
        if host := self._hosts.get(len(spikes)):
            return host.output(rows, backend)[:, 0]
        return self._output(presynaptic)

    def seed(self, seeds: Sequence[int]) -> None:
        """Seed the upsets anew for the episode of each robot (B,)."""
        self._seeds = tuple(seeds)
        if isinstance(backend := self._backends.get(len(seeds)), InterpreterBackend):
            backend.seed(self._seeds)

    @property
    def damage(self) -> tuple[Damage, ...]:
        """Hits of faults, those over time since the machine was made."""
        backends = self._backends.values()
        each = [b.damage for b in backends if isinstance(b, InterpreterBackend) and b.damage]
        return (*self.program.damage, *sum_damage(each))

    @property
    def ledger(self) -> Ledger:
        """The events since the machine was made."""
        return self._ledger.ledger()

    @property
    def spikes(self) -> dict[str, NDArray[Any]]:
        """(B, T, N) of each spiking layer in the last inference, where it was traced."""
        seen, layers = self.recordings, self.program.spiking
        return {layer.name: seen[layer.name].spikes for layer in layers if layer.name in seen}

    def sent(self, layer: str) -> NDArray[Any]:
        """Spikes (B, N) of a layer in the last `step`; memory of the backend until the next."""
        if self._active is None or self._backends[self._active].schedule.mode != "step":
            raise ConfigError(f"layer {layer!r} has sent nothing: call step() first.")
        if layer in self._sent:
            return self._sent[layer]
        return np.asarray(self._backends[self._active].spikes(layer)[0])

    @property
    def outputs(self) -> tuple[Port, ...]:
        """The Output nodes side by side in the output."""
        return self.program.outputs

    @property
    def remarks(self) -> tuple[str, ...]:
        """Deviations of the chip from the file, one sentence each."""
        return self.program.remarks

    @property
    def current(self) -> dict[str, NDArray[Any]]:
        """(B, N) of each layer now [state units]; (B, K, N) where neurons have K currents."""
        return {name: current for name, (current, _) in self._states().items()}

    @property
    def membrane(self) -> dict[str, NDArray[Any]]:
        """(B, N) of each layer now [state units]."""
        return {name: membrane for name, (_, membrane) in self._states().items()}

    def _states(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        if self._active is not None:
            return self._backends[self._active].states()
        zero = Interpreter(self.program, self.batch or 1).states
        return {name: (state.current, state.membrane) for name, state in zero.items()}

    def _join(self, rasters: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """The input (B, T, M), from the raster of each Input node."""
        for name, rows in rasters.items():
            check_unmasked(rows)
            if rows.dtype.kind not in "bu":
                found = f"{rows.dtype} values"
                if rows.dtype.kind == "f" and rows.size and not np.isin(rows, (0, 1)).all():
                    found = f"numbers from {rows.min():g} to {rows.max():g}"
                raise ObservationError(
                    f"the raster of node {name!r} holds {found}; a chip takes spikes, 0 or 1. "
                    "Encode them, or play them into --chip float."
                )
        return self.program.joined(rasters)

    def _checked(self, spikes: NDArray[Any], axes: int) -> NDArray[Any]:
        width, batch = self.program.width, self.batch
        fits = spikes.ndim == axes and spikes.shape[-1] == width
        if not fits or (batch is not None and len(spikes) != batch):
            wanted = ", ".join([str(batch or "B"), *["T"] * (axes - 2), str(width)])
            raise ObservationError(
                f"the spikes have shape {spikes.shape}; this machine takes ({wanted}). Give the "
                "raster of this network, or make a machine with another batch."
            )
        check_unmasked(spikes)
        # their values are looked at by the backends
        if not spikes.size or spikes.dtype.kind not in "bu":
            raise not_spikes(spikes, self.program.chip.input_spikes_max)
        return spikes

    def _infer(self, spikes: NDArray[Any]) -> Floats:
        """Output (B, T, act) of the spikes (B, T, M), all at once."""
        program = self.program
        raster = rows = self._checked(spikes, 3).swapaxes(0, 1)
        # silent rows, in which layers that run free go on
        if fill := program.rows(len(raster)) - len(raster):
            rows = np.pad(raster, ((0, fill), (0, 0), (0, 0)))
        if program.convention.state == "reset":
            self.reset()
        mode: RunMode = "window" if program.feed_forward else "row"
        backend = self._prepare(mode, len(rows), len(spikes))
        presynaptic = self._run(backend, rows)
        if self._trace:
            self.recordings = {
                name: self._in_window(name, each) for name, each in backend.recordings().items()
            }
        if host := self._hosts.get(len(spikes)):
            return host.output(raster, backend)
        window = program.window(program.layer(program.output), len(rows))
        return np.asarray(self._output(presynaptic[window]).swapaxes(0, 1))

    def _in_window(self, name: str, recorded: Recording) -> Recording:
        rows = recorded.spikes.shape[1]
        window = self.program.window(self.program.layer(name), rows)
        return recorded if window == slice(0, rows) else recorded.part(window)

    def _prepare(self, mode: RunMode, timesteps: int, batch: int) -> Backend:
        """The backend for a way of running, which has to stay the same while states are kept."""
        found = self._backends.get(batch)
        fits = found and (found.schedule.mode, found.schedule.timesteps) == (mode, timesteps)
        if found is not None and fits and self._active in (None, batch):
            return found
        saved = None
        active = self._backends[self._active] if self._active is not None else None
        if active is not None and active.schedule.kept:
            # only what runs row by row can go on with another number of rows
            if active is not found or not mode == active.schedule.mode == "row":
                raise ConfigError(
                    "the machine holds the state of a run with another number of timesteps or "
                    "networks, or of step and not infer. Call reset() first."
                )
            saved = active.saved()
        if found is None or not fits:
            found = self._backends[batch] = self._build(mode, timesteps, batch)
        if saved is not None:
            found.restore(saved)
        elif host := self._hosts.get(batch):
            host.reset(streaming=mode == "step")
        return found

    def _build(self, mode: RunMode, timesteps: int, batch: int) -> Backend:
        program = self.program
        if program.reads_membranes or program.host_outputs:
            self._hosts.setdefault(batch, Host(program, batch))
        schedule = Schedule(
            mode=mode,
            timesteps=timesteps,
            steps=1 if mode == "step" else program.steps(timesteps),
            delays=program.delays if mode == "step" else program.lags,
            kept=mode != "window" or program.convention.state == "kept",
            # of a single timestep the membranes are those of now
            trace=self._trace or (batch in self._hosts and timesteps > 1),
            counting=self._ledger.keeps,
        )
        built = self._make_backend(program, schedule, batch)
        if isinstance(built, InterpreterBackend) and len(self._seeds) == batch:
            built.seed(self._seeds)
        return built

    def _run(self, backend: Backend, rows: NDArray[Any], step: int | None = None) -> NDArray[Any]:
        """Spikes (T, B, N) as they reach the readout; the ledger counts them."""
        presynaptic = backend.run(rows, step)
        self._active, self._sent = rows.shape[1], {}
        if self._ledger.keeps:
            backend.report(self._ledger)
        return presynaptic

    def _output(self, presynaptic: NDArray[Any]) -> Floats:
        """Output (..., act) of the rows (..., N) that leave the chip."""
        readout = self.program.readout
        # a readout copies; spikes may be memory of the backend
        spikes = presynaptic.astype(np.float64, copy=readout is None)
        return np.asarray(spikes if readout is None else readout(spikes))


class Host:
    """The host of a program, where its output is not the spikes of one layer alone.

    Membranes of readout layers become floats again. Readout layers that the chip has no way out for
    are integrated here, in float64, from the spikes of their sources, which leave the chip, and
    those of the input, which the host has. Outputs add up spikes and membranes.
    """

    def __init__(self, program: Program, batch: int) -> None:
        self._program, self._batch = program, batch
        # name, weight (N, act) or None, lag, and the elements of the output that it adds to
        self._terms: list[tuple[str, Floats | None, int, slice]] = []
        first, biases = 0, []
        for node in program.output_nodes:
            elements = slice(first, first + len(node.bias))
            self._terms += [(term.layer, term.weight, term.lag, elements) for term in node.terms]
            biases.append(node.bias)
            first = elements.stop
        self._bias = np.concatenate(biases)
        self._sizes = program.sizes | {layer.name: layer.size for layer in program.host}
        sources = {s.source for layer in program.host for s in layer.synapses}
        self._reads_input = program.input in sources | {name for name, *_ in self._terms}
        self.reset(streaming=False)

    def reset(self, streaming: bool) -> None:
        """Forget every current and membrane, and all rows that are still late.

        streaming: whether single timesteps of the chip come, in which later layers are behind, and
            not windows, in which rows of one number mean the same.
        """
        program, batch = self._program, self._batch
        here = {layer.name: layer.start for layer in program.layers} if streaming else {}
        starts = {name: here.get(name, 0) for name in (program.input, *program.sizes)}
        latest = max(starts[name] for name in (program.input, *program.output_layers))

        def late(name: str, lag: int) -> _Late:
            """Delay what the host has integrated as the last layer that leaves the chip is."""
            return _Late(latest - starts.get(name, latest) + lag, batch, self._sizes[name])

        self._integrators = [
            _Integrator(layer, batch, [late(s.source, s.delay) for s in layer.synapses], latest)
            for layer in program.host
        ]
        self._late = [late(name, lag) for name, _, lag, _ in self._terms]

    def output(self, raster: NDArray[Any], backend: Backend) -> Floats:
        """Output (B, T, act) of the last window, whose input was the raster (T, B, M).

        Of layers that run free, the T timesteps of their windows are read.
        """
        rows = self._rows(raster, backend)
        for integrator in self._integrators:
            rows[integrator.layer.name] = integrator.run(rows)
        output = np.empty((*raster.shape[:2], len(self._bias)))
        output[...] = self._bias
        for (name, weight, _, elements), late in zip(self._terms, self._late, strict=True):
            arriving, total = late.through(rows[name]), output[..., elements]
            np.add(total, arriving if weight is None else arriving @ weight, out=total)
        return np.asarray(output.swapaxes(0, 1))

    def _rows(self, raster: NDArray[Any], backend: Backend) -> dict[str, Floats]:
        """(T, B, N) of the input, where the host uses it, and of all that leaves the chip."""
        program = self._program
        rows = {program.input: raster.astype(np.float64)} if self._reads_input else {}
        single = backend.schedule.mode == "step"
        for name in program.output_layers:
            layer = program.layer(name)
            ran = backend.spikes(name) if layer.spiking else backend.membranes(name) * layer.scale
            read = ran if single else ran[program.window(layer, len(ran))]
            rows[name] = read.astype(np.float64, copy=False)
        return rows


class _Late:
    """Rows that arrive some timesteps late."""

    def __init__(self, delay: int, batch: int, size: int) -> None:
        self._tail = np.zeros((delay, batch, size))

    def through(self, rows: Floats) -> Floats:
        """The rows (T, B, N) that arrive now."""
        if not len(self._tail):
            return rows
        all_ = np.concatenate([self._tail, rows])
        self._tail = all_[len(rows) :]
        return all_[: len(rows)]


class _Integrator:
    """A readout layer in float64, as the float twin computes it."""

    def __init__(self, layer: Layer, batch: int, late: Sequence[_Late], waits: int) -> None:
        self.layer, self._late = layer, late
        self._current = self._membrane = np.zeros((batch, layer.size))
        # as a layer of the chip, it begins when what is late arrives
        self._waits = waits

    def run(self, rows: dict[str, Floats]) -> Floats:
        """Membranes (T, B, N) after each timestep."""
        layer = self.layer
        arrived = [
            synapses.sums(late.through(rows[synapses.source]))
            for synapses, late in zip(layer.synapses, self._late, strict=True)
        ]
        drive: Floats = sum(arrived, layer.bias)
        membranes = np.zeros_like(drive)
        if self._waits:
            self._waits -= 1
            return membranes
        for t, arriving in enumerate(drive):
            # I = a I + W s      V = b V + I + bias
            self._current = layer.current_decay * self._current + arriving
            self._membrane = (
                layer.membrane_decay * self._membrane + self._current + layer.voltage_bias
            )
            membranes[t] = self._membrane
        return membranes
