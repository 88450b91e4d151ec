"""Spiking multilayer perceptron in the integers of a chip, whose forward pass is the chip's own.

    observation -> code -> hidden layers -> output neurons -> affine map of their rates -> action

In each forward pass the weights become a NIR graph, the compiler makes it the chip's program, and
the interpreter runs it: quantisation, saturation, resets and the order of events are what they are
on the chip. The backward pass goes through the same difference equations in float, at the
membranes and spikes that the chip had, with a surrogate for the derivative of a spike, and passes
straight through the rounding of weights (Esser et al. 2016; Wu et al. 2018).

All neurons are without bias and start each inference at 0, so that a layer that no spike has
reached yet, or that waits for the next inference, stays at 0 however often the chip updates it.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import nir
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.codec.codec import (
    Codec,
    Encoder,
    Normaliser,
    PopulationEncoder,
    RateEncoder,
)
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention, Floor, Reset, Spikes
from spikedeploy.runtime.emulator.interpreter import LayerTrace, trace
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.integrate_and_fire.neurons import IntegrateAndFireRules
from spikedeploy.runtime.families.numba_kernels import jit
from spikedeploy.runtime.families.xylo import XyloArithmetic
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies.delta import DT
from spikedeploy.trainers.policies.neurons import Surrogate, surrogate
from spikedeploy.trainers.policies.policy import Head, to_array
from spikedeploy.trainers.policies.spiking import (
    Coding,
    PopsanPolicy,
    SpikingMlpPolicy,
    TorchPopulationEncoder,
    TorchRateEncoder,
)

Integers = NDArray[np.integer[Any]]


def trace_layers(program: Program, raster: NDArray[np.uint8]) -> Mapping[str, LayerTrace]:
    """Return what layers do with the raster (B, T, M) from zero states, as the interpreter has it.

    For chains of layers without biases that look at their threshold after every event and whose
    spikes reset to 0 (ODIN, tinyODIN), loops that Numba compiles compute it with the same integers:
    the interpreter takes a hundred microseconds for each event. Where the compiled loops compute
    it, overflows and activity are left out.
    """
    return (
        _by_events(program, raster) if _COMPILED and _computes(program) else trace(program, raster)
    )


def _computes(program: Program) -> bool:
    """Return True if the loops compute the program: a chain, event by event, reset to 0."""
    rules, convention = program.chip.arithmetic, program.convention
    if not isinstance(rules, IntegrateAndFireRules) or rules.queue == "on":
        return False
    ways = rules.checks, rules.leak, rules.leak_order, rules.reset_at, rules.fires
    return (
        ways == ("event", "linear", "first", "spike", "reached")
        and convention.reset == "zero"
        and convention.floor in ("none", "zero")
        and all(layer.spiking and len(layer.synapses) == 1 for layer in program.layers)
        and not any(
            layer.bias.any() or layer.voltage_bias.any() or np.any(layer.v_reset)
            for layer in program.layers
        )
        and not any(lag for lags in program.lags for lag in lags)
    )


def _by_events(program: Program, raster: NDArray[np.uint8]) -> dict[str, LayerTrace]:
    rules = program.chip.arithmetic
    assert isinstance(rules, IntegrateAndFireRules)
    low, high = rules.membrane.fit(np.array([-(1 << 40), 1 << 40])).tolist()
    if program.convention.floor == "zero":
        low = 0
    low = low if rules.floor is None else max(low, rules.floor)
    spikes: dict[str, Integers] = {program.input: raster}
    found: dict[str, LayerTrace] = {}
    for layer in program.layers:
        (synapses,) = layer.synapses
        counts = np.ascontiguousarray(spikes[synapses.source], np.int64)
        membrane = np.zeros((*counts.shape[:2], layer.size), np.int64)
        fired = np.zeros_like(membrane)
        weight = np.ascontiguousarray(synapses.weight, np.int64)
        held = np.array([low, high, rules.spikes_max], np.int64)
        each = np.stack([layer.threshold, layer.membrane_decay]).astype(np.int64)
        _integrate_events(counts, weight, each, held, membrane, fired)
        spikes[layer.name] = fired
        none = np.zeros_like(membrane)
        found[layer.name] = LayerTrace(none, membrane, fired, none.astype(np.bool_), none)
    return found


@jit
def _integrate_events(
    counts: Integers,
    weight: Integers,
    each: Integers,
    held: Integers,
    membrane: Integers,
    spikes: Integers,
) -> None:
    """Write membranes and spikes (B, T, N) for counts of events (B, T, M).

    each: (2, N) thresholds, and what a time reference takes away
    held: least and largest membrane, most spikes of a timestep
    """
    neurons = weight.shape[1]
    for b in range(counts.shape[0]):
        for t in range(counts.shape[1]):
            v, s = membrane[b, t], spikes[b, t]
            for n in range(neurons):
                x = membrane[b, t - 1, n] if t else 0
                # V = V - sign(V) min(|V|, leak), an event as well
                taken = min(abs(x), each[1, n])
                x = x - taken if x > 0 else x + taken
                if x >= each[0, n]:
                    s[n] += 1
                    x = 0
                v[n] = x
            for m in range(counts.shape[2]):
                for _ in range(counts[b, t, m]):
                    for n in range(neurons):
                        x = min(max(v[n] + weight[m, n], held[0]), held[1])
                        if x >= each[0, n]:
                            s[n] = min(s[n] + 1, held[2])
                            x = 0
                        v[n] = x


_COMPILED = hasattr(_integrate_events, "py_func")  # without Numba, the loops stay Python


THRESHOLD = 1.0  # of every neuron; the compiler scales it with the weights

Array = NDArray[np.float64]


def _convention(target: Chip, dt: float) -> Convention:
    """Return what the chip's neurons do where they have no choice; else the threshold is taken off.

    Several spikes of a timestep are a convention only where the threshold is taken off for each.
    """
    arithmetic = target.arithmetic
    reset: Reset = "subtract" if "subtract" in target.resets else "zero"
    spikes: Spikes = "reached" if arithmetic.spikes_at_threshold else "above"
    if arithmetic.spikes_max > 1 and reset == "subtract":
        spikes = "many"
    floor: Floor = "zero" if getattr(arithmetic, "floor", None) == 0 else "none"
    return Convention(dt=dt, reset=reset, spikes=spikes, floor=floor, source="as trained")


def codec_of(policy: SpikingMlpPolicy | PopsanPolicy) -> Codec:
    """Return normaliser, encoder and decoder, as a file holds them."""
    normalizer = policy.normalizer
    return Codec(
        Normaliser(to_array(normalizer.mean), to_array(normalizer.std), normalizer.clip),
        _encoder(policy.encoder),
        policy.timesteps,
        "argmax" if policy.head == "discrete" else "tanh",
    )


def _encoder(encoder: nn.Module) -> Encoder:
    if isinstance(encoder, TorchRateEncoder):
        return RateEncoder(to_array(encoder.low), to_array(encoder.high), encoder.mode)
    if isinstance(encoder, TorchPopulationEncoder):
        return PopulationEncoder(to_array(encoder.mean), to_array(encoder.std), encoder.threshold)
    raise ConfigError(f"{type(encoder).__name__} has no form in a file; add it to {__name__}")


_OVERLAP = 0.6  # initial width of a receptive field, over the distance to the next
_FIELDS = 8  # of an observation, unless the chip has too few inputs
_LARGEST = 0.5  # weight [thresholds]
_SPREAD = 0.5  # of initial types of axons: the smaller weight over the larger one


class ChipSnnPolicy(SpikingMlpPolicy):
    """Layers of a chip's neurons, of which the last codes the actions, for the host to read.

    target: the datasheet of the chip
    layers: nn.Linear without bias into each layer, the outputs' included
    readout: nn.Linear from the rates of the output neurons [spikes / timestep] to `Latent.mean`
    limit: largest magnitude of a weight [thresholds]; beyond it weights are clipped
    alpha, beta: decay factors of current and membrane in a timestep; 0 is no current, 1 no leak
    types: of axons, each with one weight of each neuron; 0 where every synapse has its own
    """

    kind = "chip-snn"

    def __init__(
        self,
        observations: int,
        actions: int,
        chip: str,
        hidden: Sequence[int] = (32,),
        outputs: int = 8,
        coding: Coding = "population",
        populations: int | None = None,
        reach: float = 2.0,
        timesteps: int = 8,
        alpha: float | None = None,
        beta: float | None = None,
        limit: float | None = None,
        surrogate: str = "atan",
        surrogate_width: float | None = None,
        clip: float = 4.0,
        head: Head = "continuous",
    ) -> None:
        target = _datasheet(chip)
        # where the chip leaves no choice, neurons without a current or without a leak
        leaks = target.limits is None or target.limits.membrane_loss != (0.0, 0.0)
        has_current = isinstance(target.arithmetic, XyloArithmetic)
        current_decay = (0.5 if alpha is None else alpha) if has_current else 0.0
        membrane_decay = (0.9375 if beta is None else beta) if leaks else 1.0
        if coding == "population":
            populations = _populations(target, observations, populations)
        super().__init__(
            observations,
            actions,
            hidden=(*hidden, outputs),
            coding=coding,
            populations=populations or 1,
            timesteps=timesteps,
            beta=membrane_decay,
            threshold=THRESHOLD,
            surrogate=surrogate,
            surrogate_width=surrogate_width,
            clip=clip,
            head=head,
            reach=reach,
        )
        self.target, self.alpha = target, current_decay
        if limit is None:  # at most 0.5, with which the threshold is a whole number:
            # 7/16 of 3 bits, 15/32 of 5 bits with the sign, 127/256 of 8
            most = getattr(target.arithmetic, "weight_range", (0, 1))[1]
            limit = float(most / 2.0 ** math.ceil(math.log2(most / _LARGEST)))
        self.limit = limit
        if isinstance(self.encoder, TorchPopulationEncoder):
            # few fields: wide enough that no number between two of them is unseen
            spacing = 2 * reach / max(self.populations - 1, 1)
            nn.init.constant_(self.encoder.log_std, math.log(_OVERLAP * spacing))
        self.chip, self.outputs = chip, outputs
        self._wanted = {"alpha": alpha, "beta": beta}  # None where the chip's own are taken
        arithmetic = target.arithmetic
        self.types = 0 if arithmetic.own_weights else int(getattr(arithmetic, "axon_types", 0))
        self.signed_axons = bool(target.limits and target.limits.axon_signs)
        self._draw_weights(limit)
        self._compiled: tuple[bytes, Program] | None = None

    def _draw_weights(self, limit: float) -> None:
        """Replace the layers by ones without a bias, with the signs and types of their axons."""
        self.layers = nn.ModuleList(
            nn.Linear(layer.in_features, layer.out_features, bias=False)
            for layer in self.layers
            if isinstance(layer, nn.Linear)
        )
        for layer in self.layers:
            weight = layer.get_parameter("weight")
            nn.init.uniform_(weight, -limit, limit)
            if self.signed_axons:
                with torch.no_grad():
                    weight.abs_().mul_(_axon_signs(weight))
        self.type_weights = nn.ParameterList(
            nn.Parameter(_type_weights(layer.out_features, self.types, limit))
            for layer in self.layers
            if isinstance(layer, nn.Linear) and self.types
        )

    def weights(self) -> list[Tensor]:
        """Return the weights (N, M) of each layer as they are deployed, before rounding.

        Gradients pass straight through what makes them fit the chip.
        """
        return [self._fitting(number) for number in range(len(self.layers))]

    def _fitting(self, number: int) -> Tensor:
        latent = self.layers[number].get_parameter("weight")
        if self.types:
            # W[n, m] = g[n, type of m] where the latent weight is above 0: a connected crosspoint
            number_of_axon = torch.arange(latent.shape[1])
            # the first of each type reaches all neurons, so that whoever puts axons together again
            # by their weights, as design rules do, finds these types and no others
            present = (latent > 0) | (number_of_axon < self.types)
            connected = _passing(present.to(latent.dtype), latent)
            of_type = number_of_axon % self.types
            weight = self.type_weights[number]
            clipped = _passing(weight.clamp(-self.limit, self.limit), weight)
            crossbar: Tensor = connected * clipped[:, of_type]
            return crossbar
        fitting = latent.detach().clamp(-self.limit, self.limit)
        if self.signed_axons:
            sign = _axon_signs(latent)
            fitting = sign * (sign * fitting).relu()
        return _passing(fitting, latent)

    def artifact(self, origin: Provenance | None = None, dt: float = DT) -> Artifact:
        """Return the policy as an artifact, every number in float64."""
        weights = [to_array(weight) for weight in self.weights()]
        width = np.array([weights[0].shape[1]])
        nodes: dict[str, nir.NIRNode] = {"input": nir.Input({"input": width})}
        for number, weight in enumerate(weights, start=1):
            nodes[f"fc{number}"] = nir.Linear(weight)
            nodes[f"lif{number}"] = self._neurons(len(weight), dt)
        nodes["readout"] = nir.Affine(to_array(self.readout.weight), to_array(self.readout.bias))
        nodes["output"] = nir.Output({"output": np.array([self.actions])})
        graph = nir.NIRGraph(nodes, list(pairwise(nodes)))
        return Artifact(graph, codec_of(self), _convention(self.target, dt), origin)

    def _neurons(self, size: int, dt: float) -> nir.IF | nir.LIF | nir.CubaLIF:
        """Return neurons of the chip, with a threshold of THRESHOLD and gains of 1."""
        zeros, threshold = np.zeros(size), np.full(size, THRESHOLD)
        if self.beta == 1:
            return nir.IF(r=np.full(size, 1 / dt), v_threshold=threshold, v_reset=zeros)
        # tau = dt / (1 - decay) ; r = tau_mem / dt ; w_in = tau_syn / dt
        per_step = 1 / (1 - self.beta)
        tau, gain = np.full(size, dt * per_step), np.full(size, per_step)
        rest = {"v_leak": zeros, "v_reset": zeros, "v_threshold": threshold}
        if not self.alpha:
            return nir.LIF(tau=tau, r=gain, **rest)
        synaptic = 1 / (1 - self.alpha)
        tau_syn, w_in = np.full(size, dt * synaptic), np.full(size, synaptic)
        return nir.CubaLIF(tau_syn=tau_syn, w_in=w_in, tau_mem=tau, r=gain, **rest)

    def program(self) -> Program:
        """Return the chip's program of the present weights."""
        # fused optimisers do not count versions of tensors, so their numbers are compared
        parameters = [*self.layers.parameters(), *self.type_weights.parameters()]  # of the chip
        held = b"".join(p.detach().numpy().tobytes() for p in parameters)
        if self._compiled is None or self._compiled[0] != held:
            program = compile_program(self.artifact(), self.target, clock="gated", limits=False)
            self._compiled = held, program
        return self._compiled[1]

    def spikes(self, raster: Tensor) -> list[Tensor]:
        """Return the spikes (T, B, N) of every layer for input spikes (T, B, M)."""
        if torch.is_grad_enabled() and self.signed_axons:
            # weights that an update gave another sign than their source's go back to 0: further
            # away they would be 0 for many updates more
            with torch.no_grad():
                for number, latent in enumerate(self.layers):
                    latent.get_parameter("weight").copy_(self._fitting(number))
        program = self.program()
        arrived = np.ascontiguousarray(raster.detach().numpy().swapaxes(0, 1)).astype(np.uint8)
        traces = trace_layers(program, arrived)
        if not torch.is_grad_enabled():
            return [_tensor(traces[layer.name].spikes, raster) for layer in program.layers]
        derivative = surrogate(self.surrogate, self.surrogate_width)
        found, presynaptic = [], raster
        for layer, lags, weight in zip(program.layers, program.lags, self.weights(), strict=True):
            drive = _late(presynaptic, lags[0]) @ weight.T
            done = traces[layer.name]
            spikes = _tensor(done.spikes, raster)
            membrane = self._before_reset(layer, done, drive.detach())
            subtracts = program.convention.reset == "subtract"
            constants = self.alpha, self.beta, self._several(layer), subtracts
            presynaptic = _SpikesOfChip.apply(drive, membrane, spikes, constants, derivative)  # type: ignore[no-untyped-call]
            found.append(presynaptic)
        return found

    def _several(self, layer: Layer) -> bool:
        """Return whether a neuron of the layer may spike several times in a timestep."""
        arithmetic = self.target.arithmetic
        last = layer.name == self.program().output
        most = getattr(arithmetic, "output_spikes_max", 1) if last else arithmetic.spikes_max
        is_xylo = isinstance(arithmetic, XyloArithmetic)
        return (most if is_xylo else arithmetic.spikes_max) > 1

    def _before_reset(self, layer: Layer, recorded: LayerTrace, drive: Tensor) -> Tensor:
        """Return the membranes (T, B, N) at which the chip's neurons spiked [thresholds].

        Where the chip does not tell, they are what arrived on top of the membrane before.
        """
        program = self.program()
        units = self.target.arithmetic.before_reset(
            layer, program.convention, recorded.current, recorded.membrane, recorded.spikes
        )
        before = _tensor(units * layer.scale, drive)
        if bool(before.isnan().any()):
            after = _tensor(recorded.membrane * layer.scale, drive)
            told = self.beta * _late(after, 1) + drive
            before = torch.where(before.isnan(), told, before)
        return before

    def spec(self) -> dict[str, Any]:
        """Return the arguments from which `build` makes an equal policy, for JSON."""
        return {**super().spec(), **self._wanted, "hidden": list(self.hidden[:-1])}

    def __deepcopy__(self, memo: dict[int, Any]) -> "ChipSnnPolicy":
        """Return a copy with the same weights; it compiles its own program."""
        settings = self.spec()
        del settings["kind"]
        copy = ChipSnnPolicy(**settings)
        copy.load_state_dict(self.state_dict())
        copy.to(self.readout.weight.dtype)
        memo[id(self)] = copy
        return copy


