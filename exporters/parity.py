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

from collections.abc import Callable, Mapping
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
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.rate import Xorshift
from spikedeploy.runtime.compiler.compile import compile_program as compiled
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ArtifactError, ConfigError, ObservationError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.onnx_session import session
from spikedeploy.trainers.policies import (
    ChipSnnPolicy,
    DeltaSnnPolicy,
    Policy,
    PopsanPolicy,
    SpikingMlpPolicy,
)
from spikedeploy.trainers.policies.delta import event_channels, hidden_node, live_neurons
from spikedeploy.trainers.policies.spiking import TorchRateEncoder

# (B, T) -> random bytes (B, T, M), as the methods of Xorshift
RandomBytes = Callable[[int, int], NDArray[np.uint8]]


def input_spikes_of(policy: SpikingMlpPolicy, observation: Tensor, rng: RandomBytes) -> Tensor:
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


def _nir_checks(policy: Policy, path: Path, observations: NDArray[np.float64]) -> list[ParityCheck]:
    """Return the checks of the file on observations (n, obs)."""
    if isinstance(policy, ChipSnnPolicy):
        return _chip_checks(policy, path, observations)
    if isinstance(policy, DeltaSnnPolicy):
        return _episode_checks(policy, path, observations)
    if not isinstance(policy, SpikingPolicy):
        raise ConfigError(f"{path}: a policy of kind {policy.kind!r} has no spikes to compare")
    stated = load(path)
    codec = _codec(stated, path)
    graph, program = FloatGraph(stated), compiled(stated, chip("ideal"))
    double, single = deepcopy(policy).double(), deepcopy(policy).float()
    to_numpy, to_ideal, to_single = (_ImplementationPair() for _ in range(3))
    for batch in batches(observations):
        raster = codec.encode(batch)
        by_numpy = _decode(codec, _by_numpy(graph, raster))
        to_numpy.add(_by_torch(double, torch.from_numpy(batch)), by_numpy)
        to_ideal.add(by_numpy, _decode(codec, _by_machine(program, raster)))
        to_single.add(_by_torch(single, torch.from_numpy(batch).float()), by_numpy)
    return [
        *to_numpy.checks("torch = NumPy, float64"),
        *to_ideal.checks("NumPy = compiled for `ideal`, float64"),
        _report(to_single),
    ]


def _chip_checks(
    policy: ChipSnnPolicy, path: Path, observations: NDArray[np.float64]
) -> list[ParityCheck]:
    """Return the checks of a policy in the integers of a chip, on observations (n, obs)."""
    stated = load(path)
    codec = _codec(stated, path)
    graph, program = FloatGraph(stated), compiled(stated, policy.target)
    double, single = deepcopy(policy).double(), deepcopy(policy).float()
    to_chip, to_single, to_float = (_ImplementationPair() for _ in range(3))
    for batch in batches(observations):
        raster = codec.encode(batch)
        by_machine = _decode(codec, _by_machine(program, raster))
        to_chip.add(_by_torch(double, torch.from_numpy(batch)), by_machine)
        to_single.add(_by_torch(single, torch.from_numpy(batch).float()), by_machine)
        to_float.add(_decode(codec, _by_numpy(graph, raster)), by_machine)
    chip_name = policy.target.name
    return [
        *to_chip.checks(f"torch = compiled for `{chip_name}`, integers"),
        _report(to_single, f"torch with a float32 encoder against `{chip_name}`"),
        _report(to_float, f"NumPy float64 of the file against `{chip_name}`"),
    ]


