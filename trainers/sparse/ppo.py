"""PPO after imitation: a pruned policy learns from reward, with its masks as they are.

Each iteration plays whole episodes with exploration and the chip's rounded weights, replays them in
windows, and takes a few clipped steps (Schulman et al. 2017). The error against the teacher and the
penalty on operations stay in the loss. The policy at the start is the first that is validated, so
that the best is never worse on the validation seeds.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, model_validator
from torch import Tensor
from torch.nn import functional
from torch.nn.utils.rnn import pad_sequence

from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import (
    Batch,
    Count,
    DeltaSnnConfig,
    PolicyConfig,
    Positive,
    Rate,
    RunConfig,
    Share,
    ValidationConfig,
    Width,
)
from spikedeploy.trainers.distill.teachers import teacher
from spikedeploy.trainers.learner import Critic, adam, adam_tensors, load_adam, under
from spikedeploy.trainers.policies import DeltaMlpPolicy, DeltaSnnPolicy, Policy, PrunedMlpPolicy
from spikedeploy.trainers.ppo import CategoricalHead, advantages, descend
from spikedeploy.trainers.run_folder import LEVEL, RunFolder
from spikedeploy.trainers.runner import Runner
from spikedeploy.trainers.sparse.config import SparseConfig
from spikedeploy.trainers.sparse.pool import Earned, Episodes, Walk, WalkPool, Windows
from spikedeploy.trainers.sparse.student import (
    DeltaStudent,
    MlpStudent,
    add_offsets,
    deployed,
    imitation,
    on_chip,
    operations,
    rounding_offsets,
)

# -- Configuration of PPO after imitation.

Ends = tuple[Rate, Rate]


class SparsePpoConfig(RunConfig):
    """PPO on windows of whole walks, from the best policy of a sparse run (docs/training.md).

    start: run folder of a sparse recipe: a path, or a name in the folder that this run is in.
        Policy, masks, teacher, budget, chip, rounding and sharpness are those of its configuration
    start_checkpoint: which of its policies: "best" is the best at its budget, "ops-480" the best of
        those pruned to 480 operations, which then are the budget
    budget: operations of a control step that the best policy may take; by default those of the
        start's recipe, or what the start takes if that is more
    iterations: number of times that episodes are played and learned from; `validation.every` and
        `checkpoint_every` count them
    warm_up: iterations at the beginning in which only the critic learns
    episodes: whole episodes of an iteration, played at once
    noise: standard deviation of the noise on continuous actions, in the first and last iteration
    temperature: divisor of the logits when discrete actions are sampled, in the same way
    window, burn_in: control steps of a window of a walk, and how many of them at its beginning only
        bring the states up, which are learned from in the window before
    batch, epochs: windows of an update, and passes over those of an iteration
    learns: which weights: "all", or those onto the readout and its decay factors alone. Then the
        hidden spikes of a replayed walk stay what they were, and the ratios change smoothly; the
        penalty has no effect
    gamma, trace, clip, gradient_norm: as of PPO, see PpoConfig
    actor_rate, target_kl: learning rate of the policy in the first pass, and the mean divergence
        from the policy that played which it is adapted to: a pass that ends above twice as much is
        the last one of its iteration and lowers the rate, one below half as much raises it (Rudin
        et al. 2022)
    critic_rate, critic_batch, critic_epochs, critic_hidden: of the critic, which learns from single
        states
    imitation: weight of the error against the teacher's labels
    penalty: weight of the hidden neurons' operations over `max(budget, penalty_floor)` of the start
    """

    policy: PolicyConfig = DeltaSnnConfig()
    start: str = ""
    start_checkpoint: str = "best"
    budget: Rate | None = None
    iterations: Positive = 60
    warm_up: Count = 2
    episodes: Positive = 8
    noise: Ends = (0.2, 0.1)
    temperature: Ends = (1.0, 0.2)
    window: Batch = 60
    burn_in: Count = 15
    batch: Batch = 32
    epochs: Positive = 4
    learns: Literal["all", "readout"] = "readout"
    gamma: Share = 0.98
    trace: Share = 0.95
    clip: Rate = 0.2
    target_kl: Rate = 0.01
    gradient_norm: Rate = 0.5
    actor_rate: Rate = 5e-5
    critic_rate: Rate = 1e-3
    critic_batch: Batch = 512
    critic_epochs: Positive = 8
    critic_hidden: tuple[Width, ...] = (128, 128)
    imitation: float = Field(default=1.0, ge=0)
    penalty: float = Field(default=0.1, ge=0)
    checkpoint_every: Positive = 10
    validation: ValidationConfig = ValidationConfig(every=10, episodes=24)

    @model_validator(mode="after")
    def _windows_follow_each_other(self) -> "SparsePpoConfig":
        if self.window < 2 * self.burn_in or self.window == self.burn_in:
            raise ValueError(f"window: {self.window} is less than twice burn_in ({self.burn_in})")
        return self


# -- The run that PPO goes on from: found by the setting `start`, checked, stored so that it
#    moves.
#
# A run folder stores its start relative to the folder that holds both, so that they can be moved
# together; a start elsewhere is stored as an absolute path.


def find_start(start: str, runs: Path) -> RunFolder:
    """Return the run that `start` of a run in the folder `runs` names.

    Where an absolute path has gone, a folder of that name beside the run is taken.
    """
    for path in (runs / start, Path(start), Path("runs") / start, runs / Path(start).name):
        if (path / "config.json").is_file():
            return RunFolder(path)
    return RunFolder.find(start)


def stored_start(start: RunFolder, runs: Path) -> str:
    """Return `start` as the run folder stores it."""
    # the last part stays as it is, which may be a link into another folder
    path, folder = start.path.parent.resolve() / start.path.name, runs.resolve()
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)


def starting_point(config: SparsePpoConfig, runs: Path) -> tuple[RunFolder, SparseConfig, Policy]:
    """Return the run to start from, its configuration with the budget of the policy, the policy."""
    if not config.start:
        raise ConfigError(
            f"{config.recipe} needs a finished run: --set start=RUN, where RUN is the run folder "
            "of a sparse recipe for the same task"
        )
    run = find_start(config.start, runs)
    if (found := run.settings()["algorithm"]) != "sparse":
        raise ConfigError(
            f"start: {config.start} is a run of {found}. Give one of a sparse recipe."
        )
    source = run.config(SparseConfig)
    if source.env.name != config.env.name:
        raise ConfigError(
            f"start: {config.start} was trained in {source.env.name}, not in {config.env.name}. "
            "Take the recipe of its task."
        )
    level = config.start_checkpoint
    if not run.checkpoint(level).is_file():
        raise ConfigError(_no_policy(config, run))
    policy = run.policy(level)
    if isinstance(policy, DeltaMlpPolicy):
        raise ConfigError(
            f"start: {config.start} has sigma-delta neurons, with which PPO cannot go on. "
            "Give a run with LIF neurons or of a float network."
        )
    if level.startswith(LEVEL):
        source = source.model_copy(update={"budget": float(level.removeprefix(LEVEL))})
    return run, source, policy


def _no_policy(config: SparsePpoConfig, run: RunFolder) -> str:
    level = config.start_checkpoint
    if level == "best":
        return (
            f"start: {config.start} has no policy at its budget yet. Wait until it ends, or "
            "continue it with --resume."
        )
    found = sorted(path.stem for path in run.checkpoint(level).parent.glob(f"{LEVEL}*.safetensors"))
    return (
        f"start_checkpoint: {config.start} has no policy {level!r}. It has "
        f"{', '.join(found) or 'none of any level yet'}."
    )


# -- Policies whose walks are played again in windows: spiking ones from events, float ones as
#    is.


class Means(Protocol):
    """A policy in episodes of several robots, before an action is chosen."""

    def reset(self, robots: int) -> None:
        """Start an episode of each."""

    def __call__(self, observation: Tensor) -> Tensor:
        """Return the means (B, act) of one control step."""


class Replay(Protocol):
    """What PPO asks of a policy with masks.

    readout: names of the parameters behind the last hidden layer, and past it
    """

    @property
    def policy(self) -> Policy:
        """The policy that learns."""

    readout: frozenset[str]

    def round(self, target: Chip) -> None:
        """Compute with the weights that the chip would have now."""

    def acting(self) -> Means:
        """Return the policy in episodes, with the weights that are computed with."""

    def prepare(self, pool: WalkPool) -> None:
        """Make windows of new walks possible."""

    def replay(self, windows: Windows) -> tuple[Tensor, list[Tensor]]:
        """Return means and hidden activities (n, L + burn-in, ...) of windows, layer by layer."""

    def hidden(self, activities: list[Tensor]) -> Tensor:
        """Return the hidden neurons' operations for activities (..., H), with a gradient."""

    def operations(self, activities: list[Tensor]) -> float:
        """Return all operations of a control step on the walks that were prepared."""


