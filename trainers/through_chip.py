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
through any, as by SpikingJelly's option of this name (Zenke and Vogels 2021).
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
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
from spikedeploy.runtime.convention import Convention, Floor, Reset, Spikes
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ArtifactError, ConfigError, ObservationError, RuleError
from spikedeploy.runtime.families.numba_frame import kept_on_disk
from spikedeploy.runtime.graph.order import Timing, timing
from spikedeploy.trainers.from_torch import common_meaning, given_shape, network_from_torch
from spikedeploy.trainers.neurons import Surrogate, surrogate
from spikedeploy.trainers.torch_network import (
    Delay,
    Equation,
    Neurons,
    TorchNetwork,
    Weights,
    network_of,
)
from spikedeploy.trainers.torch_neurons.adapter import Meaning

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
    target = chip(chip_name)
    if isinstance(network, Artifact):
        nodes, stated, codec = network_of(network), network.convention, network.codec
        meaning = Meaning(stated.reset, stated.spikes, "a neuron of the file", stated.floor)
    else:
        nodes, neurons = network_from_torch(network, given_shape(input_shape))
        meaning = common_meaning(neurons)
        stated, codec = Convention(dt, source="as trained"), None
    convention = convention_on(target, stated, meaning)
    fitted = nodes.fit(target) if limits else ""
    chosen = surrogate_name, surrogate_width
    module = ChipModule(nodes, target, convention, codec, limits, *chosen, detach_reset)
    module.program()  # what does not fit is refused here
    for remark in filter(None, (nearest_remark(target, convention, meaning), fitted)):
        warnings.warn(remark, stacklevel=2)
    return module


def nearest_remark(target: Chip, found: Convention, wanted: Meaning) -> str:
    """Return how the neurons of a chip differ from those that are wanted; empty if they do not."""
    parts = []
    if wanted.reset not in (found.reset, "none"):
        parts.append(
            f"resets by {wanted.reset!r}, which {target.name} does not; trained is the nearest "
            f"that it does, reset {found.reset!r} in the timestep of the spike"
        )
    if wanted.spikes == "many" and wanted.reset != "none" and found.spikes != "many":
        parts.append(
            f"puts out as many spikes as fit, and {target.name} one in a timestep; trained is "
            "the nearest, one spike"
        )
    return f"{wanted.described} {'; '.join(parts)}" if parts else ""


def convention_on(target: Chip, stated: Convention, wanted: Meaning) -> Convention:
    """Return the convention of the chip's neurons that is nearest to what is wanted."""
    arithmetic = target.arithmetic
    nearest: Reset = "subtract" if wanted.reset.startswith("subtract") else "zero"
    reset = nearest if nearest in target.resets else cast("Reset", target.resets[0])
    # without rounding both are exact
    at_threshold = wanted.spikes == "reached" and not arithmetic.rounds
    spikes: Spikes = "reached" if arithmetic.spikes_at_threshold or at_threshold else "above"
    if arithmetic.spikes_max > 1 and reset == "subtract":
        spikes = "many"
    floor: Floor = "zero" if getattr(arithmetic, "floor", None) == 0 else "none"
    # files of ours state decay factors by forward Euler
    return replace(stated, reset=reset, spikes=spikes, floor=floor, integrator="euler", delay=0)