class _SpikesOfChip(torch.autograd.Function):
    """The spikes of a layer, and the gradient of the difference equations at what was recorded."""

    @staticmethod
    def forward(
        ctx: Any,  # noqa: ANN401
        drive: Tensor,
        membrane: Tensor,
        spikes: Tensor,
        constants: tuple[float, float, bool, bool],
        derivative: Surrogate,
    ) -> Tensor:
        ctx.save_for_backward(membrane, spikes)
        ctx.constants = constants, derivative
        return spikes

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        membrane, spikes = ctx.saved_tensors
        (alpha, beta, several, subtracts), derivative = ctx.constants
        slope = derivative(membrane - THRESHOLD)
        if several:  # spikes = floor(V / threshold): on average one more for each threshold
            slope = torch.where(membrane > THRESHOLD, torch.ones_like(slope), slope)
        # dV'/dV = 1 where the threshold is taken off, 0 where a spike sets it to 0
        passed = torch.ones_like(spikes) if subtracts else (spikes == 0).to(spikes.dtype)
        result = slope * upstream
        to_current = torch.zeros_like(result[0])
        to_membrane = torch.zeros_like(result[0])
        for g, share in zip(reversed(result.unbind()), reversed(passed.unbind()), strict=True):
            # V = beta V' + I ; I = alpha I + x
            g.add_(to_membrane * share)
            to_membrane = g * beta
            if alpha:
                g.add_(to_current, alpha=alpha)
                to_current = g.clone()
        return result, None, None, None, None


