"""Distillation by DAgger: a student learns what its teacher would do in the student's own states.

Iteration 0 collects states under the teacher's actions, later ones under the student's, so that the
student learns to recover from its own mistakes. The teacher labels all states, and the student
learns from all that were collected so far (Ross et al. 2011).
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from spikedeploy.trainers.config import (
    Batch,
    Kept,
    NormaliserConfig,
    Positive,
    Rate,
    RunConfig,
    Share,
    ValidationConfig,
)
from spikedeploy.trainers.distill.teacher import FloatArray, Teacher, compute_cross_entropy
from spikedeploy.trainers.distill.teachers import policy_teacher, score, teacher
from spikedeploy.trainers.env_batch import EnvBatch
from spikedeploy.trainers.policies import Policy, PopsanPolicy, from_config
from spikedeploy.trainers.policies.policy import Moments
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.runner import Learner, Runner, adam, set_rate
from spikedeploy.trainers.surrogate_neurons import excess_rate, firing_rates, mean_rate


class DistillConfig(RunConfig):
    """Imitation of a teacher by DAgger (Ross et al. 2011).

    teacher: policy to imitate: a run folder, an .onnx, .nir or Stable-Baselines3 .zip file, or
        my_module:function (docs/own-teacher.md)
    teacher_units: units of the actions of functions and of .onnx files of other programs: "own"
        units of the environment, which is the default, or "scaled" to [-1, 1]
    iterations: number of times that states are collected, first with the teacher's own actions
    states: environment steps of each iteration, of all copies together
    updates: gradient updates in total, spread evenly over the iterations; `validation.every`,
        `log_every` and `checkpoint_every` count them
    mixing: share of the teacher's actions in collection, mixing ** k in iteration k
    noise: standard deviation of Gaussian noise on the executed actions, so that states cover more
        than one trajectory; labels are without it. Of discrete actions the share drawn at random
    sharpness: factor of the teacher's logits in the targets of discrete actions
    learning_rate: initial value, annealed to zero by a half cosine
    rate_penalty, rate_target: weight and threshold of the hinge on the mean firing rate of every
        spiking layer [spikes per neuron and timestep]; no effect on an MLP
    input_penalty, input_target: the same for the encoder's neurons, whose spikes cause the most
        synaptic operations
    """

    normaliser: NormaliserConfig = NormaliserConfig(finish=8_000)
    validation: ValidationConfig = ValidationConfig(every=500, episodes=8)
    teacher: str = ""
    teacher_units: Literal["own", "scaled"] | None = None
    iterations: Positive = 6
    states: Kept = 8_000
    updates: Positive = 6_000
    mixing: Share = 0.0
    noise: float = Field(default=0.0, ge=0)
    sharpness: Rate = 1.0
    batch: Batch = 256
    learning_rate: Rate = 1e-3
    rate_penalty: float = Field(default=0.1, ge=0)
    rate_target: Share = 0.13
    input_penalty: float = Field(default=0.1, ge=0)
    input_target: Share = 0.13
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    log_every: Positive = 100
    checkpoint_every: Positive = 1_000


class DaggerDataset:
    """A growing set of labelled states, in float32.

    observation: (n, obs) raw
    action: (n, act) of the teacher, or its logits
    """

    def __init__(self, observations: int, actions: int) -> None:
        self.observation = torch.zeros(0, observations)
        self.action = torch.zeros(0, actions)

    def __len__(self) -> int:
        return len(self.observation)

    def add(self, observation: NDArray[np.float64], action: NDArray[np.float64]) -> None:
        """Add states (B, obs) with their labels (B, act)."""
        self.observation = torch.cat([self.observation, torch.from_numpy(observation).float()])
        self.action = torch.cat([self.action, torch.from_numpy(action).float()])

    def sample(self, count: int, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Return states and labels drawn uniformly with replacement."""
        rows = torch.from_numpy(rng.integers(len(self), size=count))
        return self.observation[rows], self.action[rows]

    def tensors(self) -> dict[str, Tensor]:
        """Return everything by name, for a checkpoint."""
        return {"lessons.observation": self.observation, "lessons.action": self.action}

    def load(self, tensors: Mapping[str, Tensor]) -> None:
        """Restore the dataset of a checkpoint."""
        self.observation = tensors["lessons.observation"]
        self.action = tensors["lessons.action"]


def iteration_envs(config: DistillConfig, iteration: int) -> EnvBatch:
    """Return the environments of an iteration, the same ones for a run resumed there."""
    return EnvBatch(config.env, np.random.default_rng((config.seed, iteration)))


def collect(
    config: DistillConfig,
    iteration: int,
    teacher: Teacher,
    student: Teacher,
    stopped: Callable[[], bool],
) -> tuple[FloatArray, FloatArray, list[float]] | None:
    """Collect the states of an iteration; None if stopped before its end.

    Returns observations (n, obs), labels (n, act), and the returns of the episodes that ended.
    """
    envs = iteration_envs(config, iteration)
    teacher = teacher.in_envs(envs.worlds)
    visited: list[FloatArray] = []
    labels: list[FloatArray] = []
    rng = np.random.default_rng((config.seed, iteration, 1))
    share = config.mixing**iteration  # of the teacher's actions; 1 in iteration 0
    while len(visited) * len(envs) < config.states:
        if stopped():
            return None
        visited.append(envs.observation)
        labels.append(teacher.act_all(envs.observation))
        taught = rng.random(len(envs)) < share
        action = labels[-1] if taught.all() else student.act_all(envs.observation)
        action = np.where(taught[:, None], labels[-1], action)
        if envs.head == "discrete":  # the choices of logits, some of them drawn
            drawn = rng.integers(action.shape[1], size=len(action))
            chosen = np.where(rng.random(len(action)) < config.noise, drawn, action.argmax(-1))
            envs.step(chosen)
        else:
            noise = config.noise * rng.standard_normal(action.shape)
            envs.step(np.clip(action + noise, -1.0, 1.0))
    return np.concatenate(visited), np.concatenate(labels), envs.returns