class DeltaReplay:
    """A DeltaSnnPolicy, with the rounding of its weights; see Replay."""

    readout = frozenset({"out.weight", "past.weight", "action_bias", "_gamma"})

    def __init__(self, policy: DeltaSnnPolicy, source: SparseConfig, burn_in: int) -> None:
        self.policy, self._source, self._burn_in = policy, source, burn_in
        self.student = DeltaStudent(policy, source)

    def round(self, target: Chip) -> None:
        """Compute with the weights that the chip would have now."""
        if self._source.rounding:
            self.student.offsets = rounding_offsets(self.policy, target)

    def acting(self) -> "DeltaMeans":
        """Return the policy in episodes, with the weights that are computed with."""
        policy = deepcopy(self.policy)
        add_offsets(policy, self.student.offsets)
        return DeltaMeans(policy)

    def prepare(self, pool: WalkPool) -> None:
        """Compute the events of new walks."""
        self.student.prepare(pool)

    def replay(self, windows: Windows) -> tuple[Tensor, list[Tensor]]:
        """Return means and hidden spikes of windows."""
        mean, spikes = self.policy.unrolled(
            windows.seen, windows.moved, self.student.weights(), self._burn_in, windows.begins
        )
        return mean, [spikes]

    def hidden(self, activities: list[Tensor]) -> Tensor:
        """Return the hidden neurons' operations for spikes (n, H), with a gradient."""
        return (activities[0].mean(0) * self.policy.out.fan_out).sum()

    def operations(self, activities: list[Tensor]) -> float:
        """Return all operations of a control step on the walks that were prepared."""
        self.student.hidden_rate = activities[0].mean(0)
        return operations(self.student.synapses())