def _episode_checks(
    policy: DeltaSnnPolicy, path: Path, observations: NDArray[np.float64]
) -> list[ParityCheck]:
    """Return the same checks of a policy with states, on observations (S, obs) in their order.

    One timestep per control step, so that the episode is one long inference.
    """
    stated = load(path)
    codec = _codec(stated, path)
    raster = codec.encode_episode(observations).swapaxes(0, 1)
    by_numpy = _episode(codec, _by_numpy(FloatGraph(stated), raster))
    by_ideal = _episode(codec, _by_machine(compiled(stated, chip("ideal")), raster))
    pairs = _ImplementationPair(), _ImplementationPair(), _ImplementationPair()
    pairs[0].add(_by_steps(deepcopy(policy).double(), observations), by_numpy)
    pairs[1].add(by_numpy, by_ideal)
    pairs[2].add(_by_steps(deepcopy(policy).float(), observations), by_numpy)
    return [
        *pairs[0].checks("torch = NumPy, float64"),
        *pairs[1].checks("NumPy = compiled for `ideal`, float64"),
        _report(pairs[2]),
    ]


@torch.no_grad()
def _by_steps(policy: DeltaSnnPolicy, observations: NDArray[np.float64]) -> _PolicyOutput:
    """Return what a policy in torch does in the control steps of an episode."""
    state = policy.rest(1)
    seen = torch.from_numpy(observations).to(policy.action_bias.dtype)
    rows = [policy.advance(observation[None], state) for observation in seen]
    mean, events, hidden = (torch.cat(column) for column in zip(*rows, strict=True))
    live = live_neurons(policy)
    spikes: Spikes = {"input": event_channels(policy, events.numpy())[None]}
    if bool(live.any()):
        spikes[hidden_node(policy)] = hidden[:, live].numpy().astype(np.int64)[None]
    if policy.head == "continuous":
        return _PolicyOutput(spikes, _numbers(torch.tanh(mean)), None)
    return _PolicyOutput(spikes, _numbers(mean), mean.argmax(-1).numpy())


def _report(
    pair: _ImplementationPair, name: str = "torch float32 against NumPy float64"
) -> ParityCheck:
    """Report a difference, as that of float32, for information only."""
    detail = f"{pair.spikes}; largest difference of an action {pair.actions.largest:.1e}"
    if pair.choices.compared:
        detail += f"; choices: {pair.choices}"
    return ParityCheck(f"for information: {name}", True, detail)


def _codec(stated: Artifact, path: Path) -> Codec:
    if stated.codec is None:
        raise ArtifactError(f"{path} has no codec: it was written by another tool. Export again.")
    return stated.codec


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


def _by_numpy(graph: FloatGraph, raster: NDArray[np.uint8]) -> tuple[Spikes, Numbers]:
    graph.reset()
    values = graph.run(raster)
    spikes = {name: values[name].astype(np.int64) for name in graph.spiking}
    return {"input": raster, **spikes}, values["output"].astype(np.float64)


def _by_machine(program: Program, raster: NDArray[np.uint8]) -> tuple[Spikes, Numbers]:
    machine = Machine(program, len(raster), ledger="none", trace=True)
    output = machine.infer(raster)
    spiking = {layer.name for layer in program.layers if layer.spiking}
    spikes = {name: found.spikes for name, found in machine.recordings.items() if name in spiking}
    return {"input": raster, **spikes}, output


def _episode(codec: Codec, found: tuple[Spikes, Numbers]) -> _PolicyOutput:
    """Return the output (1, S, act) of an episode with one timestep per control step, decoded."""
    return _decode(codec, (found[0], found[1].swapaxes(0, 1)))


def _decode(codec: Codec, found: tuple[Spikes, Numbers]) -> _PolicyOutput:
    spikes, numbers = found
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
    if path.suffix not in CHECKS:
        raise ConfigError(f"{path}: parity is defined for files that end in {' or '.join(CHECKS)}")
    recorded = np.asarray(observations, dtype=np.float64)
    if recorded.ndim != 2 or recorded.shape[1] != policy.observations or not len(recorded):
        raise ObservationError(
            f"parity needs observations of shape (n, {policy.observations}), at least one; "
            f"found {recorded.shape}"
        )
    return CHECKS[path.suffix](policy, path, recorded)
