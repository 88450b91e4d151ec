"""The base of all algorithms: training loop, validation, resuming; networks and optimisers."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Generic

import numpy as np
import torch
from torch import Tensor, nn

from spikedeploy import envs
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import flush
from spikedeploy.trainers.config import (
    C,
    EnvConfig,
    RunConfig,
    ValidationConfig,
    spiking_layers,
)
from spikedeploy.trainers.env_batch import EnvBatch
from spikedeploy.trainers.metrics_file import Journal
from spikedeploy.trainers.policies import Policy
from spikedeploy.trainers.policies.policy import Moments, full_precision
from spikedeploy.trainers.run_folder import RunFolder, with_prefix

# info of the environment -> metric: mean over steps, root mean square, and value at the end
_MEANS = {"speed": "eval_speed"}
_SQUARES = {"speed_error": "eval_speed_rmse", "turn_error": "eval_turn_rmse"}
_LASTS = {
    "cot": "eval_cot",
    "fall": "eval_falls",
    "finish": "eval_finish",
    "crash": "eval_crash",
    "gates": "eval_gates",
    "success": "eval_success",
    "misstep_share": "eval_missteps",
}


class Learner:
    """Networks and optimisers of an algorithm, which its checkpoints hold.

    policy: what is validated and saved
    modules, optimizers: by their names in checkpoints, the policy left out
    """

    policy: Policy
    modules: dict[str, nn.Module]
    optimizers: dict[str, torch.optim.Adam]

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors of a checkpoint except the policy's, by name."""
        groups: dict[str, Mapping[str, Tensor]] = {}
        groups |= {name: module.state_dict() for name, module in self.modules.items()}
        for name, optimizer in self.optimizers.items():  # nothing before its first step
            states = optimizer.state_dict()["state"].items()
            groups[name] = {f"{n}.{key}": t for n, state in states for key, t in state.items()}
        return {f"{name}.{key}": t for name, group in groups.items() for key, t in group.items()}

    def load(self, named: Mapping[str, Tensor]) -> None:
        """Restore the tensors of a checkpoint, the policy's under "policy." included."""
        self.policy.load_state_dict(with_prefix("policy", named))
        for name, module in self.modules.items():
            module.load_state_dict(with_prefix(name, named))
        for name, optimizer in self.optimizers.items():
            state: dict[int, dict[str, Tensor]] = {}
            for place, value in with_prefix(name, named).items():
                index, key = place.split(".")
                state.setdefault(int(index), {})[key] = value
            optimizer.load_state_dict({**optimizer.state_dict(), "state": state})


def adam(module: nn.Module, learning_rate: float) -> torch.optim.Adam:
    """Return Adam for a module's parameters (Kingma and Ba 2015)."""
    parameters = list(module.parameters())
    # the fused implementation is four times as fast as the others on one core
    return torch.optim.Adam(parameters, lr=learning_rate, fused=True)


def set_rate(optimizer: torch.optim.Adam, learning_rate: float) -> None:
    """Set the learning rate of all parameters."""
    for group in optimizer.param_groups:
        group["lr"] = learning_rate


def descend(
    optimizer: torch.optim.Adam, module: nn.Module, loss: Tensor, gradient_norm: float
) -> None:
    """Take one gradient step of a module, with a limit on the gradient's norm."""
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(module.parameters(), gradient_norm)
    optimizer.step()


class Critic(nn.Module):
    """A multilayer perceptron that estimates the discounted return of its input."""

    def __init__(self, size: int, hidden: Sequence[int]) -> None:
        super().__init__()
        widths = (size, *hidden)
        self.layers = nn.ModuleList(nn.Linear(*pair) for pair in pairwise(widths))
        self.value = nn.Linear(widths[-1], 1)

    def forward(self, inputs: Tensor) -> Tensor:
        """Return estimates (B,) for inputs (B, size)."""
        for layer in self.layers:
            inputs = torch.relu(layer(inputs))
        return full_precision(self.value, inputs).squeeze(-1)


