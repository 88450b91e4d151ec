"""Parity: a written file is read back and compared with the policy on the same observations.

A NIR file must spike equally, in float64:

    torch policy  =  NumPy float of the file  =  its program on the chip `ideal`

A policy that was trained in the integers of a chip must instead spike as the file does on that
chip, compiled with all design rules; how far its float twin is from that is reported.

In float32, which training uses, a few membranes fall on the other side of a threshold; their number
is reported, not checked. A random encoder uses the same generator on both sides. Each observation
is an inference of its own, before which states and levels of a code are 0. An ONNX file is
compared in ONNX Runtime with the policy in torch, of a spiking policy with its float twin.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from spikedeploy.exporters import spiking_onnx
from spikedeploy.exporters.check import LargestDifference, MismatchCounter, ParityCheck, batches
from spikedeploy.exporters.spiking_onnx import OBSERVATION, OUTPUTS
from spikedeploy.exporters.to_nir import SpikingPolicy, artifact
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.rate import Xorshift
from spikedeploy.runtime.compiler.compile import compile_program as compiled
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ArtifactError, ConfigError, ObservationError
from spikedeploy.runtime.files import suffix
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.onnx_session import infer, rest, session
from spikedeploy.trainers.policies import (
    DeltaSnnPolicy,
    NetworkPolicy,
    Policy,
    PopsanPolicy,
    PrunedGruPolicy,
)
from spikedeploy.trainers.policies.delta import event_channels, live_layers
from spikedeploy.trainers.policies.spiking import CodedPolicy, TorchRateEncoder

# (B, T) -> random bytes (B, T, M), as the methods of Xorshift
RandomBytes = Callable[[int, int], NDArray[np.uint8]]


def input_spikes_of(policy: CodedPolicy, observation: Tensor, rng: RandomBytes) -> Tensor:
    """Return the input spikes (T, B, M) for the observations (B, obs)."""
    encoder = policy.encoder
    if not (isinstance(encoder, TorchRateEncoder) and encoder.mode == "bernoulli"):
        return policy.encode(observation)
    drawn = torch.from_numpy(rng(len(observation), policy.timesteps))
    # s[t] = byte[t] < n
    spikes = drawn.transpose(0, 1) < encoder.levels(policy.normalizer(observation))
    return spikes.to(observation.dtype)


_FLOAT64_TOLERANCE = 1e-9  # of an action in [-1, 1] or a score: float64 sums in different order

Spikes = dict[str, NDArray[np.integer[Any]]]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class _PolicyOutput:
    """Spikes and actions of one implementation on a batch.

    spikes: (B, T, N) of the input and of each layer
    actions: (B, act); scores where one of several is chosen
    choices: (B,) indices of what is chosen, if so
    """

    spikes: Spikes
    actions: NDArray[np.float64]
    choices: NDArray[np.int64] | None


@dataclass
class _ImplementationPair:
    """Two implementations compared: every spike, and the actions."""

    spikes: MismatchCounter = field(default_factory=MismatchCounter)
    actions: LargestDifference = field(default_factory=LargestDifference)
    choices: MismatchCounter = field(default_factory=MismatchCounter)

    def add(self, one: _PolicyOutput, other: _PolicyOutput) -> None:
        self.spikes.add(one.spikes, other.spikes)
        self.actions.add(one.actions, other.actions)
        if one.choices is not None and other.choices is not None:
            self.choices.add({"choice": one.choices}, {"choice": other.choices})

    def checks(self, name: str) -> list[ParityCheck]:
        gap = f"largest difference {self.actions.largest:.1e}, limit {_FLOAT64_TOLERANCE:.0e}"
        spikes = ParityCheck(f"spikes: {name}", not self.spikes.differing, str(self.spikes))
        within = self.actions.within(_FLOAT64_TOLERANCE)
        if not self.choices.compared:
            return [spikes, ParityCheck(f"actions: {name}", within, gap)]
        chosen = ParityCheck(f"choices: {name}", not self.choices.differing, str(self.choices))
        return [spikes, ParityCheck(f"scores: {name}", within, gap), chosen]

    def report(self, name: str) -> ParityCheck:
        """Report a difference, such as that of float32, for information only."""
        detail = f"{self.spikes}; largest difference of an action {self.actions.largest:.1e}"
        if self.choices.compared:
            detail += f"; choices: {self.choices}"
        return ParityCheck(f"for information: {name}", True, detail)


def _nir_checks(policy: Policy, path: Path, observations: NDArray[np.float64]) -> list[ParityCheck]:
    """Return the checks of the file on observations (n, obs).

    Those of a policy with states are one episode, in their order: one long inference.
    """
    if not isinstance(policy, SpikingPolicy | DeltaSnnPolicy):
        raise ConfigError(f"{path}: a policy of kind {policy.kind!r} has no spikes to compare")
    stated = load(path)
    codec = stated.codec
    if codec is None:
        raise ArtifactError(f"{path} has no codec: it was written by another tool. Export again.")
    is_chip, is_episode = isinstance(policy, NetworkPolicy), isinstance(policy, DeltaSnnPolicy)
    on = policy.target if isinstance(policy, NetworkPolicy) else chip("ideal")
    graph, program = FloatGraph(stated), compiled(stated, on)
    double, single = deepcopy(policy).double(), deepcopy(policy).float()
    compared: Sequence[tuple[str, str, str]] = _COMPARED_ON_A_CHIP if is_chip else _COMPARED
    pairs = [_ImplementationPair() for _ in compared]
    for batch in [observations] if is_episode else batches(observations):
        raster = _one_run(codec, batch) if is_episode else codec.encode(batch)
        by_torch: Any = _by_steps if is_episode else _by_torch
        seen = torch.from_numpy(batch)
        found = {
            "torch": by_torch(double, seen),
            "float32": by_torch(single, seen.float()),
            "numpy": _decode(codec, *_by_numpy(graph, raster), is_episode),
            "chip": _decode(codec, *_by_machine(program, raster), is_episode),
        }
        for pair, (one, other, _) in zip(pairs, compared, strict=True):
            pair.add(found[one], found[other])
    checks = []
    for pair, (*_, name) in zip(pairs, compared, strict=True):
        name = name.format(chip=on.name)
        checks += [pair.report(name)] if " against " in name else pair.checks(name)
    return checks


# pairs of implementations: those that equal, and those whose difference is reported
_COMPARED = (
    ("torch", "numpy", "torch = NumPy, float64"),
    ("numpy", "chip", "NumPy = compiled for `{chip}`, float64"),
    ("float32", "numpy", "torch float32 against NumPy float64"),
)
_COMPARED_ON_A_CHIP = (
    ("torch", "chip", "torch = compiled for `{chip}`, integers"),
    ("float32", "chip", "torch with a float32 encoder against `{chip}`"),
    ("numpy", "chip", "NumPy float64 of the file against `{chip}`"),
)


@torch.no_grad()
def _by_steps(policy: DeltaSnnPolicy, observations: Tensor) -> _PolicyOutput:
    """Return what a policy in torch does in the control steps (S, obs) of an episode."""
    state = policy.rest(1)
    rows = [policy.advance(observation[None], state) for observation in observations]
    mean, events, hidden = (torch.cat(column) for column in zip(*rows, strict=True))
    events, hidden = events.flatten(0, 1), hidden.flatten(0, 1)
    spikes: Spikes = {"input": event_channels(policy, events.numpy())[None]}
    for node, live in live_layers(policy).items():
        spikes[node] = hidden[:, live].numpy().astype(np.int64)[None]
    if policy.head == "continuous":
        return _PolicyOutput(spikes, _numbers(torch.tanh(mean)), None)
    return _PolicyOutput(spikes, _numbers(mean), mean.argmax(-1).numpy())


@torch.no_grad()
def _by_torch(policy: SpikingPolicy, observation: torch.Tensor) -> _PolicyOutput:
    if isinstance(policy, PopsanPolicy):
        spikes = policy.trace(observation)
        action = spikes.pop("action")
        return _PolicyOutput(_arrays(spikes), _numbers(action), None)
    input_spikes = input_spikes_of(policy, observation, Xorshift(0, policy.observations).draw)
    spikes = policy.trace(observation, input_spikes.transpose(0, 1))
    action = spikes.pop("action")
    if policy.head == "continuous":
        return _PolicyOutput(_arrays(spikes), _numbers(action), None)
    return _PolicyOutput(
        _arrays(spikes), _numbers(policy.forward_spikes(input_spikes).mean), action.numpy()
    )


def _arrays(tensors: Mapping[str, torch.Tensor]) -> Spikes:
    return {name: tensor.numpy() for name, tensor in tensors.items()}


def _numbers(tensor: torch.Tensor) -> NDArray[np.float64]:
    return tensor.double().numpy()


def _one_run(codec: Codec, observations: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the input spikes (1, S T, M) of an episode, whose states are kept to its end."""
    return codec.encode_episode(observations).reshape(1, -1, codec.encoder.width)