class Distill(Runner[DistillConfig]):
    """One run of distillation.

    updates, iterations: counters, continued by a resumed run
    dataset: all labelled states so far
    teacher_return: mean return of the teacher on the validation seeds
    """

    Config = DistillConfig
    COLUMNS: ClassVar[tuple[str, ...]] = (
        "updates", "env_steps", "iteration", "loss", "rate_penalty", "updates_per_s",
        "episode_return", "eval_return", "eval_of_teacher", "eval_speed", "eval_cot", "eval_falls",
        "eval_speed_rmse", "eval_turn_rmse",
    )  # fmt: skip
    COUNTERS = ("updates", "env_steps", "iterations", "teacher_return", "best")
    SPEED = "updates_per_s"
    learner: "DistillLearner"

    def __init__(self, config: DistillConfig, run: RunFolder) -> None:
        super().__init__(config, run, config.updates, config.checkpoint_every, config.log_every)
        self._teacher = teacher(
            config.teacher, config.env.name, config.env.options, config.teacher_units
        )
        envs = iteration_envs(config, 0)
        sizes = envs.sizes
        self._teacher.check_sizes(config.teacher, config.env.name, sizes)
        self.policy = from_config(config.policy, *sizes, config.normaliser.clip, envs.head)
        self.learner = DistillLearner(config, self.policy)
        self.dataset = DaggerDataset(*sizes)
        self.updates = self.iterations = 0
        self.teacher_return = np.nan
        self._losses: Mapping[str, Tensor] = {}

    @property
    def env_steps(self) -> int:
        """Environment steps so far, each of which has become a labelled state."""
        return len(self.dataset)

    def _begin(self) -> None:
        self.teacher_return = score(self._teacher, self.config.env, self.config.validation)

    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        config = self.config
        # the updates for the iterations collected so far are done
        due = self.iterations <= self.updates * config.iterations // config.updates
        if due and not self._collect(stopped):
            return False
        observation, label = self.dataset.sample(config.batch, self._rng)
        self._losses = self.learner.update(observation, label, self.updates / config.updates)
        self.updates += 1
        return True

    def _collect(self, stopped: Callable[[], bool]) -> bool:
        """Collect the labelled states of an iteration; return whether it was not stopped."""
        student = policy_teacher(self.policy)
        found = collect(self.config, self.iterations, self._teacher, student, stopped)
        if found is None:
            return False
        observation, label, self._returns = found
        self.dataset.add(observation, label)
        self.iterations += 1
        if self.iterations == 1 or self.env_steps <= self.config.normaliser.finish:
            seen = self.dataset.observation.double().numpy()
            self.policy.normalizer.adopt(Moments.from_batch(seen))
        return True

    def _evaluate(self) -> dict[str, float]:
        row = super()._evaluate()
        row["eval_of_teacher"] = row["eval_return"] / self.teacher_return
        return row

    def _metrics(self) -> dict[str, float]:
        losses = {name: float(loss) for name, loss in self._losses.items()}
        return {"iteration": self.iterations - 1, **losses}

    def _tensors(self) -> dict[str, Tensor]:
        return self.dataset.tensors()

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        self.dataset.load(tensors)


class DistillLearner(Learner):
    """A student, and gradient updates of it towards its teacher.

    policy: the student
    """

    def __init__(self, config: DistillConfig, policy: Policy) -> None:
        self._config, self.policy, self.modules = config, policy, {}
        self.optimizers = {"adam": adam(policy, config.learning_rate)}

    def update(self, observation: Tensor, label: Tensor, progress: float) -> dict[str, Tensor]:
        """Take one gradient step towards labels (B, act) at a `progress` from 0 to 1.

        label: the teacher's actions, or its logits of discrete ones
        """
        # lr = lr_0 (1 + cos(pi progress)) / 2
        optimizer = self.optimizers["adam"]
        set_rate(optimizer, self._config.learning_rate * 0.5 * (1 + math.cos(math.pi * progress)))
        found, penalty = self._act(observation)
        if self.policy.head == "discrete":
            error = compute_cross_entropy(found, label, self._config.sharpness).mean()
        else:
            error = (found - label).square().mean()
        optimizer.zero_grad()
        (error + penalty).backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        return {"loss": error.detach(), "rate_penalty": penalty.detach()}

    def _act(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return the student's actions or logits (B, act), and the penalty of its firing rates."""
        enabled = self._config.precision == "bfloat16"
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled):
            if not isinstance(self.policy, PopsanPolicy):
                latent = self.policy.latent(observation)
                discrete = self.policy.head == "discrete"
                found = latent.mean if discrete else self.policy.decide(latent.mean)
                return found, self._penalty((), latent.rates)
            spikes = self.policy.spikes(observation)
            action = torch.tanh(self.policy.decode(firing_rates(spikes[-1])))
        encoder, *layers = (mean_rate(raster) for raster in spikes)
        return action, self._penalty([encoder], layers)

    def _penalty(self, encoders: Iterable[Tensor], layers: Iterable[Tensor]) -> Tensor:
        """Return the penalty of mean firing rates above their targets."""
        config = self._config
        inputs = config.input_penalty * excess_rate(encoders, config.input_target)
        return inputs + config.rate_penalty * excess_rate(layers, config.rate_target)
