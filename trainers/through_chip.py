"""Any network, trained through the integers of a chip.

`ChipModule` is a torch module whose forward pass is the chip's program: the present numbers are
written as NIR, compiled, and run by the fastest backend of the chip. The backward pass goes through
the difference equations in float, at the currents, membranes and spikes that the chip had, with a
surrogate for the derivative of a spike (Neftci et al. 2019), and straight through the rounding of
numbers (Esser et al. 2016):

    dL/dV[t]  = s'(V[t] - threshold) dL/ds[t] + dV'/dV dL/dV'[t]     V' the membrane after the reset
    dL/dV'[t] = b dL/dV[t+1]
    dL/dI[t]  = dL/dV[t] + a dL/dI[t+1]

where dV'/dV = (1 - s) - V s' if a spike resets to zero, and 1 - threshold s' if it subtracts the
threshold, as in snnTorch's neurons with reset_delay=False. Of neurons that spike several times in a
timestep and then are 0, V is the sum of all that arrived in it, so that V s' would grow without
bounds from timestep to timestep: no gradient goes through that reset. With `detach_reset` none goes
through any, as by SpikingJelly's option of this name (Zenke and Vogels 2021). Layers are
differentiated over all timesteps at once; in a network with loops over one after another.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from spikedeploy.runtime.artifact.artifact import Artifact, save
from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.chips.layer import Recording
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.compiler.compile import Recompiler
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention, Floor, Reset, SpikeCondition
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ArtifactError, ConfigError, ObservationError, RuleError
from spikedeploy.runtime.families.numba_frame import kept_on_disk
from spikedeploy.runtime.graph.order import Timing, timing
from spikedeploy.trainers.fitting import fit, straight_through
from spikedeploy.trainers.from_torch import given_shape, network_from_torch
from spikedeploy.trainers.surrogate_neurons import Surrogate, surrogate
from spikedeploy.trainers.torch_network import (
    Delay,
    Equation,
    Neurons,
    TorchNetwork,
    Weights,
    network_of,
)

Array = NDArray[np.floating[Any]]


def on_chip(
    network: nn.Module | Artifact,
    chip_name: str,
    input_shape: Sequence[int] | None = None,
    *,
    dt: float = 1e-3,
    limits: bool = True,
    surrogate_name: str | None = None,
    surrogate_width: float | None = None,
    detach_reset: bool = False,
) -> "ChipModule":
    """Return a network as a module whose forward pass is a chip; its parameters are the network's.

    network: a torch module with neurons of a library (from_torch), or an artifact
    chip_name: name as on the command line, such as "loihi1" or "int:weight_bits=2"
    input_shape: of a timestep of one sample, of a torch module
    dt: [s] of a timestep, of a torch module
    limits: refuse what breaks a design rule of the chip; weights fit its axons (trainers.fitting).
        False trains what does not fit
    surrogate_name, surrogate_width: of the derivative of a spike; by default the network's own
    detach_reset: let no gradient through the reset

    Raises ConfigError where the module has no form on a chip, RuleError where it does not fit. A
    neuron that the chip does not have is trained as the nearest that it has; a warning says so.
    """
    target, codec = chip(chip_name), None
    if isinstance(network, Artifact):
        nodes, wanted, codec = network_of(network), network.convention, network.codec
    else:
        nodes, wanted = network_from_torch(network, given_shape(input_shape))
        wanted = replace(wanted, dt=dt, source="as trained")
    found = convention_on(target, wanted)
    fitted = fit(nodes, target) if limits else ""
    chosen = surrogate_name, surrogate_width
    module = ChipModule(nodes, target, found, codec, limits, *chosen, detach_reset)
    module.program()  # what does not fit is refused here
    for remark in filter(None, (nearest_remark(target, found, wanted), fitted)):
        warnings.warn(remark, stacklevel=2)
    return module


def nearest_remark(target: Chip, found: Convention, wanted: Convention) -> str:
    """Return how the neurons of a chip differ from those that are wanted; empty if they do not."""
    parts = []
    if wanted.reset not in (found.reset, "none"):
        parts.append(
            f"resets by {wanted.reset!r}, which {target.name} does not; trained is the nearest "
            f"that it does, reset {found.reset!r} in the timestep of the spike"
        )
    if wanted.spikes == "many" and found.spikes != "many":
        parts.append(
            f"puts out as many spikes as fit, and {target.name} one in a timestep; trained is "
            "the nearest, one spike"
        )
    return f"the network {'; '.join(parts)}" if parts else ""


def convention_on(target: Chip, wanted: Convention) -> Convention:
    """Return the convention of the chip's neurons that is nearest to what is wanted."""
    arithmetic = target.arithmetic
    nearest: Reset = "subtract" if wanted.reset.startswith("subtract") else "zero"
    reset = nearest if nearest in target.resets else cast("Reset", target.resets[0])
    # without rounding both are exact
    at_threshold = wanted.spikes == "reached" and not arithmetic.is_rounded
    spikes: SpikeCondition = (
        "reached" if arithmetic.spikes_at_threshold or at_threshold else "above"
    )
    if arithmetic.spikes_max > 1 and reset == "subtract":
        spikes = "many"
    floor: Floor = "zero" if getattr(arithmetic, "floor", None) == 0 else "none"
    # files of ours state decay factors by forward Euler
    return replace(wanted, reset=reset, spikes=spikes, floor=floor, integrator="euler", delay=0)


