"""Who drives: a person at the keys, a policy, or a policy that a person commands."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy.play.keys import Keys, Sticks
from spikedeploy.policies.interface import Player

Legend = list[tuple[str, str]]


class Driver(Protocol):
    """A controller that is told of keys.

    name    for people
    legend  keys and what they do
    """

    name: str

    @property
    def legend(self) -> Legend:
        """Keys and what they do."""

    def reset(self, seed: int) -> None:
        """Start an episode."""

    def handle(self, event: pygame.Event) -> None:
        """Take a key that was pressed or let go."""

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The action for an observation."""


class Hand:
    """A person who chooses actions with keys."""

    name = "you"

    def __init__(self, actions: tuple[str, ...]) -> None:
        self.keys = Keys(actions)

    @property
    def legend(self) -> Legend:
        """Keys and what they do."""
        return self.keys.legend

    def reset(self, seed: int) -> None:
        """Nothing: who holds a key drives off at once."""

    def handle(self, event: pygame.Event) -> None:
        """Take a key that was pressed or let go."""
        self.keys.handle(event)

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The action () that the keys mean."""
        return np.asarray(self.keys.action)


class BothHands(Hand):
    """A person whose keys act together, where an action is as many numbers.

    effects  name of an action -> numbers (act,)
    """

    def __init__(self, actions: tuple[str, ...], effects: Mapping[str, tuple[float, ...]]) -> None:
        super().__init__(actions)
        self._effects = effects

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The numbers (act,) that the keys add up to, in [-1, 1]."""
        held = [self._effects[name] for name in (self.keys.actions[0], *self.keys.held)]
        return np.asarray(np.clip(np.sum(held, axis=0), -1.0, 1.0))


class Watched:
    """A policy that drives alone."""

    def __init__(self, player: Player, name: str) -> None:
        self.name, self._player = name, player
        self.legend: Legend = []

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self._player.reset(seed)

    def handle(self, event: pygame.Event) -> None:
        """No key changes its mind."""

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The policy's action."""
        return self._player.act(observation)


class Commanded(Watched):
    """A policy that walks as a person's keys command.

    world   with `steer`
    sticks  the command
    """

    def __init__(self, player: Player, name: str, world: Any) -> None:  # noqa: ANN401
        super().__init__(player, name)
        self.sticks, self._world = Sticks(), world
        self.legend = self.sticks.legend

    def handle(self, event: pygame.Event) -> None:
        """Take a key that was pressed."""
        self.sticks.handle(event)

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The policy's action; the next observation shows it the command."""
        self._world.steer(self.sticks.speed, self.sticks.turn)
        return super().act(observation)