class Runner(ABC, Generic[C]):
    """One run of an algorithm; `begin` or `resume` comes before `learn`.

    config: of the run, completed by what it starts from
    Config: model of the configuration
    COLUMNS: names of the metrics, of which the first is the step
    RATES: whether columns for the sparsity of spiking layers follow
    COUNTERS: attributes that are reported and saved in checkpoints, of which the first is the step
    SPEED: name of the metric of steps per second
    VALIDATES_AT_END: whether the last policy is validated, even if it is not due
    policy: what is validated and saved
    best: highest validation return so far
    logged: step of the last row of metrics; None before there is one
    """

    Config: ClassVar[type[RunConfig]]
    COLUMNS: ClassVar[tuple[str, ...]]
    RATES: ClassVar[bool] = True
    COUNTERS: ClassVar[tuple[str, ...]]
    SPEED: ClassVar[str] = "steps_per_s"
    VALIDATES_AT_END: ClassVar[bool] = True
    policy: Policy
    learner: Learner

    @classmethod
    def columns(cls, config: RunConfig) -> tuple[str, ...]:
        """Return the names of the metrics, of which the first is the step."""
        layers = range(1, spiking_layers(config.policy) + 1) if cls.RATES else ()
        return (*cls.COLUMNS, *(f"sparsity_lif{k}" for k in layers))

    def __init__(
        self, config: C, run: RunFolder, total: int, checkpoint_every: int, log_every: int = 1
    ) -> None:
        self.config, self._run = config, run
        self._total, self._log_every, self._checkpoint_every = total, log_every, checkpoint_every
        torch.manual_seed(config.seed)
        self._rng = np.random.default_rng(config.seed)
        self.best = -np.inf
        self.logged: float | None = None
        self._returns: list[float] = []  # of the episodes since the last row of metrics
        self._clock = time.perf_counter(), 0

    def learn(self, journal: Journal, stopped: Callable[[], bool]) -> None:
        """Train to the end or until stopped."""
        if self.finished:
            return
        self._clock = time.perf_counter(), self.step
        while not (self.finished or stopped()):
            before = self.step
            if not self._iterate(stopped):
                break
            journal.move_to(self.step, self._total)
            self._report(journal, before)
        self._checkpoint()

    @property
    def step(self) -> int:
        """Steps so far: environment steps or updates, whichever the algorithm counts."""
        step: int = getattr(self, self.COUNTERS[0])
        return step

    @property
    def share(self) -> float:
        """Part of the training that is done, from 0 to 1."""
        return min(self.step / self._total, 1.0)

    @property
    def finished(self) -> bool:
        """True if training has reached its end."""
        return self.step >= self._total

    # What an algorithm adds.

    @abstractmethod
    def _iterate(self, stopped: Callable[[], bool]) -> bool:
        """Collect and learn; return whether it was completed and not stopped."""

    @abstractmethod
    def _metrics(self) -> dict[str, float]:
        """Return the algorithm's metrics of training, counters left out."""

    @abstractmethod
    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        """Restore what `_state` and `_tensors` saved."""

    def _begin(self) -> None:
        """Prepare a new run, as opposed to one that is resumed."""

    def _state(self) -> dict[str, Any]:
        """Return more numbers for the checkpoint "last"."""
        return {}

    def _tensors(self) -> dict[str, Tensor]:
        """Return more tensors for the checkpoint "last"."""
        return {}

    def _evaluate(self) -> dict[str, float]:
        """Return the validation metrics of the policy."""
        return self._validator(self.policy)

    # What they share.

    @cached_property
    def _validator(self) -> "Validator":
        return Validator(self.config.env, self.config.validation)

    def _due(self, every: int, before: int) -> bool:
        """Return whether a multiple of `every` was reached since step `before`."""
        return self.step // every > before // every

    def _report(self, journal: Journal, before: int) -> None:
        """Validate, write metrics and save checkpoints where they are due."""
        row: dict[str, float] = {}
        at_end = self.finished and self.VALIDATES_AT_END
        if at_end or self._validates(before):
            row = self._validate()
        if row or self._due(self._log_every, before):
            best = {"best": self.best} if np.isfinite(self.best) else {}
            journal.add({**self._row(), **row, **best})
            self.logged = self.step
        if self._due(self._checkpoint_every, before):
            self._checkpoint()

    def _validates(self, before: int) -> bool:
        """Return whether a validation is due since step `before`."""
        return self._due(self.config.validation.every, before)

    def _validate(self) -> dict[str, float]:
        """Validate the policy, and save it as "best" if it is."""
        row = self._evaluate()
        if row["eval_return"] >= self.best:
            self._save_best(self.policy, row)
        return row

    def _save_best(self, policy: Policy, row: Mapping[str, float]) -> None:
        """Save what a validation found to be the best policy so far."""
        self.best = row["eval_return"]
        self._run.save("best", policy, {**self._counters(), **row})

    def _row(self) -> dict[str, float]:
        """Return the metrics of training since the last row."""
        (then, step), now = self._clock, time.perf_counter()
        self._clock = now, self.step
        counters = {name: getattr(self, name) for name in self.COUNTERS if name != "best"}
        row = {**counters, **self._metrics(), self.SPEED: (self.step - step) / (now - then)}
        returns, self._returns = self._returns, []
        return {**row, "episode_return": float(np.mean(returns))} if returns else row

    def _counters(self) -> dict[str, Any]:
        counters = {name: getattr(self, name) for name in self.COUNTERS}
        return {**counters, "best": self.best if np.isfinite(self.best) else None}

    def _checkpoint(self) -> None:
        """Save everything that resuming needs."""
        done = {"finished": self.finished, "share": self.share}
        counters = {**self._counters(), "logged": self.logged, "returns": self._returns, **done}
        state = {**counters, **self._state()}
        state["rng"] = self._rng.bit_generator.state
        tensors = {**self.learner.tensors(), **self._tensors(), "torch_rng": torch.get_rng_state()}
        if self._run.metrics.is_file():
            flush(self._run.metrics)  # a resumed run relies on its rows
        self._run.save("last", self.policy, state, tensors)

    def begin(self) -> None:
        """Prepare a new run, and write its first checkpoint."""
        self._begin()
        self._checkpoint()

    def resume(self) -> None:
        """Restore the checkpoint "last"; ConfigError where its network is another one."""
        state, tensors = self._run.load("last")
        check_policy(self._run.path, state["policy"], self.policy)
        try:
            self.learner.load(tensors)
            counters = {name: state[name] for name in self.COUNTERS}
        except (KeyError, RuntimeError, ValueError) as error:
            first = str(error).partition("\n")[0]
            raise ConfigError(
                f"{self._run.checkpoint('last')} is no checkpoint of a training with these "
                f"settings: {first}. Resume it with those of before"
            ) from error
        for name, value in counters.items():
            if not isinstance(getattr(type(self), name, None), property):
                setattr(self, name, value)
        self.best = -np.inf if state["best"] is None else state["best"]
        self.logged, self._returns = state["logged"], state["returns"]
        self._rng.bit_generator.state = state["rng"]
        self._restore(state, tensors)
        torch.set_rng_state(tensors["torch_rng"])  # last, as restoring may draw
        self._run.write_numbers("last", state)  # a kill may have come before them