class ChipModule(nn.Module):
    """A network on a chip: spikes (T, B, *takes) in, what leaves the chip (T, B, *puts) out.

    network: its parameters are these, and where axons have types, their weights
    target: the datasheet of the chip
    convention: convention of the network, and of the files that `save` writes
    codec: codec of the files that `save` writes, where the network drives a robot
    limits: refuse what breaks a design rule of the chip
    surrogate_name, surrogate_width: of the derivative of a spike, as in
        trainers.surrogate_neurons; by default that of each neuron, else atan
    detach_reset: let no gradient through the reset
    spikes: name -> (T, B, *shape) of each layer in the last forward pass with gradients; membranes
        of layers that do not spike
    """

    def __init__(
        self,
        network: TorchNetwork,
        target: Chip,
        convention: Convention,
        codec: Codec | None = None,
        limits: bool = True,
        surrogate_name: str | None = None,
        surrogate_width: float | None = None,
        detach_reset: bool = False,
    ) -> None:
        super().__init__()
        self.network, self.target, self.codec, self.limits = network, target, codec, limits
        self.convention, self.detach_reset = convention, detach_reset
        self.spikes: dict[str, Tensor] = {}
        is_chosen = surrogate_name is not None or surrogate_width is not None
        self._default = surrogate(surrogate_name or "atan", surrogate_width)
        self._chosen = self._default if is_chosen else None
        # made when they are first needed, as a network of a checkpoint has no numbers before
        self._compiler: Recompiler | None = None
        self._compiled: tuple[bytes, Program] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies have: all but the program, which each compiles for itself."""
        return {**vars(self), "spikes": {}, "_compiler": None, "_compiled": None}

    def forward(self, spikes: Tensor) -> Tensor:
        """Return the output (T, B, *puts) of the chip for spikes (T, B, *takes).

        Where gradients are recorded, those of the output lead to parameters and spikes.
        """
        if not torch.is_grad_enabled():
            return self._run(spikes, trace=False)[0]
        for node in self.network.nodes.values():
            if isinstance(node, Weights):
                node.project()
        output, machine = self._run(spikes, trace=True)
        rows = self._propagate(spikes.to(output.dtype), machine)
        self.spikes = {name: rows[name] for name, _ in self._neurons}
        return straight_through(output, rows[TorchNetwork.OUTPUT])

    def layers(self, spikes: Tensor) -> dict[str, Tensor]:
        """Return the spikes (T, B, *shape) of each spiking layer on the chip, without gradients."""
        output, machine = self._run(spikes, trace=True)
        shapes = {name: node.takes for name, node in self._neurons}
        found = {
            layer.name: time_first(machine.recordings[layer.name].spikes, output.dtype)
            for layer in machine.program.spiking
        }
        return {name: rows.reshape(*rows.shape[:2], *shapes[name]) for name, rows in found.items()}

    def artifact(self) -> Artifact:
        """Return the present numbers as an artifact, which every command runs."""
        return self.network.artifact(self.convention, self.codec)

    def save(self, path: str | Path) -> Path:
        """Write the present numbers as a NIR file with its convention; return its path."""
        save(self.artifact(), path)
        return Path(path)

    def program(self) -> Program:
        """Return the chip's program of the present numbers."""
        # fused optimisers do not count versions of tensors, so their numbers are compared
        tensors = (*self.network.parameters(), *self.network.buffers())
        held = b"".join(each.detach().numpy().tobytes() for each in tensors)
        if self._compiled is None or held != self._compiled[0]:
            self._check_finite()
            if self._compiler is None:
                self._compiler = Recompiler(self.artifact(), self.target, limits=self.limits)
                program = self._compiler.first
            else:
                try:
                    program = self._compiler.program(self.network.graph(self.convention.dt))
                except (RuleError, ArtifactError) as error:
                    raise type(error)(
                        f"{error} It fitted before the last update: train more slowly, at a "
                        "smaller learning rate."
                    ) from error
            self._compiled = held, program
        return self._compiled[1]

    def _check_finite(self) -> None:
        cause = "as the network was given. Correct it"
        if self._compiled is not None:
            cause = "after an update: the loss was not finite, or the learning rate is too large"
        for node, module in self.network.nodes.items():
            for name, tensor in module.named_parameters():
                wrong = tensor.detach()[~tensor.detach().isfinite()]
                if wrong.numel():
                    number = f"{name.rpartition('.')[2]} of {node!r}"
                    raise ConfigError(f"parameter {number} holds {wrong[0]:g} {cause}")

    @cached_property
    def _timing(self) -> Timing:
        """The order of the nodes, of shapes, edges and the clock, which stay."""
        clocked = self.program().convention
        return timing(self.network.artifact(clocked).graph, clocked)

    @cached_property
    def _neurons(self) -> list[tuple[str, Neurons]]:
        return [(n, node) for n, node in self.network.nodes.items() if isinstance(node, Neurons)]

    @property
    def _dtype(self) -> torch.dtype:
        return next((p.dtype for p in self.network.parameters()), torch.float32)

    def _run(self, spikes: Tensor, trace: bool) -> tuple[Tensor, Machine]:
        """Return the output (T, B, *puts) of the chip, and the machine, which has its activity."""
        counts = self._raster(spikes)
        machine = Machine(self.program(), None, "none", trace=trace, backend="auto")
        output = time_first(machine.infer(counts), self._dtype)
        return output.reshape(*spikes.shape[:2], *self.network.puts), machine

    def _raster(self, spikes: Tensor) -> NDArray[np.uint8]:
        """Return the spikes as the chip takes them, (B, T, M)."""
        if not isinstance(spikes, Tensor):
            raise ObservationError(
                f"the spikes are a {type(spikes).__name__}, and the module takes tensors, as of "
                "torch.from_numpy(spikes)"
            )
        takes, shape = self.network.takes, tuple(spikes.shape)
        if shape[2:] != takes or not all(shape[:2]) or len(shape) < 2:
            wanted = ", ".join(["T", "B", *map(str, takes)])
            raise ObservationError(
                f"the spikes have shape {shape}; this network takes ({wanted}), timesteps first, "
                "at least one timestep and one sample."
            )
        values = spikes.detach().to(self._dtype).flatten(2).numpy()
        counts = np.empty((values.shape[1], len(values), values.shape[2]), np.uint8)
        if not _count(values, counts):
            raise ObservationError(
                f"the input holds numbers from {values.min():g} to {values.max():g}; "
                "a chip takes whole spikes. Encode it first, as rates or latencies."
            )
        return counts

    def _propagate(self, spikes: Tensor, machine: Machine) -> dict[str, Tensor]:
        """Return what each node puts out (T, B, *puts), with gradients.

        Node after node, over all timesteps at once; over one after another where there are loops.
        """
        nodes, order = self.network.nodes, self._timing
        sources = {name: self.network.sources(name) for name in order.names}
        layers = {
            name: self._layer(name, node, spikes.dtype, machine) for name, node in self._neurons
        }
        rows: dict[str, list[Tensor]] = {name: [] for name in order.names}
        arrived: dict[str, list[Tensor]] = {name: [] for name in order.delays}
        for k, window in enumerate(torch.split(spikes, 1 if order.loops else len(spikes))):
            for name in order.names:
                found = [
                    self._late(rows[s], s, window, k) if (s, name) in order.late else rows[s][k]
                    for s in sources[name]
                ]
                arriving = reduce(add, found) if found else window
                node = nodes.get(name)
                if isinstance(node, Neurons):
                    puts = layers[name].advance(arriving.flatten(2)).reshape(arriving.shape)
                elif isinstance(node, Delay):
                    arrived[name].append(arriving)
                    puts = _delayed(arrived[name], order.delays[name])
                elif node is None:  # an end of the graph
                    puts = arriving
                else:
                    puts = node(arriving.flatten(0, 1)).unflatten(0, arriving.shape[:2])
                rows[name].append(puts)
        return {name: each[0] if len(each) == 1 else torch.cat(each) for name, each in rows.items()}

    def _late(self, rows: Sequence[Tensor], source: str, window: Tensor, k: int) -> Tensor:
        """Return what a node puts out in window k, a timestep late."""
        if k:
            first = rows[k - 1][-1:]
        else:
            node = self.network.nodes.get(source)
            puts = self.network.takes if node is None else node.puts
            first = window.new_zeros(1, window.shape[1], *puts)
        return first if len(window) == 1 else torch.cat([first, rows[k][:-1]])

    def _layer(self, name: str, node: Neurons, dtype: torch.dtype, machine: Machine) -> "_Layer":
        equation, seen = node.equation(dtype), None
        if (recording := machine.recordings.get(name)) is not None:
            seen = _activity(machine.program, name, recording, equation)
        derivative = self._chosen or node.derivative or self._default
        return _Layer(equation, seen, derivative, self.detach_reset)


