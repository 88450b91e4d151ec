"""Parity: a written file is read back and compared with the policy on the same observations.

A NIR file must spike equally, in float64:

    torch policy  =  NumPy float of the file  =  its program on the chip `ideal`

A policy that was trained in the integers of a chip must instead spike as the file does on that
chip, compiled with all design rules; how far its float twin is from that is reported.

In float32, which training uses, a few membranes fall on the other side of a threshold; their number
is reported, not checked. A random encoder uses the same generator on both sides. Each observation
is an inference of its own, before which states and levels of a code are 0; those of a policy that
keeps its states are one episode. An ONNX file is compared in ONNX Runtime with the policy in torch,
of a spiking policy with its float twin.
"""

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from spikedeploy.exporters import spiking_onnx
from spikedeploy.exporters.check import (
    ParityCheck,
    compare_floats,
    compare_integers,
    largest_difference,
)
from spikedeploy.exporters.onnx_graph import OBSERVATION, OUTPUTS
from spikedeploy.exporters.to_nir import SpikingPolicy, artifact
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.rate import Xorshift
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ArtifactError, ConfigError, ObservationError
from spikedeploy.runtime.files import suffix
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.onnx_session import infer, initial_states, session
from spikedeploy.trainers.policies import (
    DeltaSnnPolicy,
    NetworkPolicy,
    Policy,
    PopsanPolicy,
)
from spikedeploy.trainers.policies.delta_policy import HIDDEN_NODE, event_channels, live_neurons
from spikedeploy.trainers.policies.spiking import CodedPolicy, TorchRateEncoder

# (B, T) -> random bytes (B, T, M), as the methods of Xorshift
RandomBytes = Callable[[int, int], NDArray[np.uint8]]
Numbers = NDArray[np.float64]
Spikes = dict[str, NDArray[np.integer[Any]]]

# of an action in [-1, 1] or a score: sums in different order, of float64 and of float32
_FLOAT64_TOLERANCE, _FLOAT32_TOLERANCE = 1e-9, 1e-5
_ALONE = 100  # observations that are also passed one by one, as in a control loop


def check(policy: Policy, path: str | Path, observations: ArrayLike) -> list[ParityCheck]:
    """Return the checks of the file against the policy on observations (n, obs)."""
    path = Path(path)
    if suffix(path) not in (".nir", ".onnx"):
        raise ConfigError(f"{path}: parity is defined for files that end in .nir or .onnx")
    recorded = np.asarray(observations, dtype=np.float64)
    if recorded.ndim != 2 or recorded.shape[1] != policy.observations or not len(recorded):
        raise ObservationError(
            f"parity needs observations of shape (n, {policy.observations}), at least one; "
            f"found {recorded.shape}"
        )
    spikes = isinstance(policy, SpikingPolicy | DeltaSnnPolicy)
    if suffix(path) == ".nir":
        if not spikes:
            raise ConfigError(f"{path}: a policy of kind {policy.kind!r} has no spikes to compare")
        return _nir_checks(policy, path, recorded)
    if spikes:
        return spiking_onnx.checks(artifact(policy, Provenance("")), path, recorded)
    return _onnx_checks(deepcopy(policy).float(), path, recorded)


@dataclass(frozen=True)
class _Behaviour:
    """Spikes and actions of one implementation.

    spikes: (B, T, N) of the input and of each layer.
    actions: (B, act); scores where one of several is chosen.
    choices: (B,) indices of what is chosen, if so.
    """

    spikes: Spikes
    actions: Numbers
    choices: NDArray[np.int64] | None = None

    def checks(self, name: str, other: "_Behaviour") -> list[ParityCheck]:
        """Compare every spike, and the actions."""
        what = "actions" if self.choices is None else "scores"
        found = [
            compare_integers(f"spikes: {name}", self.spikes, other.spikes),
            compare_floats(f"{what}: {name}", self.actions, other.actions, _FLOAT64_TOLERANCE),
        ]
        return found + self._choices(f"choices: {name}", other)

    def _choices(self, name: str, other: "_Behaviour") -> list[ParityCheck]:
        if self.choices is None or other.choices is None:
            return []
        return [compare_integers(name, {"": self.choices}, {"": other.choices})]

    def report(self, name: str, other: "_Behaviour") -> ParityCheck:
        """Report a difference, such as that of float32, for information only."""
        spikes = compare_integers(name, self.spikes, other.spikes)
        apart = largest_difference(self.actions, other.actions)
        detail = f"{spikes.detail}; largest difference of an action {apart:.1e}"
        for each in self._choices("", other):
            detail += f"; choices: {each.detail}"
        return ParityCheck(f"for information: {name}", True, detail)


