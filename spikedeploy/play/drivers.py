"""Drivers: a person at the keys, a policy, or a policy that a person commands."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy.play.driving_network import DrivingNetwork
from spikedeploy.policies.registry import Player

_ARROWS = {
    "up": (pygame.K_w, pygame.K_UP),
    "down": (pygame.K_s, pygame.K_DOWN),
    "left": (pygame.K_a, pygame.K_LEFT),
    "right": (pygame.K_d, pygame.K_RIGHT),
    "forward": (pygame.K_w, pygame.K_UP),
    "accelerate": (pygame.K_w, pygame.K_UP),
    "brake": (pygame.K_s, pygame.K_SPACE, pygame.K_DOWN),
}  # action -> keys
_CAPS = {
    "up": "W",
    "down": "S",
    "left": "A",
    "right": "D",
    "forward": "W",
    "accelerate": "W",
    "brake": "S",
}


class Keys:
    """The keys that are held down, and their action.

    actions  names of an environment's actions, in its order; the first is no action
    """

    def __init__(self, actions: tuple[str, ...]) -> None:
        self.actions = actions
        self._meaning: Mapping[int, int] = {
            key: index for index, name in enumerate(actions) for key in _ARROWS.get(name, ())
        }
        self._held: list[int] = []

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press or release; other keys than those that drive are ignored."""
        if event.key not in self._meaning:
            return
        if event.key in self._held:
            self._held.remove(event.key)
        if event.type == pygame.KEYDOWN:
            self._held.append(event.key)

    @property
    def action(self) -> int:
        """Index of the action of the key that was pressed last and is still held."""
        return self._meaning[self._held[-1]] if self._held else 0

    @property
    def held(self) -> list[str]:
        """Names of the actions of all keys that are held."""
        return [self.actions[self._meaning[key]] for key in self._held]

    @property
    def legend(self) -> list[tuple[str, str]]:
        """Keys and what they do."""
        return [(_CAPS[name], name) for name in self.actions if name in _CAPS]


class CommandKeys:
    """Speed and turn rate that the arrow keys command, changed in steps."""

    SPEED = (-0.25, 0.45)  # [m/s]
    TURN = (-0.8, 0.8)  # [rad/s]
    STEPS = {  # noqa: RUF012 - key -> change of speed and turn rate
        pygame.K_UP: (0.05, 0.0),
        pygame.K_DOWN: (-0.05, 0.0),
        pygame.K_LEFT: (0.0, 0.2),
        pygame.K_RIGHT: (0.0, -0.2),
    }
    legend = [("↑ ↓", "speed"), ("← →", "turn"), ("SPACE", "stand")]  # noqa: RUF012

    def __init__(self) -> None:
        self.speed, self.turn = 0.25, 0.0

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press."""
        if event.type != pygame.KEYDOWN:
            return
        if event.key == pygame.K_SPACE:
            self.speed = self.turn = 0.0
        speed, turn = self.STEPS.get(event.key, (0.0, 0.0))
        self.speed = round(min(max(self.speed + speed, self.SPEED[0]), self.SPEED[1]), 2)
        self.turn = round(min(max(self.turn + turn, self.TURN[0]), self.TURN[1]), 2)


Legend = list[tuple[str, str]]


class Driver(Protocol):
    """A controller that receives key events.

    name     for people
    legend   keys and what they do
    network  of a spiking policy that drives
    """

    name: str
    network: DrivingNetwork | None

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
    network: DrivingNetwork | None = None

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
        self.network = player if isinstance(player, DrivingNetwork) else None
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
