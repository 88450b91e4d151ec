"""Drivers of `spikedeploy play`, and episodes that follow one another."""

import itertools
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy import envs, zoo
from spikedeploy.envs.rollout import EpisodeRecorder, Rollout
from spikedeploy.policies.registry import Candidate, Controller, find, open_policy
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix

Floats = NDArray[np.float64]
_UNKNOWN = 1 / 30  # [s] control step where an environment does not say
_PAUSE = 1.5  # [s] that the end of an episode stays on the screen


# drivers


class Driver:
    """A controller that receives key events.

    name: for people
    legend: keys and what they do
    """

    name = "you"
    legend: list[tuple[str, str]] = []  # noqa: RUF012

    def reset(self, seed: int) -> None:
        """Start an episode."""

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press or release."""

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action for an observation."""
        raise NotImplementedError


_ARROWS = {
    "up": (pygame.K_w, pygame.K_UP),
    "down": (pygame.K_s, pygame.K_DOWN),
    "left": (pygame.K_a, pygame.K_LEFT),
    "right": (pygame.K_d, pygame.K_RIGHT),
    "forward": (pygame.K_w, pygame.K_UP),
    "accelerate": (pygame.K_w, pygame.K_UP),
    "brake": (pygame.K_s, pygame.K_SPACE, pygame.K_DOWN),
    "slightly left": (pygame.K_q,),
    "slightly right": (pygame.K_e,),
}  # action -> keys, that of the legend first


class KeyboardDriver(Driver):
    """A person at the keys: the key pressed last acts, or all that are held add up.

    actions: names of an environment's actions, in its order; "straight" is no action, or the first
    effects: effects of a continuous action: name -> numbers (act,), which add up
    """

    def __init__(
        self, actions: tuple[str, ...], effects: Mapping[str, tuple[float, ...]] | None = None
    ) -> None:
        self._actions, self._effects = actions, effects
        self._idle = "straight" if "straight" in actions else actions[0]
        self._meaning = {key: name for name in actions for key in _ARROWS.get(name, ())}
        self._held: list[int] = []
        self.legend = [(chr(_ARROWS[n][0]).upper(), n) for n in actions if n in _ARROWS]

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press or release; other keys than those that drive are ignored."""
        if event.key in self._held:
            self._held.remove(event.key)
        if event.type == pygame.KEYDOWN and event.key in self._meaning:
            self._held.append(event.key)

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action () of the key that was pressed last and is still held, or their sum (act,)."""
        names = [self._idle, *(self._meaning[key] for key in self._held)]
        if self._effects is None:
            return np.asarray(self._actions.index(names[-1]))
        effects = [self._effects[name] for name in names]
        return np.asarray(np.clip(np.sum(effects, axis=0), -1.0, 1.0))


class PolicyDriver(Driver):
    """A policy that drives by itself."""

    def __init__(self, controller: Controller, name: str) -> None:
        self.name, self._controller = name, controller

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self._controller.reset(seed)

    def act(self, observation: Floats) -> NDArray[Any]:
        """The policy's action."""
        return self._controller.act(observation)


class CommandedPolicyDriver(PolicyDriver):
    """A policy that follows the velocity commands of a person, who changes them in steps.

    speed, turn: that are commanded [m/s], [rad/s]
    """

    SPEED = (-0.25, 0.45)  # [m/s]
    TURN = (-0.8, 0.8)  # [rad/s]
    _STEPS = {  # noqa: RUF012 - key -> change of speed and turn rate
        pygame.K_UP: (0.05, 0.0),
        pygame.K_DOWN: (-0.05, 0.0),
        pygame.K_LEFT: (0.0, 0.2),
        pygame.K_RIGHT: (0.0, -0.2),
    }
    legend = [("UP DOWN", "speed"), ("LEFT RIGHT", "turn"), ("SPACE", "stand")]  # noqa: RUF012

    def __init__(self, controller: Controller, name: str, world: Any) -> None:  # noqa: ANN401
        super().__init__(controller, name)
        self._world = world
        self.speed, self.turn = 0.25, 0.0

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press."""
        if event.type != pygame.KEYDOWN:
            return
        if event.key == pygame.K_SPACE:
            self.speed = self.turn = 0.0
        speed, turn = self._STEPS.get(event.key, (0.0, 0.0))
        self.speed = round(min(max(self.speed + speed, self.SPEED[0]), self.SPEED[1]), 2)
        self.turn = round(min(max(self.turn + turn, self.TURN[0]), self.TURN[1]), 2)

    def act(self, observation: Floats) -> NDArray[Any]:
        """The policy's action; the next observation contains the command."""
        self._world.steer(self.speed, self.turn)
        return super().act(observation)


# a session: one driver in one environment


_REASONS = ("finish", "crash", "stalled", "fall")  # keys of the step infos


