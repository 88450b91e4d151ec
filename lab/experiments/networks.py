"""A policy at a place — a chip, few bits, in float — for a batch of robots, with what it did.

Episodes of evaluations run as one batch, so that a spiking policy on a chip costs little more than
a float one; seeds are those that no training and no choice of a policy has seen.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import gymnasium
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from spikedeploy import envs
from spikedeploy.comparison.evaluation import compare_policies
from spikedeploy.comparison.lineup import make_entries
from spikedeploy.comparison.statistics import Estimate, nested_ratio
from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.policies import run_record
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.policies.registry import find
from spikedeploy.policies.run_record import SPIKING
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.export_run import kind_of
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.distill.teacher import Teacher
from spikedeploy.trainers.policies import Policy, PrunedGruPolicy, PrunedMlpPolicy
from spikedeploy.trainers.policies.policy import PrunedWeight, in_bits
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse import pool
from spikedeploy.trainers.sparse.controllers import FloatController
from spikedeploy.trainers.sparse.pool import BatchController, Episodes, Stateless, Walk

FLOAT = "float"  # the place of a float network that computes as it was trained
DELTA = "delta "  # followed by the threshold of the delta network as which one runs
Counts = dict[str, float | None]
P = TypeVar("P", bound=Policy)


@dataclass(frozen=True)
class PlacedNetwork:
    """A policy, ready to play.

    controller  of B robots
    counts      means per control step of what it did in episodes, given their walks; the
                controller must have walked them, and no others, in one batch
    """

    controller: BatchController
    counts: Callable[[Sequence[Walk]], Counts]


def network(run: Path, level: str, place: str, stem: Path) -> PlacedNetwork:
    """The policy of a checkpoint at a place: a chip, FLOAT, `int8`, or `float32` if pruned.

    Integers have a scale per tensor, or in `int8-rows` per channel: each row of a matrix. A pruned
    policy without memory may run as a delta network, `delta 0.1` with that threshold.

    level  name of the checkpoint
    stem   of the exported file, without a suffix

    Raises RuleError where the chip refuses it.
    """
    policy = RunFolder(run).policy(level)
    if place == FLOAT:
        return PlacedNetwork(FloatController(policy), lambda walks: _dense_counts(policy, walks))
    origin = run_record.origin(run, level)
    stem.parent.mkdir(parents=True, exist_ok=True)
    if policy.kind in SPIKING:
        return _on_chip(policy, origin, stem.with_name(f"{stem.name}.nir"), place)
    if isinstance(policy, PrunedMlpPolicy) and place.startswith(DELTA):
        running = DeltaNetwork(policy, float(place.removeprefix(DELTA)))
        return PlacedNetwork(running, running.counts)
    if isinstance(policy, PrunedMlpPolicy):
        return _pruned(_rounded(policy, place), origin, stem.with_name(f"{stem.name}-{place}.onnx"))
    if isinstance(policy, PrunedGruPolicy):
        return _with_memory(_rounded(policy, place))
    raise TypeError(f"{type(policy).__name__} is no policy that is pruned")


def _rounded(policy: P, place: str) -> P:
    """The policy with weights of as many bits as its place has."""
    if place == "float32":
        return policy
    bits, _, rows = place.removeprefix("int").partition("-")
    return in_bits(policy, int(bits), by_row=rows == "rows")


def _with_memory(policy: PrunedGruPolicy) -> PlacedNetwork:
    @torch.no_grad()
    def counts(walks: Sequence[Walk]) -> Counts:
        macs, steps = 0.0, 0
        for walk in walks:
            seen = torch.from_numpy(walk.observation)[None]
            inputs = policy.unrolled(seen.float(), *policy.rest(1)).inputs
            pairs = zip(inputs, policy.groups, strict=True)
            macs += sum(float(((x != 0).float() @ m.fan_out).sum()) for x, m in pairs)
            steps += len(walk.observation)
        first = policy.groups[0].fan_out
        read = first + policy.past.fan_out if policy.skip else first
        return {
            "operations": macs / steps,
            "observations": float(torch.count_nonzero(read)),
            # a bias of each unit, and six of one of the memory
            "constants": float(sum(policy.hidden) + 6 * policy.gru + policy.actions),
        }

    return PlacedNetwork(FloatController(policy), counts)


def _on_chip(policy: Policy, origin: Provenance, path: Path, place: str) -> PlacedNetwork:
    artifact = load(to_nir(policy, origin, path))
    spiking = SpikingController(artifact, chip(place), ledger="each")
    encoder = artifact.codec.encoder if artifact.codec else None
    used = int(np.isfinite(encoder.step).sum()) if isinstance(encoder, DeltaEncoder) else 0
    return PlacedNetwork(BatchOnChip(spiking), lambda walks: _chip_counts(spiking, used, walks))


class BatchOnChip:
    """A spiking policy as a BatchController.

    seeds  of the upsets of each robot; without them all start from one
    """

    def __init__(self, spiking: SpikingController, seeds: Sequence[int] | None = None) -> None:
        self._spiking, self._seeds = spiking, seeds
        self.act_batch = spiking.act_batch

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        if self._seeds is None:
            self._spiking.reset(0)
        else:
            self._spiking.reset(0, each=self._seeds)


def _chip_counts(spiking: SpikingController, used: int, walks: Sequence[Walk]) -> Counts:
    """Means per control step; robots at their end keep their place in the batch, uncounted."""
    ledger, program = spiking.ledger, spiking.program
    lengths = np.array([len(walk.observation) for walk in walks])
    rows = ledger.counts.reshape(lengths.max(), len(walks), *ledger.counts.shape[1:])
    alive = np.arange(lengths.max())[:, None] < lengths
    counts = rows[alive].sum(axis=0) / lengths.sum()  # (L, E)
    per_step = dict(zip(EVENTS, counts.sum(axis=0).tolist(), strict=True))
    sent = dict(zip(ledger.layers, counts[:, EVENTS.index("spike_out")].tolist(), strict=True))
    updates = counts[:, EVENTS.index("neuron_update")]
    readouts = [name in ledger.readouts for name in ledger.layers]
    others = sum(sent[s.source] for s in program.layers[0].synapses if s.source != program.input)
    neurons = sum(layer.size for layer in program.spiking)
    several = ledger.several or not neurons
    return {
        "operations": per_step["sop"],
        "graded_operations": per_step["graded_sop"],
        "bias_operations": per_step["bias_sop"],
        "neurons": float(sum(ledger.neurons)),
        "neuron_updates": per_step["neuron_update"],
        "readout_updates": float(updates[readouts].sum()),
        "neuron_idle": per_step["neuron_idle"],
        "messages": per_step["message"],
        "events": float(counts[0, EVENTS.index("spike_in")]) - others,
        "spikes_out": per_step["spike_out"],
        "observations": float(used),
        "constants": float(constants(program)),
        "on_host": float(sum(layer.size for layer in program.host)),
        "saturations": per_step["saturation"] * float(lengths.sum()),
        "sparsity": None if several else 1 - per_step["spike_out"] / neurons,
    }


def constants(program: Program) -> int:
    """Numbers that the host adds to what leaves the chip."""
    if program.readout is not None:
        return int(program.readout.bias.size)
    return sum(outlet.bias.size for outlet in program.outlets)


def _pruned(policy: PrunedMlpPolicy, origin: Provenance, path: Path) -> PlacedNetwork:
    running = OnnxController(to_onnx(policy, origin, path, kind_of(policy)))

    def counts(walks: Sequence[Walk]) -> Counts:
        seen = np.concatenate([walk.observation for walk in walks]).astype(np.float64)
        matrices = [each for each in policy.matrices.children() if isinstance(each, PrunedWeight)]
        first, *others = (each.fan_out for each in matrices)
        read = first + policy.past.fan_out if policy.skip else first
        hidden = sum(int(torch.count_nonzero(fan_out)) for fan_out in others)
        return {
            "operations": running.effective_macs(seen),
            "observations": float(torch.count_nonzero(read)),
            "constants": float(hidden + policy.actions),  # a bias of each unit
        }

    return PlacedNetwork(Stateless(running.replay), counts)


class DeltaNetwork:
    """A float network that sends what changed since it was sent, as a BatchController.

    An input or a unit is sent where it differs by more than a threshold from what was sent of it
    last; whom it reaches adds weight times change to a sum that is kept (Neil et al. 2017,
    arXiv 1612.05571). Inputs are compared as they are normalised.
    """

    def __init__(self, policy: PrunedMlpPolicy, threshold: float) -> None:
        self._policy, self._threshold = policy, threshold
        first, *others = (each.fan_out for each in policy.layers)
        self._fan_outs = [first + policy.past.fan_out if policy.skip else first, *others]

    def reset(self, robots: int) -> None:
        """Start an episode of each; nothing was sent."""
        self._sent = [torch.zeros(robots, len(fan_out)) for fan_out in self._fan_outs]
        # (B, 3) of each control step: multiplications, units reached, what was sent
        self._steps: list[Tensor] = []

    @torch.no_grad()
    def act_batch(self, observation: NDArray[Any]) -> NDArray[Any]:
        """Actions (B, act) for observations (B, obs)."""
        policy = self._policy
        x = policy.normalizer(torch.from_numpy(observation).float())
        counts, changes = torch.zeros(3, len(x)), []
        for k, (matrix, bias) in enumerate(zip(policy.layers, policy.biases, strict=True)):
            is_sent = (x - self._sent[k]).abs() > self._threshold
            self._sent[k] = torch.where(is_sent, x, self._sent[k])
            changes.append(is_sent.float())
            drive = matrix.drive(self._sent[k], matrix()) + bias
            reached = matrix.drive(changes[k], matrix().abs()) != 0
            if policy.skip and k == len(policy.hidden):  # actions, past the hidden units too
                drive = drive + policy.past.drive(self._sent[0], policy.past())
                reached |= policy.past.drive(changes[0], policy.past().abs()) != 0
            costs = changes[k] @ self._fan_outs[k], reached.sum(1), changes[k].sum(1)
            counts += torch.stack(costs)
            x = torch.relu(drive)
        self._steps.append(counts.T)
        return policy.env_action(drive)

    def counts(self, walks: Sequence[Walk]) -> Counts:
        """Means per control step; robots at their end keep their place in the batch, uncounted."""
        lengths = torch.tensor([len(walk.observation) for walk in walks])
        alive = torch.arange(len(self._steps))[:, None] < lengths
        macs, reached, sent = torch.stack(self._steps)[alive].double().mean(0).tolist()
        return {
            "operations": macs,
            "compared": reached,
            "sent": sent,
            "observations": float(torch.count_nonzero(self._fan_outs[0])),
            "constants": 0.0,  # biases are in the sums that are kept
        }


def _dense_counts(policy: Policy, walks: Sequence[Walk]) -> Counts:
    """Operations of a float network of which nothing is left out: all multiply-accumulates."""
    weights = [each for each in policy.parameters() if each.ndim == 2]
    biases = [each for each in policy.parameters() if each.ndim == 1]
    return {
        "operations": float(sum(each.numel() for each in weights)),
        "observations": float(walks[0].observation.shape[1]),
        "constants": float(sum(each.numel() for each in biases)),
    }


def is_discrete(env: str, options: Mapping[str, Any] | None = None) -> bool:
    """Return whether an environment's actions are choices."""
    world = envs.make(env, **(options or {}))
    world.close()
    return isinstance(world.action_space, gymnasium.spaces.Discrete)