class DeltaMeans:
    """A DeltaSnnPolicy in episodes; see Means."""

    def __init__(self, policy: DeltaSnnPolicy) -> None:
        self.policy = policy

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._state = self.policy.rest(robots)

    def __call__(self, observation: Tensor) -> Tensor:
        """Return the means (B, act) of one control step."""
        return self.policy.advance(observation, self._state)[0]


class MlpReplay:
    """A PrunedMlpPolicy, which has no state: windows are observations alone; see Replay."""

    def __init__(self, policy: PrunedMlpPolicy, source: SparseConfig) -> None:
        self.policy = policy
        self.student = MlpStudent(policy, source)
        last = len(policy.matrices) - 1
        self.readout = frozenset({f"matrices.{last}.weight", f"biases.{last}", "past.weight"})

    def round(self, target: Chip) -> None:
        """Do nothing: float weights are not rounded."""

    def acting(self) -> "MlpReplay":
        """Return the policy itself."""
        return self

    def reset(self, robots: int) -> None:
        """Do nothing: there is no state."""

    def __call__(self, observation: Tensor) -> Tensor:
        """Return the means (B, act) of one control step."""
        return self.policy.activations(observation)[0]

    def prepare(self, pool: WalkPool) -> None:
        """Take the observations as they are."""
        pool.take_observations()

    def replay(self, windows: Windows) -> tuple[Tensor, list[Tensor]]:
        """Return means and hidden activations of windows."""
        count, length = windows.seen.shape[:2]
        mean, inputs = self.policy.activations(windows.seen.flatten(0, 1))
        return mean.view(count, length, -1), [x.view(count, length, -1) for x in inputs[1:]]

    def hidden(self, activities: list[Tensor]) -> Tensor:
        """Return the mean of activations (n, H) times their fan-outs, which stands for operations.

        The share of active neurons has no gradient.
        """
        matrices = [each for each in self.student.synapses() if each.matrix is not self.policy.past]
        costs = [
            (hidden.mean(0) * each.matrix.fan_out).sum()
            for hidden, each in zip(activities, matrices[1:], strict=True)
        ]
        return sum(costs, start=torch.zeros(()))

    def operations(self, activities: list[Tensor]) -> float:
        """Return all operations of a control step on the walks that were prepared."""
        rates = ((hidden > 0).float().mean(0) for hidden in activities)
        self.student.load({f"rate{number}": rate for number, rate in enumerate(rates)})
        return operations(self.student.synapses())


