"""PPO after imitation: a pruned policy learns from reward, with its masks as they are.

Each iteration plays whole episodes with exploration and the chip's rounded weights, replays them in
windows, and takes a few clipped steps (Schulman et al. 2017). The error against the teacher and the
penalty on operations stay in the loss. The policy at the start is the first that is validated, so
that the best is never worse on the validation seeds.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, model_validator
from torch import Tensor
from torch.nn import functional
from torch.nn.utils.rnn import pad_sequence

from spikedeploy.runtime.chips.chip import chip
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
from spikedeploy.trainers.env_batch import TRAINING_SEEDS
from spikedeploy.trainers.metrics_file import Journal
from spikedeploy.trainers.policies import Policy
from spikedeploy.trainers.ppo import CategoricalHead, advantages, clipped_gain, means, minibatches
from spikedeploy.trainers.run_folder import LEVEL, RunFolder
from spikedeploy.trainers.runner import (
    Critic,
    Learner,
    Runner,
    adam,
    descend,
    mean_outcome,
    set_rate,
)
from spikedeploy.trainers.sparse.batch_controllers import FloatController, controller_of
from spikedeploy.trainers.sparse.pruning import operations
from spikedeploy.trainers.sparse.settings import SparseConfig
from spikedeploy.trainers.sparse.student import DeltaStudent, imitation, student
from spikedeploy.trainers.sparse.walks import Episodes, Walk, WalkPool, Windows

Ends = tuple[Rate, Rate]
_EPS = 1e-8
_FASTER, _RATES = 1.5, (1e-6, 1e-2)  # factor by which the learning rate changes, and its limits


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


# -- the run that PPO goes on from


def find_start(start: str, runs: Path) -> RunFolder:
    """Return the run that `start` of a run in the folder `runs` names.

    Where its path has gone, a folder of that name beside the run is taken, so that both can be
    moved together.
    """
    for path in (runs / start, runs / Path(start).name):
        if (path / "config.json").is_file():
            return RunFolder(path)
    return RunFolder.find(start)


def starting_point(config: SparsePpoConfig, runs: Path) -> tuple[RunFolder, SparseConfig, Policy]:
    """Return the run to start from, its configuration with the budget of the policy, the policy."""
    if not config.start:
        raise ConfigError(
            f"{config.recipe} needs a finished run: --set start=RUN, where RUN is the run folder "
            "of a sparse recipe for the same task"
        )
    run, level = find_start(config.start, runs), config.start_checkpoint
    if (found := run.settings()["algorithm"]) != "sparse":
        raise ConfigError(f"start: {config.start} is a run of {found}, not of a sparse recipe")
    source = run.config(SparseConfig)
    if source.env.name != config.env.name:
        raise ConfigError(
            f"start: {config.start} was trained in {source.env.name}, not in {config.env.name}"
        )
    if not run.checkpoint(level).is_file():
        raise ConfigError(
            f"start_checkpoint: {config.start} has no policy {level!r} yet; of its levels it has "
            f"{', '.join(run.levels.values()) or 'none'}"
        )
    if level.startswith(LEVEL):
        source = source.model_copy(update={"budget": float(level.removeprefix(LEVEL))})
    return run, source, run.policy(level)


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
    SPEED, RATES = "iterations_per_s", False
    learner: "SparsePpoLearner"

    def __init__(self, config: SparsePpoConfig, run: RunFolder) -> None:
        runs = run.path.parent
        start, source, self.policy = starting_point(config, runs)
        # the folder says which policy is in it
        more = {"policy": source.policy, "start": str(start.path.resolve())}
        config = config.model_copy(update=more)
        super().__init__(config, run, config.iterations, config.checkpoint_every)
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
        self._first: dict[str, float] = {}  # row of the policy at the start, until it is reported

    def _begin(self) -> None:
        """Validate the policy at the start: the first candidate."""
        self._first = {**self._evaluate(), "eval_gain": 0.0}
        self.start_return = self.best = self._first["eval_return"]
        of_start = max(self._source.budget, self._first["eval_operations"])
        self.allowed = self.config.budget or of_start
        self._checkpoint()  # before "best", so that a run that is killed here can be resumed
        self._save_best(self.learner.student.deployed(self._chip), self._first)

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        config, learner = self.config, self.learner
        learner.schedule(self.iterations / max(self._total - 1, 1))
        learner.student.round(self._chip)
        controller = Exploring(learner.student.acting(), learner.head)
        seeds = self._rng.integers(TRAINING_SEEDS, size=config.episodes).tolist()
        walks, returns, _ = self._episodes.play(seeds, controller, self._teacher.act_all)
        self._returns += returns
        pool, drawn = WalkPool(walks), torch.stack(controller.drawn)
        self._learned = learner.learn(pool, drawn, actor=self.iterations >= config.warm_up)
        self.env_steps += pool.steps
        self.iterations += 1
        return True

    def _evaluate(self) -> dict[str, float]:
        controller = controller_of(self.learner.student.deployed(self._chip), self._chip)
        _, returns, infos = self._episodes.play(self.config.validation.seeds, controller)
        row = mean_outcome(returns, infos)
        return row | {
            "eval_operations": controller.operations(self._episodes.lengths),
            "eval_gain": row["eval_return"] - self.start_return,
        }

    def _validate(self) -> dict[str, float]:
        """Validate the policy, and save it as "best" if it is, within the operations allowed."""
        row = self._evaluate()
        if row["eval_return"] > self.best and row["eval_operations"] <= self.allowed:
            self._save_best(self.learner.student.deployed(self._chip), row)
        return row

    def _report(self, journal: Journal, before: int) -> None:
        if self._first:
            journal.add({"iterations": 0, "env_steps": 0, **self._first})
            self._first = {}
        super()._report(journal, before)

    def _metrics(self) -> dict[str, float]:
        return self._learned

    def _state(self) -> dict[str, Any]:
        return {"first": self._first}

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        self._first = state["first"]
        if self._first and not self._run.checkpoint("best").is_file():  # killed before it was saved
            self._save_best(self.learner.student.deployed(self._chip), self._first)


# -- exploration around a policy whose states live on from one control step to the next


class NoisyActions:
    """Gaussian around the deterministic action tanh(mean), executed within [-1, 1].

    std: standard deviation [action]
    """

    def __init__(self, std: float) -> None:
        self.std = std

    def draw(self, mean: Tensor) -> Tensor:
        """Return actions (B, act) drawn around those of the means (B, act), before clipping."""
        return torch.tanh(mean) + self.std * torch.randn_like(mean)

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return the log-probability (B,) of drawn actions, but for a constant."""
        # log p = -1/2 sum ((a - tanh(mean)) / std)^2 ; the same std for all of an iteration
        return -0.5 * ((drawn - torch.tanh(mean)) / self.std).square().sum(-1)

    def action(self, drawn: Tensor) -> Tensor:
        """Return the action of the environment (B, act) in [-1, 1]."""
        return drawn.clamp(-1.0, 1.0).double()