def _by_numpy(graph: FloatGraph, raster: NDArray[np.uint8]) -> tuple[Spikes, Numbers]:
    graph.reset()
    values = graph.run(raster)
    rows = {name: values[name].astype(np.int64) for name in graph.spiking}
    spikes = {name: each.reshape(*each.shape[:2], -1) for name, each in rows.items()}
    return {"input": raster, **spikes}, values["output"].astype(np.float64)


def _by_machine(program: Program, raster: NDArray[np.uint8]) -> tuple[Spikes, Numbers]:
    machine = Machine(program, len(raster), ledger="none", trace=True)
    output = machine.infer(raster)
    spiking = {layer.name for layer in program.layers if layer.spiking}
    spikes = {name: found.spikes for name, found in machine.recordings.items() if name in spiking}
    return {"input": raster, **spikes}, output


def _decode(codec: Codec, spikes: Spikes, numbers: Numbers, is_episode: bool) -> _PolicyOutput:
    """Return spikes and decoded actions; those of an episode, of all its control steps."""
    if is_episode:
        numbers = numbers.reshape(-1, codec.timesteps, numbers.shape[-1])
    if not codec.chooses:
        return _PolicyOutput(spikes, codec.decode(numbers), None)
    return _PolicyOutput(spikes, codec.scores(numbers).astype(np.float64), codec.decode(numbers))


