"""Students that see by events: karts simulated side by side, and the error of windows of walks.

Labels come from what a privileged teacher knows of the simulation, not from the observation: a row
has the logit of each action, then 1 for what the sign ahead said: nothing yet, left or right.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import cross_entropy

from spikedeploy.envs.eye.batch import STEERING, EyeBatch, EyeOptions
from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.compiler.compile import Recompiler, compile_program
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.distill.teacher import compute_cross_entropy
from spikedeploy.trainers.policies import FloatVisionPolicy, SpikingVisionPolicy, VisionPolicy
from spikedeploy.trainers.policies.policy import PrunedKernel, SynapseGroup
from spikedeploy.trainers.policies.vision import SIGNS, vision_artifact
from spikedeploy.trainers.run_folder import RunFolder, with_prefix
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import (
    BatchController,
    Earned,
    Episodes,
    Label,
    Single,
    Walk,
    WalkPool,
    Windows,
)
from spikedeploy.trainers.through_chip import time_first

_WIDTH = 0.12  # of the bell of targets around the teacher's steering [full steering]
_UNKNOWN = 0.4  # weight of control steps in which no sign was readable yet
_SMOOTHING = 0.02  # weight of the newest batch in mean rates
_STEP = "weights"  # the kind of rounding, as an arithmetic's `ablation_steps` name it


class EyeEpisodes(Episodes):
    """Karts that see by events, simulated side by side as one batch."""

    def _make(self, config: EnvConfig) -> None:
        self._options = config.options
        self._env = EyeBatch(self._count, **self._options)

    def label(self, observation: NDArray[Any]) -> NDArray[np.float64]:
        """Return labels (B, act + 3) of where the karts are now."""
        apart = (self._env.teacher()[:, None] - np.array(STEERING)) / _WIDTH
        hint = np.eye(SIGNS)[self._env.known()["hint"]]
        # log of a bell: exp(-1/2 d^2), up to a constant
        return np.concatenate([-0.5 * apart**2, hint], axis=1)

    def _side_by_side(
        self, seeds: Sequence[int], controller: BatchController, label: Label | None
    ) -> tuple[list[Walk], list[float], list[dict[str, Any]]]:
        if len(seeds) != self._env.size:
            self._env = EyeBatch(len(seeds), **self._options)
        count, env = len(seeds), self._env
        now = env.reset(seeds).reshape(count, -1).astype(np.float64)
        ended, terminal = np.zeros((2, count), np.bool_)
        length, infos = np.zeros(count, np.int64), [dict[str, Any]() for _ in seeds]
        seen: list[NDArray[np.uint8]] = []
        labels, rewards = [], []
        controller.reset(count)
        while not ended.all() and len(seen) != self._limit:
            seen.append(now.astype(np.uint8))
            if label is not None:
                labels.append(label(now).astype(np.float32))
            counts, reward, terminated, truncated, info = env.step(controller.act_batch(now))
            now = counts.reshape(count, -1).astype(np.float64)
            rewards.append(np.where(ended, 0.0, reward).astype(np.float32))
            length += ~ended
            for k in np.flatnonzero((terminated | truncated) & ~ended).tolist():
                infos[k] = _outcome(info, k)
            terminal |= terminated & ~ended
            ended |= terminated | truncated
        for k in np.flatnonzero(~ended).tolist():
            infos[k] = _outcome(info, k)
        gained, shown = np.stack(rewards, 1), np.stack(seen, 1)
        last = now.astype(np.float32)
        self.earned += [
            Earned(gained[k, : length[k]], last[k], bool(terminal[k])) for k in range(count)
        ]
        walks = []
        if label is not None:
            wanted = np.stack(labels, 1)
            for k, n in enumerate(length.tolist()):
                crashed = bool(terminal[k] and not infos[k]["finish"])
                walks.append(Walk(shown[k, :n].copy(), wanted[k, :n].copy(), crashed))
        return walks, gained.sum(1, dtype=np.float64).tolist(), infos


def _outcome(info: Mapping[str, Any], k: int) -> dict[str, Any]:
    """Return what is known of an episode's end: finish, crash, wrong arm, forks passed."""
    return {name: float(info[name][k]) for name in ("finish", "crash", "wrong", "forks")}