def _datasheet(name: str) -> Chip:
    if not name:
        raise ConfigError(
            "a policy of kind 'chip-snn' is trained for one chip: name it, as in --for xylo-a2"
        )
    found = chip(name)
    if found.clock == "pipelined":
        raise ConfigError(
            f"{name}: a policy of kind 'chip-snn' starts from 0 in each inference, in which a "
            "pipeline would lose the first timesteps of every layer. Leave the clock out, or "
            "choose free or gated."
        )
    return found


def _populations(target: Chip, observations: int, wanted: int | None) -> int:
    """Return the neurons of the population code for each observation.

    wanted: None for as many as the inputs of the chip allow, at most 8; an even number where
        axons have signs, so that each observation has axons of both
    """
    inputs = target.limits.inputs if target.limits else None
    most = _FIELDS if inputs is None else min(_FIELDS, inputs // observations)
    if target.limits and target.limits.axon_signs:
        most -= most % 2
    if most < 2 and wanted is None:
        raise ConfigError(
            f"{target.name} has {inputs} inputs, too few for two neurons of a population code for "
            f"each of {observations} observations. Choose --set policy.coding=regular, or another "
            "chip."
        )
    return wanted or most


def _passing(value: Tensor, gradient_to: Tensor) -> Tensor:
    """Return the value exactly; its gradient passes straight on to another tensor."""
    # x - x is 0, so that no rounding is added
    return value.detach() + (gradient_to - gradient_to.detach())


def _axon_signs(weight: Tensor) -> Tensor:
    """Return 1 or -1 for each source (M,): they excite and inhibit by turns."""
    return 1.0 - 2.0 * (torch.arange(weight.shape[1]) % 2)


def _type_weights(neurons: int, types: int, limit: float) -> Tensor:
    """Return initial weights (N, types): excitatory, inhibitory, and both again but smaller."""
    if not types:
        return torch.zeros(neurons, 0)
    sign = 1.0 - 2.0 * (torch.arange(types) % 2)
    size = limit * _SPREAD ** torch.div(torch.arange(types), 2, rounding_mode="floor")
    return (sign * size).repeat(neurons, 1) * torch.empty(neurons, types).uniform_(0.8, 1.0)


def _late(rows: Tensor, lag: int) -> Tensor:
    """Return rows (T, B, N) as they arrive `lag` timesteps later, zeros first."""
    if not lag:
        return rows
    return torch.cat([torch.zeros_like(rows[:lag]), rows[:-lag]])


def _tensor(values: NDArray[Any], like: Tensor) -> Tensor:
    """Return (B, T, N) as a tensor (T, B, N) of the other's type."""
    return torch.from_numpy(np.ascontiguousarray(values.swapaxes(0, 1))).to(like.dtype)