def check_policy(path: Path, before: Mapping[str, Any], policy: Policy) -> None:
    """Refuse a run to be resumed with another network than that of its checkpoint.

    path: of the run
    before: spec of the policy in the checkpoint
    """
    now = policy.spec()
    fixed = set(now) - {"two_valued"}  # which training finds
    if changed := sorted(name for name in fixed if before.get(name) != now[name]):
        some = ", ".join(f"{name} is {before.get(name)!s:.80}" for name in changed)
        raise ConfigError(f"a resumed run keeps its network, and in {path} {some}")


class EnvRunner(Runner[C]):
    """A run that counts environment steps and normalises by running moments.

    env_steps, episodes: counters, continued by a resumed run
    """

    def __init__(
        self, config: C, run: RunFolder, total: int, checkpoint_every: int, log_every: int = 1
    ) -> None:
        super().__init__(config, run, total, checkpoint_every, log_every)
        self._envs = EnvBatch(config.env, self._rng)
        self._moments = Moments.empty(self._envs.sizes[0])
        self.episodes = 0

    @property
    def env_steps(self) -> int:
        """Environment steps so far, of all copies together."""
        return self._envs.taken

    def _count_episodes(self) -> None:
        """Take over the returns of the episodes that ended."""
        self._returns, self._envs.returns = self._envs.returns, []
        self.episodes += len(self._returns)

    def _state(self) -> dict[str, Any]:
        return {"observed": self._moments.count, "under_way": self._envs.state()}

    def _tensors(self) -> dict[str, Tensor]:
        under_way = {f"under_way.{name}": t for name, t in self._envs.tensors().items()}
        return {**self._moments.tensors(), **under_way}

    def _restore(self, state: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
        self._moments = Moments.restored(tensors, state["observed"])
        under_way = with_prefix("under_way", tensors)
        self._envs.restore(state["under_way"], under_way, state["env_steps"])


@dataclass
class _Episode:
    """An unfinished episode of a validation."""

    env: Any
    observation: Any
    total: float = 0.0
    infos: list[dict[str, Any]] = field(default_factory=list)

    def step(self, action: Any) -> bool:  # noqa: ANN401
        """Step, and return whether the episode continues."""
        self.observation, reward, terminated, truncated, info = self.env.step(action)
        self.total += reward
        self.infos.append(info)
        return not (terminated or truncated)


class Validator:
    """Validation: deterministic episodes without support force, as one batch."""

    def __init__(self, env: EnvConfig, config: ValidationConfig) -> None:
        self._config = config
        self._envs = [envs.make(env.name, **env.options) for _ in range(config.episodes)]

    @torch.no_grad()
    def __call__(self, policy: Policy) -> dict[str, float]:
        """Return means: return, speed, cost of transport, falls, success, errors, sparsity."""
        episodes = [
            _Episode(env, env.reset(seed=self._config.first_seed + k)[0])
            for k, env in enumerate(self._envs)
        ]
        rates = []
        running = episodes
        while running:
            observation = np.stack([episode.observation for episode in running])
            latent = policy.latent(torch.from_numpy(observation).float().to(policy.device))
            actions = policy.env_action(latent.mean)
            rates.append([float(rate) for rate in latent.rates])
            running = [
                episode
                for episode, action in zip(running, actions, strict=True)
                if episode.step(action) and len(episode.infos) != self._config.limit
            ]
        # the sparsity of a layer is the share of neuron timesteps without a spike
        means = enumerate(np.mean(rates, axis=0), start=1)
        sparsity = {f"sparsity_lif{k}": 1.0 - float(rate) for k, rate in means}
        return {**_metrics(episodes), **sparsity}


def _metrics(episodes: list[_Episode]) -> dict[str, float]:
    """Return the metrics of the episodes, as far as all of the environment's infos have them."""
    steps = [info for episode in episodes for info in episode.infos]
    result = mean_outcome([each.total for each in episodes], [each.infos[-1] for each in episodes])
    for names, power in ((_MEANS, 1), (_SQUARES, 2)):
        for name, column in names.items():
            if all(name in info for info in steps):
                mean = np.mean([info[name] ** power for info in steps])
                result[column] = float(mean if power == 1 else np.sqrt(mean))
    return result


def mean_outcome(returns: Sequence[float], lasts: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return the metrics of validation episodes, from their returns and last infos.

    What only some of the episodes say is unknown: those that say it may not be like the others.
    """
    row = {"eval_return": float(np.mean(returns))}
    known = {key: column for key, column in _LASTS.items() if all(key in info for info in lasts)}
    return row | {
        column: float(np.mean([info[key] for info in lasts])) for key, column in known.items()
    }
