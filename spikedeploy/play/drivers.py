"""Drivers: a person at the keys, a policy, or a policy that a person commands."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy.play.keys import CommandKeys, Keys
from spikedeploy.policies.interface import Player

Legend = list[tuple[str, str]]


class Driver(Protocol):
    """A controller that receives key events.

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
        """Handle a key press or release."""

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The action for an observation."""


class KeyboardDriver:
    """A person who chooses discrete actions with keys."""

    name = "you"

    def __init__(self, actions: tuple[str, ...]) -> None:
        self.keys = Keys(actions)

    @property
    def legend(self) -> Legend:
        """Keys and what they do."""
        return self.keys.legend

    def reset(self, seed: int) -> None:
        """Nothing: keys that are held act at once."""

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press or release."""
        self.keys.handle(event)

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The action () of the keys."""
        return np.asarray(self.keys.action)


class CombinedKeysDriver(KeyboardDriver):
    """A person whose keys add up to a continuous action.

    effects  name of an action -> numbers (act,)
    """

    def __init__(self, actions: tuple[str, ...], effects: Mapping[str, tuple[float, ...]]) -> None:
        super().__init__(actions)
        self._effects = effects

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The action (act,), the sum of the keys in [-1, 1]."""
        held = [self._effects[name] for name in (self.keys.actions[0], *self.keys.held)]
        return np.asarray(np.clip(np.sum(held, axis=0), -1.0, 1.0))


class PolicyDriver:
    """A policy that drives by itself."""

    def __init__(self, player: Player, name: str) -> None:
        self.name, self._player = name, player
        self.legend: Legend = []

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self._player.reset(seed)

    def handle(self, event: pygame.Event) -> None:
        """Nothing: keys have no effect."""

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The policy's action."""
        return self._player.act(observation)


class CommandedPolicyDriver(PolicyDriver):
    """A policy that follows the velocity commands of a person.

    keys  the command
    """

    def __init__(self, player: Player, name: str, world: Any) -> None:  # noqa: ANN401
        super().__init__(player, name)
        self.keys, self._world = CommandKeys(), world
        self.legend = self.keys.legend

    def handle(self, event: pygame.Event) -> None:
        """Take a key that was pressed."""
        self.keys.handle(event)

    def act(self, observation: NDArray[np.float64]) -> NDArray[Any]:
        """The policy's action; the next observation contains the command."""
        self._world.steer(self.keys.speed, self.keys.turn)
        return super().act(observation)
