"""Keys and the actions that they stand for."""

from collections.abc import Mapping

import pygame

ARROWS = {
    "up": (pygame.K_w, pygame.K_UP),
    "down": (pygame.K_s, pygame.K_DOWN),
    "left": (pygame.K_a, pygame.K_LEFT),
    "right": (pygame.K_d, pygame.K_RIGHT),
    "forward": (pygame.K_w, pygame.K_UP),
    "accelerate": (pygame.K_w, pygame.K_UP),
    "brake": (pygame.K_s, pygame.K_SPACE, pygame.K_DOWN),
}  # action -> keys
CAPS = {
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
            key: index for index, name in enumerate(actions) for key in ARROWS.get(name, ())
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
        return [(CAPS[name], name) for name in self.actions if name in CAPS]


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