def replay_of(policy: Policy, source: SparseConfig, burn_in: int) -> Replay:
    """Return what PPO needs of a policy that a sparse run left."""
    if isinstance(policy, DeltaSnnPolicy):
        return DeltaReplay(policy, source, burn_in)
    if isinstance(policy, PrunedMlpPolicy):
        return MlpReplay(policy, source)
    raise TypeError(f"{type(policy).__name__} is no policy that is pruned")


# -- Exploration around a policy whose states live on from one control step to the next.


class NoisyActions:
    """Gaussian around the deterministic action tanh(mean), executed within [-1, 1].

    spread: standard deviation [action]
    """

    def __init__(self, spread: float) -> None:
        self.spread = spread

    def draw(self, mean: Tensor) -> Tensor:
        """Return actions (B, act) drawn around those of the means (B, act), before clipping."""
        return torch.tanh(mean) + self.spread * torch.randn_like(mean)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return the log-probability (B,) of drawn actions, but for a constant."""
        # log p = -1/2 sum ((a - tanh(mean)) / spread)^2 ; the same spread for all of an iteration
        return -0.5 * ((drawn - torch.tanh(mean)) / self.spread).square().sum(-1)

    def action(self, drawn: Tensor) -> Tensor:
        """Return the action of the environment (B, act) in [-1, 1]."""
        return drawn.clamp(-1.0, 1.0).double()


class Exploring:
    """A policy that explores, as a BatchController.

    means: the policy, whose states live on
    drawn: what was drawn in every control step of the episodes, (B, act) or (B,) each
    """

    def __init__(self, means: Means, head: NoisyActions | CategoricalHead) -> None:
        self.means, self._head = means, head
        self.drawn: list[Tensor] = []

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self.means.reset(robots)
        self.drawn = []

    @torch.no_grad()
    def act_batch(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """Return actions (B, act), or (B,) if discrete."""
        mean = self.means(torch.from_numpy(observation).float())
        self.drawn.append(self._head.draw(mean))
        return self._head.action(self.drawn[-1]).numpy()


# -- Walks that explored, cut into windows with advantages: what PPO learns from.


@dataclass(frozen=True)
class Trials:
    """Windows of walks, n of them, with L control steps each behind the burn-in.

    windows: observations and labels, the burn-in included
    drawn: (n, L, act) or (n, L) actions as drawn
    advantage: (n, L)
    counts: (n, L) whether the step is part of the walk, and not behind its end
    before: (n, L) log-probability of what was drawn, by the policy that is learned from
    """

    windows: Windows
    drawn: Tensor
    advantage: Tensor
    counts: Tensor
    before: Tensor

    def __len__(self) -> int:
        return len(self.drawn)

    def minibatches(self, size: int) -> Iterator["Trials"]:
        """Yield all windows once, shuffled, in minibatches of about `size`."""
        for chosen in torch.randperm(len(self)).tensor_split(max(1, round(len(self) / size))):
            w = self.windows
            yield Trials(
                Windows(w.seen[chosen], w.moved[chosen], w.label[chosen], w.begins[chosen]),
                self.drawn[chosen],
                self.advantage[chosen],
                self.counts[chosen],
                self.before[chosen],
            )


@dataclass(frozen=True)
class Tiles:
    """Windows that cover every control step of W walks once behind their burn-in.

    windows: of all walks, one walk after another
    at, row: (n, L) and (n, 1) control step and walk of each step behind the burn-in
    counts: (n, L) whether the step is part of the walk
    """

    windows: Windows
    at: Tensor
    row: Tensor
    counts: Tensor

    def of(self, steps: Tensor) -> Tensor:
        """Return an array (S, W, ...) of all walks as (n, L, ...)."""
        return steps[self.at, self.row]


def tiles(pool: WalkPool, window: int, burn_in: int) -> Tiles:
    """Return the windows of a pool whose walks are encoded."""
    stride = window - burn_in
    lengths = [len(walk.label) for walk in pool.walks]
    begins = [np.arange(0, length, stride) for length in lengths]
    which = np.repeat(np.arange(len(lengths)), [len(each) for each in begins])
    first = np.concatenate(begins)
    steps = first[:, None] + np.arange(stride)
    return Tiles(
        pool.windows(which, first - burn_in, window, burn_in),
        torch.from_numpy(np.minimum(steps, max(lengths) - 1)),
        torch.from_numpy(which)[:, None],
        torch.from_numpy(steps < np.array(lengths)[which][:, None]),
    )


@dataclass(frozen=True)
class Course:
    """W walks as arrays, filled with zeros behind their ends.

    reward: (S, W)
    terminated, ended: (S, W) whether the episode ended in a terminal state; whether it ended
    lengths: (W,)
    """

    reward: Tensor
    terminated: Tensor
    ended: Tensor
    lengths: Tensor

    @classmethod
    def of(cls, earned: Sequence[Earned]) -> "Course":
        """Return what walks earned."""
        reward = pad_sequence([torch.from_numpy(each.reward) for each in earned])
        lengths = torch.tensor([len(each.reward) for each in earned])
        last = torch.arange(len(reward))[:, None] == lengths - 1
        stopped = torch.tensor([each.terminated for each in earned])
        return cls(reward, last & stopped, last, lengths)

    @property
    def counts(self) -> Tensor:
        """Whether a step is part of the walk (S, W)."""
        return torch.arange(len(self.reward))[:, None] < self.lengths

    def advantages(self, values: Sequence[Tensor], gamma: float, trace: float) -> Tensor:
        """Return advantages (S, W) for values (S_k + 1,) of each walk, that of its end included."""
        value = pad_sequence([each[:-1] for each in values])
        following = pad_sequence([each[1:] for each in values])
        return advantages(self.reward, value, following, self.terminated, self.ended, gamma, trace)


def states(walks: Sequence[Walk], earned: Sequence[Earned]) -> list[Tensor]:
    """Return raw observations (S + 1, obs) of each walk, that after its last step included."""
    return [
        torch.from_numpy(np.concatenate([walk.observation, each.final[None]]))
        for walk, each in zip(walks, earned, strict=True)
    ]


# -- Networks of PPO after imitation, and their gradient updates.

_EPS = 1e-8
_FASTER, _RATES = 1.5, (1e-6, 1e-2)  # factor by which the learning rate changes, and its limits


class SparsePpoLearner:
    """A pruned policy with its exploration, and a critic.

    student: the policy with its masks and the rounding of its weights
    head: exploration
    critic: value of an observation, in units of `scale`
    scale: standard deviation of the first iteration's returns; nan before
    rate: learning rate of the policy
    """

    def __init__(self, config: SparsePpoConfig, source: SparseConfig, policy: Policy) -> None:
        self._config, self._source = config, source
        self.student = replay_of(policy, source, config.burn_in)
        self.head: NoisyActions | CategoricalHead = (
            CategoricalHead() if policy.head == "discrete" else NoisyActions(config.noise[0])
        )
        self.critic = Critic(policy.observations, config.critic_hidden)
        self.scale = torch.tensor(torch.nan)
        self.rate = config.actor_rate
        for name, parameter in policy.named_parameters():
            parameter.requires_grad_(config.learns == "all" or name in self.student.readout)
        self._actor_adam = adam(policy, config.actor_rate)
        self._critic_adam = adam(self.critic, config.critic_rate)

    def schedule(self, progress: float) -> None:
        """Set everything that falls from the first iteration, 0, to the last, 1."""
        config = self._config
        if isinstance(self.head, NoisyActions):
            self.head.spread = _between(config.noise, progress)
        else:
            self.head.temperature = _between(config.temperature, progress)

    def exploring(self) -> Exploring:
        """Return a controller that explores, with the weights that are computed with."""
        return Exploring(self.student.acting(), self.head)

    def operations(self, pool: WalkPool) -> float:
        """Return the mean operations of a control step on new walks, and prepare their windows."""
        self.student.prepare(pool)
        found = tiles(pool, self._config.window, self._config.burn_in)
        with torch.no_grad():
            _, activities = self._replayed(found.windows)
        return self.student.operations([each[found.counts] for each in activities])

    def learn(
        self, pool: WalkPool, drawn: Tensor, earned: Sequence[Earned], actor: bool
    ) -> dict[str, float]:
        """Learn from walks, and return the metrics.

        pool: the walks of this iteration alone
        drawn: (S, W, act) or (S, W) actions as drawn
        actor: whether the policy learns, too
        """
        row = {"operations": self.operations(pool)}
        advantage = self._assess(pool, earned, row)
        if actor:
            found = tiles(pool, self._config.window, self._config.burn_in)
            self._improve(self.trials(found, drawn, advantage), row)
        return row

    @torch.no_grad()
    def trials(self, found: Tiles, drawn: Tensor, advantage: Tensor) -> Trials:
        """Return windows with drawn actions and advantages (S, W), these normalised."""
        counted = found.of(advantage)[found.counts]
        normal = (advantage - counted.mean()) / (counted.std() + _EPS)
        chosen = found.of(drawn)
        mean, _ = self._replayed(found.windows)
        before = self.log_probability(mean, chosen)
        return Trials(found.windows, chosen, found.of(normal), found.counts, before)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return log-probabilities (n, L) of drawn actions for means (n, L, act)."""
        return self.head.log_probability(mean.flatten(0, 1), drawn.flatten(0, 1)).view(
            mean.shape[:2]
        )

    def _replayed(self, windows: Windows) -> tuple[Tensor, list[Tensor]]:
        """Return means (n, L, act) and hidden activities (n, L, H) behind the burn-in."""
        burn_in = self._config.burn_in
        mean, activities = self.student.replay(windows)
        return mean[:, burn_in:], [each[:, burn_in:] for each in activities]

    def _assess(self, pool: WalkPool, earned: Sequence[Earned], row: dict[str, float]) -> Tensor:
        """Return advantages (S, W), after which the critic learns from them."""
        config, course = self._config, Course.of(earned)
        seen = [self.student.policy.normalizer(each) for each in states(pool.walks, earned)]
        if self.scale.isnan():
            zeros = [each.new_zeros(len(each)) for each in seen]
            returns = course.advantages(zeros, config.gamma, 1.0)[course.counts]
            self.scale = returns.std() + _EPS
            self.critic.value.bias.data.fill_(float(returns.mean() / self.scale))
        course = replace(course, reward=course.reward / self.scale)
        with torch.no_grad():
            values = [self.critic(each) for each in seen]
        advantage = course.advantages(values, config.gamma, config.trace)
        target = [advantage[: len(value) - 1, k] + value[:-1] for k, value in enumerate(values)]
        error = advantage[course.counts].var() / torch.cat(target).var()
        row["explained"] = 1.0 - float(error)
        row["critic_loss"] = self._fit(torch.cat([each[:-1] for each in seen]), torch.cat(target))
        return advantage

    def _fit(self, seen: Tensor, target: Tensor) -> float:
        """Let the critic learn targets (N,) of states (N, obs); return the last pass's error."""
        config = self._config
        for _ in range(config.critic_epochs):
            parts = torch.randperm(len(seen)).tensor_split(max(1, len(seen) // config.critic_batch))
            losses = []
            for chosen in parts:
                loss = functional.mse_loss(self.critic(seen[chosen]), target[chosen])
                descend(self._critic_adam, self.critic, loss, config.gradient_norm)
                losses.append(float(loss.detach()))
        return sum(losses) / len(losses)

    def _improve(self, trials: Trials, row: dict[str, float]) -> None:
        """Pass over the windows until the divergence limit; add the mean metrics to the row."""
        rows: list[dict[str, float]] = []
        limit = 2 * self._config.target_kl
        for _ in range(self._config.epochs):
            newest = [self._update(part) for part in trials.minibatches(self._config.batch)]
            rows += newest
            divergence = newest[-1]["kl"]
            if divergence < limit / 4:
                self.rate = min(self.rate * _FASTER, _RATES[1])
            elif divergence > limit:
                self.rate = max(self.rate / _FASTER, _RATES[0])
                break
        row |= {name: sum(each[name] for each in rows) / len(rows) for name in rows[0]}
        row |= {"kl": rows[-1]["kl"], "learning_rate": self.rate}

    def _update(self, part: Trials) -> dict[str, float]:
        """Take one gradient step of the policy."""
        config, policy = self._config, self.student.policy
        for group in self._actor_adam.param_groups:
            group["lr"] = self.rate
        mean, activities = self._replayed(part.windows)
        change = (self.log_probability(mean, part.drawn) - part.before)[part.counts]
        ratio, advantage = change.exp(), part.advantage[part.counts]
        limited = ratio.clamp(1.0 - config.clip, 1.0 + config.clip)
        # L = -E[min(ratio A, clip(ratio) A)] + imitation E + penalty sum(rate fan-out) / budget
        gain = torch.min(ratio * advantage, limited * advantage).mean()
        label = part.windows.label[:, config.burn_in :]
        error = imitation(mean, label, policy, self._source.sharpness)[part.counts].mean()
        hidden = self.student.hidden([each[part.counts] for each in activities])
        budget = max(self._source.budget, self._source.penalty_floor)
        loss = -gain + config.imitation * error + config.penalty * hidden / budget
        descend(self._actor_adam, policy, loss, config.gradient_norm)
        with torch.no_grad():
            return {
                "gain": float(gain),
                "imitation": float(error),
                # (r - 1) - log r is never negative, and its mean is the divergence
                "kl": float((ratio - 1.0 - change).mean()),
                "clipped": float((ratio != limited).float().mean()),
            }

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name."""
        parts: dict[str, Mapping[str, Tensor]] = {
            "critic": self.critic.state_dict(),
            "actor_adam": adam_tensors(self._actor_adam),
            "critic_adam": adam_tensors(self._critic_adam),
        }
        named = {f"{part}.{key}": t for part, found in parts.items() for key, t in found.items()}
        rate = torch.tensor(self.rate, dtype=torch.float64)
        return {**named, "scale": self.scale, "rate": rate}

    def load(self, named: dict[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        self.student.policy.load_state_dict(under("policy", named))
        self.critic.load_state_dict(under("critic", named))
        load_adam(self._actor_adam, under("actor_adam", named))
        load_adam(self._critic_adam, under("critic_adam", named))
        self.scale, self.rate = named["scale"], float(named["rate"])


def _between(ends: tuple[float, float], progress: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * progress


# -- PPO after imitation: a pruned policy learns from reward, with its masks as they are.

_TRAINING_SEEDS = 5_000  # validation and evaluation are above


class SparsePpo(Runner[SparsePpoConfig]):
    """One run.

    iterations, env_steps: counters, continued by a resumed run
    start_return, allowed: mean validation return of the policy at the start, and the operations of
        a control step that the best may take
    """

    Config = SparsePpoConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "iterations", "env_steps", "operations", "gain", "imitation", "kl", "clipped",
        "learning_rate", "critic_loss", "explained", "iterations_per_s", "episode_return",
        "eval_return", "eval_gain", "eval_operations", "eval_falls", "eval_finish",
    )  # fmt: skip
    COUNTERS = ("iterations", "env_steps", "start_return", "allowed", "best")
    SPEED = "iterations_per_s"
    learner: SparsePpoLearner

    @classmethod
    def columns(cls, config: SparsePpoConfig) -> tuple[str, ...]:  # type: ignore[override]
        """Return the names of the metrics, of which the first is the step."""
        return cls.COLUMNS

    def __init__(self, config: SparsePpoConfig, run: RunFolder) -> None:
        runs = run.path.parent
        start, source, self.policy = starting_point(config, runs)
        # the folder says which policy is in it, and can be moved with its start
        more = {"policy": source.policy, "start": stored_start(start, runs)}
        config = config.model_copy(update=more)
        run.write_config(config)
        super().__init__(
            config,
            run,
            total=config.iterations,
            log_every=1,
            checkpoint_every=config.checkpoint_every,
        )
        self._source = source
        self._teacher = teacher(
            source.teacher, config.env.name, source.env.options, source.teacher_units
        )
        self._chip = chip(source.chip)
        count = max(config.episodes, config.validation.episodes)
        self._episodes = Episodes(config.env, count, config.validation.limit)
        self.learner = SparsePpoLearner(config, source, self.policy)
        self.iterations = self.env_steps = 0
        self.start_return = self.allowed = math.nan
        self._learned: dict[str, float] = {}
        self._first: dict[str, float] = {}

    def _begin(self) -> None:
        """Validate the policy at the start: the first candidate."""
        self._first = {**self._evaluate(), "eval_gain": 0.0}
        self.start_return = self.best = self._first["eval_return"]
        of_start = max(self._source.budget, self._first["eval_operations"])
        self.allowed = self._config.budget or of_start
        self._run.save("best", self._deployed(), {**self._counters(), **self._first})

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        config, learner = self._config, self.learner
        learner.schedule(self.iterations / max(self._total - 1, 1))
        learner.student.round(self._chip)
        controller = learner.exploring()
        seeds = self._rng.integers(_TRAINING_SEEDS, size=config.episodes).tolist()
        walks, returns, _ = self._episodes.play(seeds, controller, self._teacher.act_all)
        self._returns += returns
        pool = WalkPool()
        pool.add(walks)
        self._learned = learner.learn(
            pool,
            torch.stack(controller.drawn),
            self._episodes.earned,
            actor=self.iterations >= config.warm_up,
        )
        self.env_steps += pool.steps
        self.iterations += 1
        return True

    def _deployed(self) -> Policy:
        return deployed(self.policy, self._chip, self._source.rounding)

    def _evaluate(self) -> dict[str, float]:
        first = self._config.validation.first_seed
        seeds = range(first, first + self._config.validation.episodes)
        controller = on_chip(self._deployed(), self._chip)
        walks, returns, infos = self._episodes.play(seeds, controller, self._teacher.act_all)
        pool = WalkPool()
        pool.add(walks)
        row = {
            "eval_return": float(np.mean(returns)),
            "eval_operations": self.learner.operations(pool),
        }
        row["eval_gain"] = row["eval_return"] - self.start_return
        for key, column in (("fall", "eval_falls"), ("finish", "eval_finish")):
            if key in infos[0]:
                row[column] = float(np.mean([info[key] for info in infos]))
        return row

    def _validate(self) -> dict[str, float]:
        """Validate the policy, and save it as "best" if it is, within the operations allowed."""
        row = self._evaluate()
        if row["eval_return"] > self.best and row["eval_operations"] <= self.allowed:
            self.best = row["eval_return"]
            self._run.save("best", self._deployed(), {**self._counters(), **row})
        return row

    def _report(self, journal: Any, before: int) -> None:  # noqa: ANN401
        if self._first:
            journal.add({"iterations": 0, "env_steps": 0, **self._first})
            self._first = {}
        super()._report(journal, before)

    def _metrics(self) -> dict[str, float]:
        return {"iterations": self.iterations, "env_steps": self.env_steps, **self._learned}

    def _state(self) -> dict[str, Any]:
        return {"first": self._first}

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        self.iterations, self.env_steps = state["iterations"], state["env_steps"]
        self.start_return, self.allowed = state["start_return"], state["allowed"]
        self._first = state.get("first", {})  # its row, where a stop came before the first report
