"""The position of a replay: pause, speed, seek, batch."""

from dataclasses import dataclass

import pygame

_SPEEDS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
_JUMP = 1.0  # [s] of a seek
_REST = 1.0  # [s] that the end of a batch is shown


@dataclass
class Playback:
    """Position and speed of a replay.

    batches  number of batches
    dt       [s] of a control step
    length   control steps of the current batch
    batch    index of the current batch
    step     control steps since its start, with fraction
    speed    1 is real time
    paused   whether it is paused
    rounds   how often the last batch has ended
    """

    batches: int
    dt: float
    length: int = 0
    batch: int = 0
    step: float = 0.0
    speed: float = 1.0
    paused: bool = False
    rounds: int = 0

    @property
    def now(self) -> int:
        """The control step that is shown."""
        return min(int(self.step), self.length)

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press."""
        if event.type != pygame.KEYDOWN:
            return
        if event.key == pygame.K_SPACE:
            self.paused = not self.paused
        elif event.key in (pygame.K_LEFT, pygame.K_RIGHT):
            self.seek(_JUMP if event.key == pygame.K_RIGHT else -_JUMP)
        elif event.key in (pygame.K_UP, pygame.K_DOWN):
            self.change_speed(1 if event.key == pygame.K_UP else -1)
        elif event.key in (pygame.K_n, pygame.K_b):
            self.skip(1 if event.key == pygame.K_n else -1)

    def tick(self, seconds: float) -> None:
        """Advance; the next batch follows the end of a batch, the first the last."""
        if self.paused:
            return
        self.step += self.speed * seconds / self.dt
        if self.step > self.length + _REST * self.speed / self.dt:
            self.rounds += self.batch == self.batches - 1
            self.skip(1)

    def seek(self, seconds: float) -> None:
        """Seek within the batch."""
        self.step = min(max(self.step + seconds / self.dt, 0.0), float(self.length))

    def change_speed(self, notches: int) -> None:
        """Play faster or slower by steps of SPEEDS."""
        nearest = min(range(len(_SPEEDS)), key=lambda k: abs(_SPEEDS[k] - self.speed))
        self.speed = _SPEEDS[min(max(nearest + notches, 0), len(_SPEEDS) - 1)]

    def skip(self, batches: int) -> None:
        """Skip batches, cyclically."""
        self.batch = (self.batch + batches) % self.batches
        self.step = 0.0