def _delayed(windows: list[Tensor], steps: NDArray[np.int64]) -> Tensor:
    """Return the last window (T, B, *N) of what arrived, `steps` (*N) timesteps late."""
    rows, length = torch.cat(windows), len(windows[-1])
    rows = rows[-int(steps.max()) - length :]
    found = torch.zeros_like(rows)
    for step in np.unique(steps).tolist():
        shifted = torch.cat([torch.zeros_like(rows[:step]), rows[: max(len(rows) - step, 0)]])
        found = torch.where(torch.from_numpy(steps == step), shifted, found)
    return found[-length:]


@dataclass(frozen=True, eq=False)
class _Activity:
    """Activity of a layer's neurons on the chip, (T, B, N) in float units.

    current: equal to the membrane where the equation has no current
    before, behind: membranes before and after a reset; NaN before where the chip cannot tell
    threshold: (N,) as the chip has it
    spiking: False where the layer puts out its membranes
    subtracts: True where a spike subtracts the threshold, False where it sets the membrane to 0
    several: True where a neuron may spike several times in a timestep
    tells: False where `before` holds NaN
    """

    current: Tensor
    before: Tensor
    behind: Tensor
    spikes: Tensor
    threshold: Tensor
    spiking: bool = False
    subtracts: bool = False
    several: bool = False
    tells: bool = True

    def window(self, rows: slice) -> "_Activity":
        """Return the activity in some timesteps."""
        cut = {
            name: getattr(self, name)[rows] for name in ("current", "before", "behind", "spikes")
        }
        return replace(self, **cut)