class ChipModule(nn.Module):
    """A network on a chip: spikes (T, B, *takes) in, what leaves the chip (T, B, *puts) out.

    network: its parameters are these, and where axons have types, their weights
    target: the datasheet of the chip
    convention: convention of the network, and of the files that `save` writes
    codec: codec of the files that `save` writes, where the network drives a robot
    limits: refuse what breaks a design rule of the chip
    surrogate_name, surrogate_width: of the derivative of a spike, as in trainers.neurons; by
        default that of each neuron, else atan
    detach_reset: let no gradient through the reset
    records: keep `spikes` where no gradients are recorded, too
    spikes: name -> (T, B, *shape) of each layer in the last forward pass with gradients; membranes
        of layers that do not spike
    """

    records = False

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
        self.detach_reset = detach_reset
        self.network, self.target, self.codec, self.limits = network, target, codec, limits
        self.convention = convention
        self.spikes: dict[str, Tensor] = {}
        self._is_chosen = surrogate_name is not None or surrogate_width is not None
        self._surrogate = surrogate(surrogate_name or "atan", surrogate_width)
        # made when they are first needed, as a network of a checkpoint has no numbers before
        self._compiler: Recompiler | None = None
        self._compiled: tuple[bytes, Program] | None = None

    def forward(self, spikes: Tensor) -> Tensor:
        """Return the output (T, B, *puts) of the chip for spikes (T, B, *takes).

        Where gradients are recorded, those of the output lead to parameters and spikes.
        """
        spikes = self._given(spikes)
        differentiable = torch.is_grad_enabled()
        if differentiable:
            for node in self.network.nodes.values():
                if isinstance(node, Weights):
                    node.settle()
        program, puts = self.program(), self.network.puts
        traced = differentiable or self.records
        machine = Machine(program, None, "none", trace=traced, backend="auto")
        output = machine.infer(self._raster(spikes))
        found = time_first(output, spikes, 1.0).reshape(*spikes.shape[:2], *puts)
        if not traced:
            return found
        run = self._by_timesteps if self._timing.loops else self._by_layers
        through = run(spikes, _Records(program, machine.recordings))
        return _exactly(found, through) if differentiable else found

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
        held = self._numbers()
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
        for node, module in self.network.nodes.items():
            for name, tensor in module.named_parameters():
                if not bool(tensor.isfinite().all()):
                    cause = (
                        "as the network was given. Correct it"
                        if self._compiled is None
                        else "after an update: the loss was not finite, or the learning rate is "
                        "too large"
                    )
                    raise ConfigError(
                        f"parameter {name.rpartition('.')[2]} of {node!r} holds "
                        f"{_first_infinite(tensor):g} {cause}"
                    )

    @cached_property
    def _timing(self) -> Timing:
        """The order of the nodes, of shapes, edges and the clock, which stay."""
        clocked = self.program().convention
        return timing(self.network.artifact(clocked).graph, clocked)

    def __deepcopy__(self, memo: dict[int, Any]) -> "ChipModule":
        """Return a module with a copy of the network, which compiles its own program."""
        copied = (deepcopy(self.network, memo), self.target, self.convention, self.codec)
        copy = ChipModule(*copied, self.limits, detach_reset=self.detach_reset)
        copy._is_chosen, copy._surrogate = self._is_chosen, self._surrogate
        return copy

    def _numbers(self) -> bytes:
        tensors = (*self.network.parameters(), *self.network.buffers())
        return b"".join(each.detach().numpy().tobytes() for each in tensors)

    def _given(self, spikes: Tensor) -> Tensor:
        """Return the spikes in the type of the network's numbers."""
        if not isinstance(spikes, Tensor):
            raise ObservationError(
                f"the spikes are a {type(spikes).__name__}, and the module takes tensors, as of "
                "torch.from_numpy(spikes)"
            )
        kinds = [p.dtype for p in self.network.parameters() if p.is_floating_point()]
        return spikes.to(kinds[0] if kinds else torch.float32)

    def _raster(self, spikes: Tensor) -> NDArray[np.uint8]:
        """Return the spikes as the chip takes them, (B, T, M)."""
        takes = self.network.takes
        if tuple(spikes.shape[2:]) != takes or spikes.ndim < 2:
            wanted = ", ".join(["T", "B", *map(str, takes)])
            raise ObservationError(
                f"the spikes have shape {tuple(spikes.shape)}; this network takes ({wanted}), "
                "timesteps first."
            )
        if not all(spikes.shape[:2]):
            raise ObservationError(
                f"the spikes have shape {tuple(spikes.shape)}: give at least one timestep and one "
                "sample"
            )
        values = spikes.detach().flatten(2).numpy()
        counts = np.empty((values.shape[1], len(values), values.shape[2]), np.uint8)
        if not _count(values, counts):
            raise ObservationError(
                f"the input holds numbers from {values.min():g} to {values.max():g}; "
                "a chip takes whole spikes. Encode it first, as rates or latencies."
            )
        return counts

    @property
    def _sources(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for source, target in sorted(self.network.edges):
            found.setdefault(target, []).append(source)
        return found

    def _by_layers(self, spikes: Tensor, records: "_Records") -> Tensor:
        """Return the output (T, B, *puts), node after node over all timesteps."""
        nodes, before, late = self.network.nodes, self._sources, self._timing.late
        values = {TorchNetwork.INPUT: spikes}
        for name in self._timing.names:
            if name == TorchNetwork.INPUT:
                continue
            arriving = _sum(delayed(values[s], int((s, name) in late)) for s in before[name])
            node = nodes.get(name)
            if node is None or isinstance(node, Delay):
                values[name] = arriving if node is None else node(arriving)
            elif isinstance(node, Neurons):
                rows = self._layer(name, node, arriving.flatten(2), records)
                values[name] = rows.reshape(*spikes.shape[:2], *node.takes)
            else:
                values[name] = node(arriving.flatten(0, 1)).unflatten(0, spikes.shape[:2])
        self.spikes = {n: values[n] for n, node in nodes.items() if isinstance(node, Neurons)}
        return values[TorchNetwork.OUTPUT]

    def _by_timesteps(self, spikes: Tensor, records: "_Records") -> Tensor:
        """Return the output (T, B, *puts), timestep after timestep, as loops need it."""
        nodes, before, late = self.network.nodes, self._sources, self._timing.late
        steps = {
            name: _Step(
                equation,
                records.layer(name, spikes, equation),
                self._derivative(node),
                self.detach_reset,
            )
            for name, node in nodes.items()
            if isinstance(node, Neurons)
            for equation in [node.equation(spikes.dtype)]
        }
        rows: dict[str, list[Tensor]] = {name: [] for name in self._timing.names}
        waiting: dict[str, list[Tensor]] = {name: [] for name in self._timing.names}
        for t, arrived in enumerate(spikes.unbind()):
            for name in self._timing.names:
                if name == TorchNetwork.INPUT:
                    rows[name].append(arrived)
                    continue
                found = [
                    rows[s][t - 1] if (s, name) in late else rows[s][t]
                    for s in before[name]
                    if t or (s, name) not in late
                ]
                node = nodes.get(name)
                takes = self.network.puts if node is None else node.takes
                arriving = _sum(found) if found else arrived.new_zeros(len(arrived), *takes)
                if isinstance(node, Delay):
                    waiting[name].append(arriving)
                    rows[name].append(node.arriving(waiting[name]))
                elif isinstance(node, Neurons):
                    arriving = steps[name].advance(arriving.flatten(1), t)
                    rows[name].append(arriving.reshape(-1, *node.takes))
                else:
                    rows[name].append(arriving if node is None else node(arriving))
        self.spikes = {name: torch.stack(rows[name]) for name in steps}
        return torch.stack(rows[TorchNetwork.OUTPUT])

    def _layer(self, name: str, node: Neurons, arriving: Tensor, records: "_Records") -> Tensor:
        """Return spikes or membranes (T, B, N) of a layer for what arrives (T, B, N)."""
        equation = node.equation(arriving.dtype)
        seen = records.layer(name, arriving, equation)
        drive = arriving * equation.gain
        if seen is None or equation.threshold is None:
            membranes = _integrate(drive, equation)
            return membranes if seen is None else _exactly(seen.behind, membranes)
        found: Tensor = _ChipLayer.apply(  # type: ignore[no-untyped-call]
            drive,
            equation.current_decay,
            equation.membrane_decay,
            equation.threshold,
            equation.leak,
            seen.with_membranes(drive.detach(), equation),
            self._derivative(node),
            self.detach_reset,
        )
        return found

    def _derivative(self, node: Neurons) -> Surrogate:
        own = None if self._is_chosen else node.derivative
        return self._surrogate if own is None else own


@dataclass(frozen=True, eq=False)
class _Seen:
    """Activity of a layer's neurons on the chip, (T, B, N) in float units.

    before, behind: membranes before and after a reset; NaN before where the chip cannot tell
    threshold: (N,) as the chip has it
    subtracts: True where a spike subtracts the threshold, False where it sets the membrane to 0
    several: True where a neuron may spike several times in a timestep
    tells: False where `before` holds NaN
    """

    current: Tensor
    before: Tensor
    behind: Tensor
    spikes: Tensor
    threshold: Tensor
    subtracts: bool
    several: bool
    tells: bool

    def with_membranes(self, drive: Tensor, equation: Equation) -> "_Seen":
        """Return a copy with membranes before a reset; where unknown, by the equation."""
        if self.tells:
            return self
        before = self.before.numpy().copy()
        arriving = drive if equation.current_decay is None else self.current
        leak = torch.zeros_like(equation.membrane_decay) if equation.leak is None else equation.leak
        constants = torch.stack([equation.membrane_decay, leak]).detach()
        _fill_unknown(before, self.behind.numpy(), arriving.contiguous().numpy(), constants.numpy())
        return replace(self, before=torch.from_numpy(before), tells=True)


class _Records:
    """The recordings of a program's layers as tensors."""

    def __init__(self, program: Program, recordings: Mapping[str, Recording]) -> None:
        self._program, self._recordings = program, recordings

    def layer(self, name: str, like: Tensor, equation: Equation) -> _Seen | None:
        """Return what a layer did, in the type of `like`; None where the host integrates it."""
        if (recorded := self._recordings.get(name)) is None:
            return None
        program, layer = self._program, self._program.layer(name)
        arithmetic, convention = program.chip.arithmetic, program.convention
        before = arithmetic.before_reset(layer, convention, recorded)
        last = name == program.output
        most = getattr(arithmetic, "output_spikes_max", arithmetic.spikes_max)
        behind = time_first(recorded.membrane, like, layer.scale)
        return _Seen(
            # which the equation has no use for where it has no current
            behind
            if equation.current_decay is None
            else time_first(recorded.current, like, layer.scale),
            behind if before is recorded.membrane else time_first(before, like, layer.scale),
            behind,
            time_first(recorded.spikes, like, 1.0),
            torch.from_numpy(np.asarray(layer.threshold * layer.scale, np.float64)).to(like.dtype),
            convention.reset == "subtract",
            (most if last else arithmetic.spikes_max) > 1,
            before.dtype.kind != "f" or not np.isnan(before).any(),
        )


class _ChipLayer(torch.autograd.Function):
    """The spikes (T, B, N) of a layer on the chip; the gradient at what was recorded there."""

    @staticmethod
    def forward(
        ctx: Any,  # noqa: ANN401
        drive: Tensor,
        current_decay: Tensor | None,
        membrane_decay: Tensor,
        threshold: Tensor,
        leak: Tensor | None,
        seen: _Seen,
        derivative: Surrogate,
        detach_reset: bool,
    ) -> Tensor:
        ctx.constants = current_decay, membrane_decay, threshold, seen, derivative
        ctx.detach_reset = detach_reset
        ctx.has_leak = leak is not None
        # another tensor than ctx holds: a cycle through the graph would never be freed
        return seen.spikes.detach()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        a, b, threshold, seen, derivative = ctx.constants
        slope = _slope(seen, threshold, derivative)
        through_reset = _passes(seen, ctx.detach_reset)
        to_drive, to_numbers = _backpropagate(upstream, slope, seen, a, b, threshold, through_reset)
        to_a, to_b, to_threshold, to_leak = to_numbers.unbind()
        return (
            to_drive,
            None if a is None else to_a,
            to_b,
            to_threshold,
            to_leak if ctx.has_leak else None,
            None,
            None,
            None,
        )


class _Step:
    """A layer that is advanced by one timestep after another, with torch's own gradients.

    It is what `_ChipLayer` does for all timesteps at once, and what loops need.
    """

    def __init__(
        self,
        equation: Equation,
        seen: _Seen | None,
        derivative: Surrogate,
        detach_reset: bool = False,
    ) -> None:
        self._equation, self._seen, self._derivative = equation, seen, derivative
        self._detach_reset = detach_reset
        self._current: Tensor | None = None
        self._membrane: Tensor | None = None

    def advance(self, arriving: Tensor, t: int) -> Tensor:
        """Return the spikes or membranes (B, N) of timestep t for what arrives (B, N)."""
        equation, seen = self._equation, self._seen
        drive = arriving * equation.gain
        # I = a I + x ; V = b V + I + leak
        if equation.current_decay is not None:
            if self._current is not None:
                drive = equation.current_decay * self._current + drive
            self._current = drive if seen is None else _exactly(seen.current[t], drive)
            drive = self._current
        membrane = drive if equation.leak is None else drive + equation.leak
        if self._membrane is not None:
            membrane = membrane + equation.membrane_decay * self._membrane
        if seen is None or equation.threshold is None:
            self._membrane = membrane if seen is None else _exactly(seen.behind[t], membrane)
            return self._membrane
        unknown = seen.before[t].isnan()
        membrane = _exactly(torch.where(unknown, membrane.detach(), seen.before[t]), membrane)
        slope = _slope(
            replace(seen, before=membrane.detach()), equation.threshold, self._derivative
        )
        spikes = _exactly(seen.spikes[t], (membrane - equation.threshold) * slope)
        resetting = spikes if _passes(seen, self._detach_reset) else spikes.detach()
        if seen.subtracts:
            behind = membrane - equation.threshold * resetting
        else:
            behind = membrane - membrane * resetting.clamp(max=1)
        self._membrane = _exactly(seen.behind[t], behind)
        return spikes


def _passes(seen: _Seen, detach_reset: bool) -> bool:
    """Return whether gradients go through the reset of a layer."""
    return not detach_reset and (seen.subtracts or not seen.several)


def _slope(seen: _Seen, threshold: Tensor, derivative: Surrogate) -> Tensor:
    """Return the derivative of spikes by membranes before the reset, of the shape of `before`."""
    slope = derivative(seen.before - seen.threshold)
    if seen.several:  # s = floor(V / threshold): on average one more for each threshold
        slope = torch.where(seen.before > seen.threshold, 1 / threshold.detach(), slope)
    return slope


def _backpropagate(
    upstream: Tensor,
    slope: Tensor,
    seen: _Seen,
    a: Tensor | None,
    b: Tensor,
    threshold: Tensor,
    through_reset: bool,
) -> tuple[Tensor, Tensor]:
    """Return gradients of the drive (T, B, N), and of a, b, threshold and leak (4, N)."""
    rows = [
        each.contiguous().numpy()
        for each in (upstream, slope, seen.before, seen.behind, seen.current, seen.spikes)
    ]
    none = torch.zeros_like(b) if a is None else a
    constants = torch.stack([none, b, threshold]).numpy()
    to_drive = np.empty_like(rows[0])
    to_numbers = np.zeros((4, len(b)), constants.dtype)
    later = np.zeros((2, *rows[0].shape[1:]), constants.dtype)
    arrays = (*rows, constants, later, to_drive, to_numbers)
    _differentiate(seen.subtracts, through_reset, *arrays)
    return torch.from_numpy(to_drive), torch.from_numpy(to_numbers)


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
    constants: Array,
    later: Array,
    to_drive: Array,
    to_numbers: Array,
) -> None:
    """Write gradients of the drive (T, B, N), and add up those of the numbers (4, N).

    constants: (3, N) a, b and threshold
    later: (2, B, N) gradients of the current and of the membrane behind the reset, 0 at first
    """
    zero = constants[0, 0] - constants[0, 0]
    for t in range(upstream.shape[0] - 1, -1, -1):
        for n_b in range(upstream.shape[1]):
            for n in range(upstream.shape[2]):
                a, b, threshold = constants[0, n], constants[1, n], constants[2, n]
                g, v, s = slope[t, n_b, n], before[t, n_b, n], spikes[t, n_b, n]
                after = later[1, n_b, n]
                reset = after if through_reset else zero
                if subtracts:
                    to_spike = upstream[t, n_b, n] - threshold * reset
                    to_membrane = g * to_spike + after
                    to_numbers[2, n] -= g * to_spike + s * after
                else:
                    to_spike = upstream[t, n_b, n] - v * reset
                    to_membrane = g * to_spike + (after if s == zero else zero)
                    to_numbers[2, n] -= g * to_spike
                to_current = to_membrane + a * later[0, n_b, n]
                to_drive[t, n_b, n] = to_current
                to_numbers[3, n] += to_membrane
                if t:
                    to_numbers[0, n] += to_current * current[t - 1, n_b, n]
                    to_numbers[1, n] += to_membrane * behind[t - 1, n_b, n]
                later[0, n_b, n] = to_current
                later[1, n_b, n] = b * to_membrane