def _nir_checks(policy: Any, path: Path, observations: Numbers) -> list[ParityCheck]:  # noqa: ANN401
    stated = load(path)
    codec = stated.codec
    if codec is None:
        raise ArtifactError(f"{path} has no codec: it was written by another tool. Export again.")
    is_episode, seen = isinstance(policy, DeltaSnnPolicy), torch.from_numpy(observations)
    by_torch: Callable[..., _Behaviour] = _by_steps if is_episode else _by_torch
    raster = codec.encode_episode(observations) if is_episode else codec.encode(observations)
    if is_episode:  # one long inference (1, S T, M)
        raster = raster.reshape(1, -1, codec.encoder.width)
    on = policy.target if isinstance(policy, NetworkPolicy) else chip("ideal")
    double = by_torch(deepcopy(policy).double(), seen)
    single = by_torch(deepcopy(policy).float(), seen.float())
    twin = _decode(codec, *_by_numpy(FloatGraph(stated), raster), is_episode)
    compiled = _decode(codec, *_by_machine(compile_program(stated, on), raster), is_episode)
    if isinstance(policy, NetworkPolicy):
        return [
            *double.checks(f"torch = compiled for `{on.name}`, integers", compiled),
            single.report(f"torch with a float32 encoder against `{on.name}`", compiled),
            twin.report(f"NumPy float64 of the file against `{on.name}`", compiled),
        ]
    return [
        *double.checks("torch = NumPy, float64", twin),
        *twin.checks(f"NumPy = compiled for `{on.name}`, float64", compiled),
        single.report("torch float32 against NumPy float64", twin),
    ]


@torch.no_grad()
def _by_steps(policy: DeltaSnnPolicy, observations: Tensor) -> _Behaviour:
    """Return the behaviour of a policy in torch in the control steps (S, obs) of an episode."""
    state = policy.initial_states(1)
    rows = [policy.advance(observation[None], state) for observation in observations]
    mean, events, hidden = (torch.cat(column) for column in zip(*rows, strict=True))
    events, hidden = events.flatten(0, 1), hidden.flatten(0, 1)
    spikes: Spikes = {"input": event_channels(policy, events.numpy())[None]}
    if (live := live_neurons(policy)).any():
        spikes[HIDDEN_NODE] = hidden[:, live].numpy().astype(np.int64)[None]
    if policy.head == "continuous":
        return _Behaviour(spikes, _numbers(torch.tanh(mean)))
    return _Behaviour(spikes, _numbers(mean), mean.argmax(-1).numpy())


@torch.no_grad()
def _by_torch(policy: SpikingPolicy, observation: Tensor) -> _Behaviour:
    if isinstance(policy, PopsanPolicy):
        spikes = policy.trace(observation)
        action = spikes.pop("action")
        return _Behaviour(_arrays(spikes), _numbers(action))
    input_spikes = input_spikes_of(policy, observation, Xorshift(0, policy.observations).draw)
    spikes = policy.trace(observation, input_spikes.transpose(0, 1))
    action = spikes.pop("action")
    if policy.head == "continuous":
        return _Behaviour(_arrays(spikes), _numbers(action))
    scores = policy.forward_spikes(input_spikes).mean
    return _Behaviour(_arrays(spikes), _numbers(scores), action.numpy())


def input_spikes_of(policy: CodedPolicy, observation: Tensor, rng: RandomBytes) -> Tensor:
    """Return the input spikes (T, B, M) for the observations (B, obs)."""
    encoder = policy.encoder
    if not (isinstance(encoder, TorchRateEncoder) and encoder.mode == "bernoulli"):
        return policy.encode(observation)
    drawn = torch.from_numpy(rng(len(observation), policy.timesteps))
    # s[t] = byte[t] < n
    spikes = drawn.transpose(0, 1) < encoder.levels(policy.normalizer(observation))
    return spikes.to(observation.dtype)


def _arrays(tensors: Mapping[str, Tensor]) -> Spikes:
    return {name: tensor.numpy() for name, tensor in tensors.items()}


def _numbers(tensor: Tensor) -> Numbers:
    return tensor.double().numpy()


def _by_numpy(graph: FloatGraph, raster: NDArray[np.uint8]) -> tuple[Spikes, Numbers]:
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


def _decode(codec: Codec, spikes: Spikes, numbers: Numbers, is_episode: bool) -> _Behaviour:
    """Return spikes and decoded actions; those of an episode, of all its control steps."""
    if is_episode:
        numbers = numbers.reshape(-1, codec.timesteps, numbers.shape[-1])
    if not codec.chooses:
        return _Behaviour(spikes, codec.decode(numbers))
    return _Behaviour(spikes, codec.scores(numbers).astype(np.float64), codec.decode(numbers))


@torch.no_grad()
def _onnx_checks(policy: Policy, path: Path, observations: Numbers) -> list[ParityCheck]:
    """Return the checks of a float policy: all rows at once, and one by one with its states."""
    output, name = OUTPUTS[policy.head], "logits" if policy.head == "discrete" else "actions"
    network, rows = session(path), observations.astype(np.float32)

    def compare(what: str, found: NDArray[Any], expected: NDArray[Any]) -> ParityCheck:
        unit = np.maximum(1, np.abs(expected).max(axis=1, keepdims=True))
        named = f"{name}: {what}"
        return compare_floats(named, found / unit, expected / unit, _FLOAT32_TOLERANCE)

    states = initial_states(network)
    forward = policy.scores if policy.head == "discrete" else policy
    wanted = forward(torch.from_numpy(rows)).numpy()
    together = network.run([output], {OBSERVATION: rows})[0]
    alone = [infer(network, [output], row, states)[0] for row in rows[:_ALONE, None]]
    return [
        compare("torch = ONNX Runtime", together, wanted),
        compare("one at a time", np.concatenate(alone), wanted[:_ALONE]),
    ]