def random_actions(env: str, seed: int = 0) -> Stateless:
    """Actions drawn at random, the lower bound of a return."""
    world: Any = envs.make(env)
    space, chooses = world.action_space, is_discrete(env)
    world.close()
    count = int(space.n) if chooses else space.shape[0]
    return pool.random_actions(count, chooses, np.random.default_rng(seed))


def float_actions(teacher: Teacher, chooses: bool) -> Stateless:
    """What a teacher does: its actions, or the choice of its largest logit."""
    if chooses:
        return Stateless(lambda seen: teacher.act_all(seen).argmax(-1))
    return Stateless(teacher.act_all)


def share_of_teacher(scores: ArrayLike, teacher: ArrayLike, at_random: float) -> Estimate:
    """Returns (S, n) of S trainings over the teacher's (n,) in the same episodes.

    Where the teacher's mean is negative, of the way from the mean of random actions to it.
    """
    taught = np.asarray(teacher, np.float64)
    lowest = at_random if taught.mean() < 0 else 0.0
    return nested_ratio(np.asarray(scores, np.float64) - lowest, taught - lowest)


@dataclass(frozen=True)
class Played:
    """Episodes of one batch.

    walks       observations and steps of each
    returns     of each
    infos       of the last step of each
    terminated  whether each ended in a terminal state
    """

    walks: list[Walk]
    returns: list[float]
    infos: Sequence[Mapping[str, Any]]
    terminated: list[bool]


def play(
    config: EnvConfig, episodes: int, controller: BatchController, limit: int | None = None
) -> Played:
    """Play so many evaluation episodes, at most `limit` control steps each, in one batch."""
    together = Episodes(config, episodes, limit)
    seeds = range(EVALUATION, EVALUATION + episodes)
    # walks are kept only with labels, of which nothing is needed here
    walks, returns, infos = together.play(seeds, controller, lambda seen: seen[:, :0])
    return Played(walks, list(returns), infos, [each.terminated for each in together.earned])


def evaluate(
    env: str, options: Mapping[str, Any], policy: str, episodes: int, on: str | None
) -> list[dict[str, Any]]:
    """Rows of a comparison: the policy; if it spikes, its float twin and the chip."""
    entries, seeds = make_entries(find(policy), on), range(EVALUATION, EVALUATION + episodes)
    return compare_policies(env, entries, seeds, processes=1, options=options).as_json()