# of an action in [-1, 1], or of the largest logit: float32 sums in different order
_ONNX_TOLERANCE = 1e-5
_ALONE = 100  # observations that are also passed one by one, as in a control loop

Single = NDArray[np.float32]


def _onnx_checks(
    policy: Policy, path: Path, observations: NDArray[np.float64]
) -> list[ParityCheck]:
    """Return the checks of the file on observations (n, obs)."""
    if isinstance(policy, SpikingPolicy | DeltaSnnPolicy):
        return spiking_onnx.checks(artifact(policy, Provenance("")), path, observations)
    single = deepcopy(policy).float()
    network = session(path)
    if isinstance(single, PrunedGruPolicy):
        return [_stepped_check(network, single, observations)]
    together, alone = LargestDifference(), LargestDifference()
    for batch in batches(observations):
        _compare(together, network, single, batch)
    for row in observations[:_ALONE, None]:
        _compare(alone, network, single, row)
    name = "logits" if policy.head == "discrete" else "actions"
    return [
        _check(f"{name}: torch = ONNX Runtime", together, len(observations)),
        _check(f"{name}, one at a time", alone, min(_ALONE, len(observations))),
    ]


@torch.no_grad()
def _stepped_check(
    network: Any,  # noqa: ANN401
    policy: PrunedGruPolicy,
    observations: NDArray[np.float64],
) -> ParityCheck:
    """Return the check of a policy with states on observations (S, obs), in their order."""
    apart, state, states = LargestDifference(), policy.rest(1), rest(network)
    for row in observations[:, None].astype(np.float32):
        (found,) = infer(network, [OUTPUTS[policy.head]], row, states)
        mean, _ = policy.advance(torch.from_numpy(row), state)
        expected = (torch.tanh(mean) if policy.head == "continuous" else mean).numpy()
        unit = np.maximum(1, np.abs(expected).max())
        apart.add(found / unit, expected / unit)
    name = "logits" if policy.head == "discrete" else "actions"
    return _check(f"{name}: torch = ONNX Runtime, states kept", apart, len(observations))


def _check(name: str, difference: LargestDifference, count: int) -> ParityCheck:
    largest = f"largest difference {difference.largest:.1e}, limit {_ONNX_TOLERANCE:.0e}"
    detail = f"{count:,} observations, {largest}"
    return ParityCheck(name, difference.within(_ONNX_TOLERANCE), detail)


def _compare(
    difference: LargestDifference,
    network: Any,  # noqa: ANN401
    policy: Policy,
    observation: NDArray[np.float64],
) -> None:
    seen = observation.astype(np.float32)
    found: Single = network.run([OUTPUTS[policy.head]], {OBSERVATION: seen})[0]
    expected = _output(policy, torch.from_numpy(seen))
    unit = np.maximum(1, np.abs(expected).max())
    difference.add(found / unit, expected / unit)


@torch.no_grad()
def _output(policy: Policy, observation: torch.Tensor) -> Single:
    forward = policy.scores if policy.head == "discrete" else policy
    output: Single = forward(observation).numpy()
    return output


__all__ = ["CHECKS", "ParityCheck", "check"]

Checks = Callable[[Policy, Path, NDArray[np.float64]], list[ParityCheck]]

CHECKS: dict[str, Checks] = {".nir": _nir_checks, ".onnx": _onnx_checks}


def check(policy: Policy, path: str | Path, observations: ArrayLike) -> list[ParityCheck]:
    """Return the checks of the file against the policy on observations (n, obs)."""
    path = Path(path)
    if suffix(path) not in CHECKS:
        raise ConfigError(f"{path}: parity is defined for files that end in {' or '.join(CHECKS)}")
    recorded = np.asarray(observations, dtype=np.float64)
    if recorded.ndim != 2 or recorded.shape[1] != policy.observations or not len(recorded):
        raise ObservationError(
            f"parity needs observations of shape (n, {policy.observations}), at least one; "
            f"found {recorded.shape}"
        )
    return CHECKS[suffix(path)](policy, path, recorded)