def _integrate(drive: Tensor, equation: Equation) -> Tensor:
    """Return membranes (T, B, N) of neurons that do not spike."""
    current, membrane = torch.zeros_like(drive[0]), torch.zeros_like(drive[0])
    found = []
    for x in drive.unbind():
        # I = a I + x ; V = b V + I + leak
        current = x if equation.current_decay is None else equation.current_decay * current + x
        membrane = equation.membrane_decay * membrane + current
        membrane = membrane if equation.leak is None else membrane + equation.leak
        found.append(membrane)
    return torch.stack(found)


def delayed(rows: Tensor, lag: int) -> Tensor:
    """Return rows (T, ...) as they arrive `lag` timesteps later, zeros first."""
    return torch.cat([torch.zeros_like(rows[:lag]), rows[: len(rows) - lag]]) if lag else rows


def _first_infinite(tensor: Tensor) -> float:
    return float(tensor.detach()[~tensor.detach().isfinite()][0])


def _sum(parts: Iterable[Tensor]) -> Tensor:
    first, *others = parts
    for each in others:
        first = first + each
    return first


def _exactly(value: Tensor, through: Tensor) -> Tensor:
    """Return the value exactly, whose gradient is that of another tensor."""
    # x - x is 0, so that no rounding is added
    return value + (through - through.detach())


def time_first(values: NDArray[Any], like: Tensor, scale: float | Array) -> Tensor:
    """Return (B, T, N), or the sum of K currents (B, T, K, N), times (N,) as (T, B, N)."""
    summed = values
    if values.ndim == 4:
        summed = values[:, :, 0] if values.shape[2] == 1 else values.sum(axis=2)
    found = torch.empty(summed.shape[1], len(summed), summed.shape[2], dtype=like.dtype)
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
def _fill_unknown(before: Array, behind: Array, arriving: Array, constants: Array) -> None:
    """Write V = b V' + I + leak where a membrane (T, B, N) before its reset is NaN.

    constants: (2, N) b and leak
    """
    for t in range(before.shape[0]):
        for b in range(before.shape[1]):
            for n in range(before.shape[2]):
                if np.isnan(before[t, b, n]):
                    v = arriving[t, b, n] + constants[1, n]
                    if t:
                        v += constants[0, n] * behind[t - 1, b, n]
                    before[t, b, n] = v


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