@dataclass(frozen=True)
class Outcome:
    """The end of an episode.

    word: "finish", "crash", "stalled", "fall", "the end" or "time is up"
    good: whether it was a success
    steps: steps of the episode
    total: return
    seconds: seconds of the lap, where one was finished
    """

    word: str
    good: bool
    steps: int
    total: float
    seconds: float | None = None

    @classmethod
    def from_rollout(cls, played: Rollout, info: Mapping[str, Any]) -> "Outcome":
        """The outcome of an episode, whose last info has the reason if it has one."""
        word = next(
            (name for name in _REASONS if info.get(name)),
            "the end" if played.terminated else "time is up",
        )
        lap = float(info["lap_time"]) if info.get("finish") else None
        return cls(word, bool(info.get("success")), played.steps, played.total, lap)

    @property
    def line(self) -> str:
        """The outcome in one line."""
        lap = "" if self.seconds is None else f" in {self.seconds:.2f} s"
        return f"{self.word}{lap}, {self.steps} steps, return {self.total:.2f}"


class Session:
    """One driver in one environment, episode after episode.

    seed: seed of the first episode; each further one has the next
    record: file for the rollouts; the second goes to <name>-2, and so on
    period: time of a control step [s]
    episode: the recorder of the current episode
    sums: reward term -> sum over the episode
    outcomes: outcomes of the episodes that ended
    files: files of recorded rollouts
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        driver: Driver,
        seed: int,
        record: Path | None = None,
    ) -> None:
        self.env, self.driver, self._record = env, driver, record
        self.world: Any = env.unwrapped
        self.period = float(getattr(self.world, "CONTROL_DT", None) or _UNKNOWN)
        self.outcomes: list[Outcome] = []
        self.files: list[Path] = []
        self._seed = seed - 1
        self.restart()

    @property
    def info(self) -> Mapping[str, Any]:
        """The info of the last step or reset."""
        return self.episode.info

    @property
    def waiting(self) -> bool:
        """True while the end of an episode is shown."""
        return self._wait > 0

    def restart(self) -> None:
        """Start the next episode; an unfinished one is dropped."""
        self._seed += 1
        self._wait = 0
        self.episode = EpisodeRecorder(self.env, self._seed)
        self.driver.reset(self._seed)
        self.sums: Counter[str] = Counter()

    def tick(self) -> None:
        """Advance by one control step, or keep showing the end of an episode."""
        if self._wait:
            self._wait -= 1
            if not self._wait:
                self.restart()
            return
        self.episode.step(self.driver.act(self.episode.observation))
        self.sums.update(self.info.get("reward_terms", {"reward": self.episode.reward}))
        if self.episode.over:
            played = self.episode.rollout()
            self.outcomes.append(Outcome.from_rollout(played, self.info))
            self._keep(played)
            self._wait = max(1, round(_PAUSE / self.period))

    def close(self) -> None:
        """Record the unfinished episode, if recording, and close the environment."""
        if not self.waiting and self.episode.steps:
            self._keep(self.episode.rollout())
        self.env.close()

    def _keep(self, played: Rollout) -> None:
        """Write a rollout, if recording; all but the first to a file that is not there."""
        if self._record is None:
            return
        stem, numbers = self._record.stem, itertools.count(len(self.files) + 1)
        others = (self._record.with_stem(f"{stem}-{number}") for number in numbers)
        path = next(p for p in others if not p.exists()) if self.files else self._record
        self.files.append(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        played.save(path)


def open_session(
    env: str,
    options: Mapping[str, Any],
    policy: str | None,
    chip: str | None,
    seed: int,
    record: Path | None = None,
) -> Session:
    """Return the session of `spikedeploy play`.

    env: short name or id
    options: options of the environment
    policy: None for a person where keys can drive, else for a shipped policy
    chip: chip of a spiking policy; None is that of its training, or loihi1
    record: as of Session
    """
    if record is not None and suffix(record) != ".npz":
        raise ConfigError(f"--record {record}: a drive is kept in a file that ends in .npz")
    world = envs.make(env, **options, render_mode="rgb_array")
    return Session(world, _driver(env, world, policy, chip), seed, record)


def _driver(env: str, world: Any, policy: str | None, chip: str | None) -> Driver:  # noqa: ANN401
    """Return a person where keys can drive and no policy is named, else a policy."""
    inner = world.unwrapped
    if policy is None and hasattr(inner, "ACTIONS"):
        if chip is not None:
            raise ConfigError("--chip is for a policy: name one with --policy")
        is_discrete = isinstance(world.action_space, gymnasium.spaces.Discrete)
        return KeyboardDriver(inner.ACTIONS, None if is_discrete else inner.EFFECTS)
    candidate = _shipped(env) if policy is None else find(policy)
    chip = chip or candidate.default_chip
    controller = open_policy(candidate, chip, world)
    name = f"{candidate.name} on {chip}" if chip else candidate.name
    if hasattr(inner, "steer"):
        return CommandedPolicyDriver(controller, name, inner)
    return PolicyDriver(controller, name)


def _shipped(env: str) -> Candidate:
    """Return a shipped policy of the environment, a spiking one if there is one."""
    spec = envs.spec(env)
    found = [find(str(path)) for path in zoo.policies(spec.short)]
    spiking = [candidate for candidate in found if candidate.kind == "snn"]
    return (spiking or found or [find(spec.controls[0])])[0]