def _activity(program: Program, name: str, recorded: Recording, equation: Equation) -> _Activity:
    """Return what a layer did on the chip, in the type of the equation."""
    arithmetic, convention = program.chip.arithmetic, program.convention
    layer, dtype = program.layer(name), equation.membrane_decay.dtype
    before = arithmetic.before_reset(layer, convention, recorded)
    most = arithmetic.spikes_max
    if name == program.output:
        most = getattr(arithmetic, "output_spikes_max", most)
    behind = time_first(recorded.membrane, dtype, layer.scale)
    return _Activity(
        behind
        if equation.current_decay is None
        else time_first(recorded.current, dtype, layer.scale),
        behind if before is recorded.membrane else time_first(before, dtype, layer.scale),
        behind,
        time_first(recorded.spikes, dtype),
        torch.from_numpy(np.asarray(layer.threshold * layer.scale, np.float64)).to(dtype),
        equation.threshold is not None,
        convention.reset == "subtract",
        most > 1,
        before.dtype.kind != "f" or not np.isnan(before).any(),
    )


class _Layer:
    """Neurons that go through windows of timesteps, with the activity that the chip recorded.

    seen: None of neurons that the host integrates, which do not spike
    """

    def __init__(
        self,
        equation: Equation,
        seen: _Activity | None,
        derivative: Surrogate,
        detach_reset: bool,
    ) -> None:
        a, b, threshold, leak, self._gain = equation
        none = torch.zeros_like(b)
        numbers = [none if each is None else each for each in (a, b, threshold, leak)]
        self._constants, self._has_current = torch.stack(numbers), a is not None
        self._array = self._constants.detach().numpy()
        self._seen, self._derivative, self._detach_reset = seen, derivative, detach_reset
        self._at, self._states = 0, none  # currents and membranes (2, B, N) of the timestep before

    def advance(self, arriving: Tensor) -> Tensor:
        """Return spikes or membranes (T, B, N) of the next timesteps for what arrives (T, B, N)."""
        drive = arriving * self._gain
        if not self._at:
            self._states = drive.new_zeros(2, *drive.shape[1:])
        seen = self._window(drive, slice(self._at, self._at + len(drive)))
        self._at += len(drive)
        passes = not self._detach_reset and (seen.subtracts or not seen.several)
        found: Tensor
        found, self._states = _Neurons.apply(  # type: ignore[no-untyped-call]
            drive, self._states, self._constants, seen, self._derivative, passes
        )
        return found

    def _window(self, drive: Tensor, rows: slice) -> _Activity:
        """Return what the neurons did in some timesteps."""
        if self._seen is not None and self._seen.tells:
            return self._seen.window(rows)
        arriving, states = drive.detach().contiguous().numpy(), self._states.detach().numpy()
        if self._seen is None:
            return _integrated(arriving, states, self._array)
        seen = self._seen.window(rows)
        before = seen.before.numpy().copy()
        arriving = seen.current.numpy() if self._has_current else arriving
        _fill_unknown(before, seen.behind.numpy(), arriving, states, self._array)
        return replace(seen, before=torch.from_numpy(before), tells=True)