class Exploring(FloatController):
    """A policy that explores, as a BatchController.

    drawn: what was drawn in every control step of the episodes, (B, act) or (B,) each
    """

    def __init__(self, policy: Policy, head: NoisyActions | CategoricalHead) -> None:
        super().__init__(policy)
        self._head = head

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        super().reset(robots)
        self.drawn: list[Tensor] = []

    def act_batch(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """Return actions (B, act), or (B,) if discrete."""
        self.drawn.append(self._head.draw(self.mean(observation)))
        return self._head.action(self.drawn[-1]).numpy()


# -- walks that explored, cut into windows with advantages


@dataclass(frozen=True)
class Trials(Windows):
    """Windows of walks, n of them, with L control steps each behind the burn-in.

    drawn: (n, L, act) or (n, L) actions as drawn
    advantage: (n, L)
    counts: (n, L) whether the step is part of the walk, and not behind its end
    before: (n, L) log-probability of what was drawn, by the policy that is learned from
    """

    drawn: Tensor
    advantage: Tensor
    counts: Tensor
    before: Tensor


@dataclass(frozen=True)
class Tiles:
    """Windows that cover every control step of W walks once behind their burn-in.

    windows: windows of all walks, one walk after another
    at, row: (n, L) and (n, 1) control step and walk of each step behind the burn-in
    counts: (n, L) whether the step is part of the walk
    """

    windows: Windows
    at: Tensor
    row: Tensor
    counts: Tensor

    def gather(self, steps: Tensor) -> Tensor:
        """Return an array (S, W, ...) of all walks as (n, L, ...)."""
        return steps[self.at, self.row]


def cut_tiles(pool: WalkPool, window: int, burn_in: int) -> Tiles:
    """Return the windows of a pool whose walks are encoded."""
    stride = window - burn_in
    lengths = np.array([len(walk.label) for walk in pool.walks])
    begins = [np.arange(0, length, stride) for length in lengths]
    which = np.repeat(np.arange(len(lengths)), [len(each) for each in begins])
    first = np.concatenate(begins)
    steps = first[:, None] + np.arange(stride)
    return Tiles(
        pool.windows(which, first - burn_in, window),
        torch.from_numpy(np.minimum(steps, lengths.max() - 1)),
        torch.from_numpy(which)[:, None],
        torch.from_numpy(steps < lengths[which][:, None]),
    )


def walk_advantages(
    walks: Sequence[Walk],
    values: Sequence[Tensor],
    gamma: float,
    trace: float,
    scale: Tensor | float = 1.0,
) -> tuple[Tensor, Tensor]:
    """Return advantages (S, W) of W walks, zeros behind their ends, and which steps are of a walk.

    values: (S_k + 1,) of each walk, that of its end included
    scale: divisor of the rewards
    """
    reward = pad_sequence([torch.from_numpy(walk.reward) for walk in walks])
    lengths = torch.tensor([len(walk.reward) for walk in walks])
    step = torch.arange(len(reward))[:, None]
    ended = step == lengths - 1
    terminated = ended & torch.tensor([walk.terminated for walk in walks])
    value, following = (
        pad_sequence(list(each))
        for each in zip(*((value[:-1], value[1:]) for value in values), strict=True)
    )
    found = advantages(reward / scale, value, following, terminated, ended, gamma, trace)
    return found, step < lengths


class SparsePpoLearner(Learner):
    """A pruned policy with its exploration, and a critic.

    student: the policy with its masks and the rounding of its weights
    head: exploration
    critic: value of an observation, in units of `scale`
    scale: standard deviation of the first iteration's returns; nan before
    rate: learning rate of the policy
    """

    def __init__(self, config: SparsePpoConfig, source: SparseConfig, policy: Policy) -> None:
        self._config, self._source, self.policy = config, source, policy
        found = student(policy, source)
        if isinstance(found, DeltaStudent):
            found.each_pass = False  # ratios and divergences follow small changes of weights
        self.student = found
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
        self.modules = {"critic": self.critic}
        self.optimizers = {"actor_adam": self._actor_adam, "critic_adam": self._critic_adam}

    def schedule(self, progress: float) -> None:
        """Set everything that falls from the first iteration, 0, to the last, 1."""
        if isinstance(self.head, CategoricalHead):
            self.head.temperature = _between(self._config.temperature, progress)
        else:
            self.head.std = _between(self._config.noise, progress)

    def learn(self, pool: WalkPool, drawn: Tensor, actor: bool) -> dict[str, float]:
        """Learn from walks, and return the metrics.

        pool: the walks of this iteration alone
        drawn: (S, W, act) or (S, W) actions as drawn
        actor: whether the policy learns, too
        """
        found, mean = self.replay(pool)
        row = {"operations": operations(self.student.synapses())}
        advantage = self._assess(pool, row)
        if actor:
            row |= self._improve(self.trials(found, mean, drawn, advantage))
        return row

    @torch.no_grad()
    def replay(self, pool: WalkPool) -> tuple[Tiles, Tensor]:
        """Return windows of new walks, and means (n, L, act) in them; take over their rates."""
        self.student.prepare(pool)
        found = cut_tiles(pool, self._config.window, self._config.burn_in)
        mean, activities = self._replayed(found.windows)
        self.student.adopt_rates([each[found.counts] for each in activities])
        return found, mean

    @torch.no_grad()
    def trials(self, found: Tiles, mean: Tensor, drawn: Tensor, advantage: Tensor) -> Trials:
        """Return windows with drawn actions and advantages (S, W), these normalised."""
        counted = found.gather(advantage)[found.counts]
        normal = (advantage - counted.mean()) / (counted.std() + _EPS)
        chosen = found.gather(drawn)
        before = self.log_probability(mean, chosen)
        return Trials(**vars(found.windows), drawn=chosen, advantage=found.gather(normal),
                      counts=found.counts, before=before)  # fmt: skip

    def log_probability(self, mean: Tensor, drawn: Tensor) -> Tensor:
        """Return log-probabilities (n, L) of drawn actions for means (n, L, act)."""
        flat = self.head.log_probability(mean.flatten(0, 1), drawn.flatten(0, 1))
        return flat.view(mean.shape[:2])

    def _replayed(self, windows: Windows) -> tuple[Tensor, list[Tensor]]:
        """Return means (n, L, act) and hidden activities (n, L, H) behind the burn-in."""
        burn_in = self._config.burn_in
        mean, activities = self.student.replay(windows, burn_in)
        return mean[:, burn_in:], [each[:, burn_in:] for each in activities]

    def _assess(self, pool: WalkPool, row: dict[str, float]) -> Tensor:
        """Return advantages (S, W), after which the critic learns from them."""
        config = self._config
        seen = [  # (S + 1, obs) of each walk, the observation after its last step included
            self.policy.normalizer(
                torch.from_numpy(np.concatenate([walk.observation, walk.final[None]]))
            )
            for walk in pool.walks
        ]
        if self.scale.isnan():
            zeros = [each.new_zeros(len(each)) for each in seen]
            found, counts = walk_advantages(pool.walks, zeros, config.gamma, 1.0)
            returns = found[counts]
            self.scale = returns.std() + _EPS
            self.critic.value.bias.data.fill_(float(returns.mean() / self.scale))
        with torch.no_grad():
            values = [self.critic(each) for each in seen]
        advantage, counts = walk_advantages(
            pool.walks, values, config.gamma, config.trace, self.scale
        )
        target = [advantage[: len(value) - 1, k] + value[:-1] for k, value in enumerate(values)]
        error = advantage[counts].var() / torch.cat(target).var()
        row["explained"] = 1.0 - float(error)
        row["critic_loss"] = self._fit(torch.cat([each[:-1] for each in seen]), torch.cat(target))
        return advantage

    def _fit(self, seen: Tensor, target: Tensor) -> float:
        """Train the critic on targets (N,) of states (N, obs); return the last pass's error."""
        config = self._config
        for _ in range(config.critic_epochs):
            parts = torch.randperm(len(seen)).tensor_split(max(1, len(seen) // config.critic_batch))
            losses = []
            for chosen in parts:
                loss = functional.mse_loss(self.critic(seen[chosen]), target[chosen])
                descend(self._critic_adam, self.critic, loss, config.gradient_norm)
                losses.append(float(loss.detach()))
        return sum(losses) / len(losses)

    def _improve(self, trials: Trials) -> dict[str, float]:
        """Pass over the windows until the divergence limit; return the mean metrics."""
        found: list[dict[str, float]] = []
        limit = 2 * self._config.target_kl
        for _ in range(self._config.epochs):
            count = round(len(trials.drawn) / self._config.batch)
            found += [self._update(part) for part in minibatches(trials, count)]
            divergence = found[-1]["kl"]
            if divergence < limit / 4:
                self.rate = min(self.rate * _FASTER, _RATES[1])
            elif divergence > limit:
                self.rate = max(self.rate / _FASTER, _RATES[0])
                break
        return means(found) | {"kl": found[-1]["kl"], "learning_rate": self.rate}

    def _update(self, part: Trials) -> dict[str, float]:
        """Take one gradient step of the policy."""
        config = self._config
        set_rate(self._actor_adam, self.rate)
        mean, activities = self._replayed(part)
        change = (self.log_probability(mean, part.drawn) - part.before)[part.counts]
        gain, row = clipped_gain(change, part.advantage[part.counts], config.clip)
        label, sharpness = part.label[:, config.burn_in :], self._source.sharpness
        error = imitation(mean, label, self.policy, sharpness)[part.counts].mean()
        hidden = self.student.hidden_operations([each[part.counts] for each in activities])
        budget = max(self._source.budget, self._source.penalty_floor)
        # L = -gain + imitation E + penalty sum(rate fan-out) / budget
        loss = -gain + config.imitation * error + config.penalty * hidden / budget
        descend(self._actor_adam, self.policy, loss, config.gradient_norm)
        return {"gain": float(gain.detach()), "imitation": float(error.detach()), **row}

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name."""
        rate = torch.tensor(self.rate, dtype=torch.float64)
        return {**super().tensors(), "scale": self.scale, "rate": rate}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        super().load(named)
        self.scale, self.rate = named["scale"], float(named["rate"])


def _between(ends: Ends, progress: float) -> float:
    """Return what falls from the first end to the last."""
    first, last = ends
    return first + (last - first) * progress