class VisionStudent:
    """A policy that sees by events, which learns from windows of walks.

    policy: what is trained
    guide: float policy that it imitates as well, None for none
    offsets: what rounding by the chip adds to each weight; none before `round`
    """

    readout = frozenset({"synapses.out.weight", "biases.out"})

    def __init__(self, policy: VisionPolicy, config: SparseConfig) -> None:
        self.policy, self._config = policy, config
        self.guide = _guide(config.guide, policy) if config.guide else None
        self._guided: list[Single] = []  # labels of the guide, walk by walk
        self.offsets: Mapping[str, Tensor] = {}
        target = chip(config.chip)
        by_events = getattr(target.arithmetic, "by_events", False)
        spiking = isinstance(policy, SpikingVisionPolicy)
        self._events = EventsOnChip(target) if by_events and spiking else None
        widths = [policy.inputs(name) for name in policy.synapses]
        self._rates = [torch.full((width,), 0.1) for width in widths]

    @property
    def by_events(self) -> bool:
        """Whether the forward pass is that of a chip that works event by event."""
        return self._events is not None

    def prepare(self, pool: WalkPool) -> None:
        """Let windows hold counts as they are, and what the guide says of them as labels."""
        if self.guide is not None:
            self._guided += [said_by(self.guide, w) for w in pool.walks[len(self._guided) :]]
        pool.take_observations(self._guided)

    def begin(self, pool: WalkPool, rng: np.random.Generator) -> None:
        """Take over a start; or the guide's first convolutions, and scale weights to the walks."""
        if self._config.start:
            self.policy.load_state_dict(_start(self._config, self.policy).state_dict())
            return
        if self.guide is not None:
            self._take_over(self.guide)
        self.policy.normalise(self._sample(pool, rng).seen[:16].float())

    @torch.no_grad()
    def _take_over(self, guide: VisionPolicy) -> None:
        for name in kernels(self.policy)[: len(kernels(guide))]:
            weight, known = (p.matrix(name).weight for p in (self.policy, guide))
            # a further channel of a count begins as the first does
            times = len(weight[0]) // len(known[0]) if name == "conv1" else 1
            found = known.repeat_interleave(times, 1)
            if found.shape != weight.shape:
                break
            weight.copy_(found)

    def _sample(self, pool: WalkPool, rng: np.random.Generator) -> Windows:
        c = self._config
        return pool.sample(
            rng, c.batch, c.window, c.burn_in, c.first_windows, c.crash_windows, c.crash_steps
        )

    def loss(self, pool: WalkPool, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return the error of windows, and the operations in a control step, with a gradient."""
        c, windows = self._config, self._sample(pool, rng)
        seen, labels = mirrored(windows, torch.from_numpy(rng.random(c.batch) < 0.5), self.policy)
        state = self.policy.rest(c.batch)
        if self._events is not None and isinstance(self.policy, SpikingVisionPolicy):
            on_chip = self._events.seen(self.policy, seen)
            done = self.policy.unrolled(seen, self.weights(), state, on_chip)
        else:
            done = self.policy.unrolled(seen, self.weights(), state)
        wanted, hint = labels[..., 0, :-SIGNS], labels[..., 0, -SIGNS:].argmax(-1)
        # what the burn-in saw counts where an episode begins
        counted = torch.arange(c.window)[None] >= c.burn_in
        error = compute_cross_entropy(done.mean, wanted, c.sharpness)
        if self.guide is None:
            said = cross_entropy(
                done.signs.flatten(0, 1), hint.flatten(),
                torch.tensor([_UNKNOWN, 1.0, 1.0]), reduction="none",
            ).view_as(error)  # fmt: skip
        else:
            known = labels[..., 1, :]
            error = (error + compute_cross_entropy(done.mean, known[..., :-SIGNS], 1.0)) / 2
            said = compute_cross_entropy(done.signs, known[..., -SIGNS:], 1.0)
        some = counted.expand_as(error)
        active = self._frequencies(done.inputs)
        pairs = zip(self._rates, active, strict=True)
        self._rates = [torch.lerp(before, rate.detach(), _SMOOTHING) for before, rate in pairs]
        total = error[some].mean() + c.sign_weight * said[some].mean()
        return total, self.hidden_operations(done.inputs[1:])

    def weights(self) -> dict[str, Tensor]:
        """Return what is computed with: the policy's weights, as the chip rounds them."""
        weights = self.policy.weights()
        return weights | {name: weights[name] + added for name, added in self.offsets.items()}

    def hidden_operations(self, activities: list[Tensor]) -> Tensor:
        """Return activations (n, M) behind the first group times fan-outs: operations, about."""
        groups = self.synapses()[1:]
        pairs = zip(activities, groups, strict=True)
        costs = [(each.mean(0) * group.matrix.fan_out).sum() for each, group in pairs]
        return sum(costs, start=torch.zeros(()))

    def adopt_rates(self, activities: list[Tensor]) -> None:
        """Take over the frequencies of inputs behind the first group, as of `_frequencies`."""
        self._rates[1:] = self._frequencies(activities)

    def _frequencies(self, activities: list[Tensor]) -> list[Tensor]:
        """Return spikes (M,) of inputs (n, M) in a control step, of floats how often not 0."""
        spiking = isinstance(self.policy, SpikingVisionPolicy)
        return [(each if spiking else (each != 0).float()).mean(0) for each in activities]

    def round(self, target: Chip) -> None:
        """Compute with the numbers that the chip would have now, if the configuration says so."""
        if self._config.rounding and isinstance(self.policy, SpikingVisionPolicy):
            self.offsets = rounding_of_kernels(self.policy, target)

    def acting(self) -> VisionPolicy:
        """Return the policy with the numbers that are computed with."""
        return with_weights(self.policy, self.offsets)

    @property
    def neurons(self) -> int:
        """Sources that still have synapses, the inputs left out."""
        return sum(int((group.matrix.fan_out > 0).sum()) for group in self.synapses()[1:])

    def synapses(self) -> list[SynapseGroup]:
        """Return all synapses."""
        pairs = zip(self.policy.synapses, self._rates, strict=True)
        return [SynapseGroup(self.policy.matrix(name), rate) for name, rate in pairs]

    def hidden_layers(self) -> list[tuple[SynapseGroup, SynapseGroup]]:
        """Return none: neurons of kernels are not removed one by one."""
        return []

    def tensors(self) -> dict[str, Tensor]:
        """Return rates and offsets of rounding, by name."""
        rates = {f"rate{number}": rate.clone() for number, rate in enumerate(self._rates)}
        return rates | {f"offsets.{name}": added for name, added in self.offsets.items()}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore what `tensors` returned."""
        self._rates = [named[f"rate{number}"] for number in range(len(self._rates))]
        self.offsets = with_prefix("offsets", named)


class EventsOnChip:
    """What the spiking layers of a policy do on a chip that works event by event.

    Its gradients are those of timesteps (trainers.neurons.integrate_many), at these spikes.
    """

    def __init__(self, target: Chip) -> None:
        self._target = target
        self._compiler: Recompiler | None = None

    @torch.no_grad()
    def seen(self, policy: SpikingVisionPolicy, counts: Tensor) -> dict[str, tuple[Tensor, Tensor]]:
        """Return spikes and membranes (L, B, N) of each layer for counts (B, L, C·Y·X)."""
        artifact = vision_artifact(policy)
        if self._compiler is None:
            self._compiler = Recompiler(artifact, self._target, limits=False)
        program = self._compiler.program(artifact.graph)
        batch, length = counts.shape[:2]
        raster = policy.encode(counts.flatten(0, 1)).view(batch, length, -1)
        machine = Machine(program, None, "none", trace=True, backend="auto")
        machine.infer(raster.numpy().astype(np.uint8))
        found = {}
        for number, name in enumerate(policy.spiking, start=1):
            recorded, layer = machine.recordings[f"lif{number}"], program.layer(f"lif{number}")
            behind = time_first(recorded.membrane, counts, layer.scale)
            found[name] = time_first(recorded.spikes, counts, 1.0), behind
        return found


def kernels(policy: VisionPolicy) -> list[str]:
    """Return the names of a policy's convolutions."""
    return [name for name in policy.synapses if isinstance(policy.matrix(name), PrunedKernel)]


def _guide(run: str, policy: VisionPolicy) -> VisionPolicy:
    """Return the policy of a run that is pruned least, which sees what another sees."""
    folder = RunFolder.find(run)
    found = folder.policy(next(reversed(folder.levels.values()), None))
    if not isinstance(found, FloatVisionPolicy) or found.shape != policy.shape:
        raise ConfigError(
            f"guide: the policy of {run} is no float policy that sees counts {policy.shape} as "
            "this one does. Give a run of one"
        )
    return found.requires_grad_(False)


def _start(config: SparseConfig, policy: VisionPolicy) -> VisionPolicy:
    """Return the policy of the start that is pruned most, at the control rate of the training."""
    folder = RunFolder.find(config.start)
    found = folder.policy(next(iter(folder.levels.values()), None))
    if not isinstance(found, VisionPolicy) or found.spec() != policy.spec():
        raise ConfigError(
            f"start: the policy of {config.start} is not one as is trained here. Give a run with "
            "the settings policy.… of this one"
        )
    made = (config, folder.config(SparseConfig))
    rate, before = (EyeOptions(**each.env.options).rate for each in made)
    return found.slowed(rate / before)


@torch.no_grad()
def said_by(guide: VisionPolicy, walk: Walk) -> Single:
    """Return logits (S, act + 3) of a float policy through a walk: of actions, then of signs."""
    counts = torch.from_numpy(walk.observation)[None].float()
    done = guide.unrolled(counts, guide.weights(), guide.rest(1))
    found: Single = torch.cat([done.mean, done.signs], -1)[0].numpy()
    return found


def mirrored(windows: Windows, chosen: Tensor, policy: VisionPolicy) -> tuple[Tensor, Tensor]:
    """Return counts and labels (W, L, k, act + 3), those that are chosen (B,) as a mirror shows.

    k: labels of a control step, of the teacher and of a guide
    """
    seen = windows.seen.float()
    label = windows.label.view(*seen.shape[:2], -1, policy.actions + SIGNS).clone()
    maps = seen[chosen].view(-1, seen.shape[1], *policy.shape)
    seen[chosen] = maps.flip(-1).flatten(-3)
    actions, signs = label[chosen][..., :-SIGNS], label[chosen][..., -SIGNS:]
    label[chosen] = torch.cat([actions.flip(-1), signs[..., [0, 2, 1]]], -1)
    return seen, label


# -- rounding: what a chip's own quantiser makes of a policy's numbers


@torch.no_grad()
def rounding_of_kernels(policy: SpikingVisionPolicy, target: Chip) -> dict[str, Tensor]:
    """Return what rounding of weights by the chip adds to each group of synapses, by name."""
    artifact = vision_artifact(policy)
    # weights do not depend on how neurons spike; "ideal" knows one way alone
    plain = replace(artifact.convention, spikes="above", floor="none")
    exact = compile_program(replace(artifact, convention=plain), chip("ideal"), limits=False)
    rounded = compile_program(artifact, target, limits=False)
    offsets = {name: torch.zeros_like(weight) for name, weight in policy.weights().items()}
    for before, after in zip(exact.layers, rounded.layers, strict=True):
        units = target.arithmetic.partly_rounded(before, after, _STEP)
        for old, new in zip(before.synapses, units.synapses, strict=True):
            name = _group(policy, before.name, old.source)
            error = torch.from_numpy(new.weight * after.scale - old.weight).float()
            weight = offsets[name]
            # matrices of programs are (M, N)
            offsets[name] = error if error.ndim == 4 else error.T.reshape(weight.shape)
    return {name: each * policy.matrix(name).mask for name, each in offsets.items()}


def _group(policy: SpikingVisionPolicy, layer: str, source: str) -> str:
    """Return the name of the synapses from one node of a program onto another."""
    last = f"lif{len(policy.spiking)}"
    if layer == "readout":
        return "out" if source == last else "past"
    if layer == source:
        return "back"
    return policy.spiking[int(layer.removeprefix("lif")) - 1]


@torch.no_grad()
def with_weights(policy: VisionPolicy, offsets: Mapping[str, Tensor]) -> VisionPolicy:
    """Return a copy that computes with the weights of the chip: those of the policy and these."""
    copy = deepcopy(policy)
    for name, added in offsets.items():
        copy.matrix(name).weight.add_(added)
    return copy