def _integrated(drive: Array, states: Array, constants: Array) -> _Activity:
    """Return the activity of neurons that do not spike, by their equation."""
    current, membrane = np.empty_like(drive), np.empty_like(drive)
    before_i, before_v = states
    for t, x in enumerate(drive):
        # I = a I + x ; V = b V + I + leak
        before_i = current[t] = constants[0] * before_i + x
        before_v = membrane[t] = constants[1] * before_v + before_i + constants[3]
    behind = torch.from_numpy(membrane)
    threshold = torch.from_numpy(constants[2])
    return _Activity(torch.from_numpy(current), behind, behind, behind, threshold)


class _Neurons(torch.autograd.Function):
    """What a layer did on the chip in a window of timesteps; the gradient at what was recorded.

    Returns spikes or membranes (T, B, N), and the last currents and membranes (2, B, N).
    """

    @staticmethod
    def forward(
        ctx: Any,  # noqa: ANN401
        drive: Tensor,
        states: Tensor,
        constants: Tensor,
        seen: _Activity,
        derivative: Surrogate,
        through_reset: bool,
    ) -> tuple[Tensor, Tensor]:
        ctx.held = states.detach(), constants.detach(), seen
        ctx.derivative, ctx.through_reset = derivative, through_reset
        found = seen.spikes if seen.spiking else seen.behind
        # other tensors than ctx holds: a cycle through the graph would never be freed
        return found.detach(), torch.stack([seen.current[-1], seen.behind[-1]])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor, later: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        states, constants, seen = ctx.held
        if not seen.spiking:
            slope = torch.ones_like(upstream)  # of membranes, from which nothing is subtracted
        else:
            slope = ctx.derivative(seen.before - seen.threshold)
        if seen.spiking and seen.several:
            # s = floor(V / threshold): on average one more for each threshold
            slope = torch.where(seen.before > seen.threshold, 1 / constants[2], slope)
        rows = [
            each.contiguous().numpy()
            for each in (upstream, slope, seen.before, seen.behind, seen.current, seen.spikes)
        ]
        to_states, to_numbers = later.clone(), torch.zeros_like(constants)
        to_drive = torch.empty_like(upstream, memory_format=torch.contiguous_format)
        tensors = states, constants, to_states, to_drive, to_numbers
        arrays = [each.numpy() for each in tensors]
        _differentiate(seen.subtracts or not seen.spiking, ctx.through_reset, *rows, *arrays)
        return to_drive, to_states, to_numbers, None, None, None


@kept_on_disk
def _differentiate(
    subtracts: bool,
    through_reset: bool,
    upstream: Array,
    slope: Array,
    before: Array,
    behind: Array,
    current: Array,
    spikes: Array,
    states: Array,
    constants: Array,
    to_states: Array,
    to_drive: Array,
    to_numbers: Array,
) -> None:
    """Write gradients of the drive (T, B, N), and add up those of the numbers (4, N).

    states: (2, B, N) current and membrane before the first timestep
    constants: (4, N) a, b, threshold and leak
    to_states: (2, B, N) gradients of the current and of the membrane behind the reset: of the last
        timestep at first, of `states` in the end
    """
    zero = constants[0, 0] - constants[0, 0]
    for t in range(upstream.shape[0] - 1, -1, -1):
        last_current = current[t - 1] if t else states[0]
        last_membrane = behind[t - 1] if t else states[1]
        for n_b in range(upstream.shape[1]):
            for n in range(upstream.shape[2]):
                a, b, threshold = constants[0, n], constants[1, n], constants[2, n]
                g, v, s = slope[t, n_b, n], before[t, n_b, n], spikes[t, n_b, n]
                after = to_states[1, n_b, n]
                reset = after if through_reset else zero
                if subtracts:
                    to_spike = upstream[t, n_b, n] - threshold * reset
                    to_membrane = g * to_spike + after
                    to_numbers[2, n] -= g * to_spike + s * after
                else:
                    to_spike = upstream[t, n_b, n] - v * reset
                    to_membrane = g * to_spike + (after if s == zero else zero)
                    to_numbers[2, n] -= g * to_spike
                to_current = to_membrane + to_states[0, n_b, n]
                to_drive[t, n_b, n] = to_current
                to_numbers[0, n] += to_current * last_current[n_b, n]
                to_numbers[1, n] += to_membrane * last_membrane[n_b, n]
                to_numbers[3, n] += to_membrane
                to_states[0, n_b, n] = a * to_current
                to_states[1, n_b, n] = b * to_membrane


@kept_on_disk
def _fill_unknown(
    before: Array, behind: Array, arriving: Array, states: Array, constants: Array
) -> None:
    """Write V = b V' + I + leak where a membrane (T, B, N) before its reset is NaN.

    states, constants: as of `_differentiate`
    """
    for t in range(before.shape[0]):
        for b in range(before.shape[1]):
            for n in range(before.shape[2]):
                if np.isnan(before[t, b, n]):
                    last = behind[t - 1, b, n] if t else states[1, b, n]
                    before[t, b, n] = arriving[t, b, n] + constants[3, n] + constants[1, n] * last


def time_first(values: NDArray[Any], dtype: torch.dtype, scale: float | Array = 1.0) -> Tensor:
    """Return (B, T, N), or the sum of K currents (B, T, K, N), times (N,) as (T, B, N)."""
    summed = values
    if values.ndim == 4:
        summed = values[:, :, 0] if values.shape[2] == 1 else values.sum(axis=2)
    found = torch.empty(summed.shape[1], len(summed), summed.shape[2], dtype=dtype)
    each = np.empty(summed.shape[2])
    each[:] = scale
    _scale(summed, each, found.numpy())
    return found


@kept_on_disk
def _scale(values: Array, scale: Array, found: Array) -> None:
    """Write (B, T, N) times (N,) as (T, B, N)."""
    for b in range(values.shape[0]):
        for t in range(values.shape[1]):
            for n in range(values.shape[2]):
                found[t, b, n] = values[b, t, n] * scale[n]


@kept_on_disk
def _count(values: Array, counts: NDArray[np.uint8]) -> bool:
    """Write whole numbers (T, B, M) as counts (B, T, M); False if there are others."""
    others = 0
    for t in range(values.shape[0]):
        for b in range(values.shape[1]):
            for m in range(values.shape[2]):
                held = np.uint8(min(max(values[t, b, m], 0), 255))
                others += held != values[t, b, m]
                counts[b, t, m] = held
    return others == 0
