"""Ghosts on their track: where each is at a step, drawn together, and what the leader observed."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy.envs.ghosts import Ghost
from spikedeploy.envs.kart.picture import Scene, draw_gates, draw_kart, scene
from spikedeploy.envs.kart.track import RADIUS
from spikedeploy.play.theme import AMBER, CYAN, DIM, GREEN, RED, Colour, write

Floats = NDArray[np.float64]
Facts = list[tuple[str, str]]

COLOURS: tuple[Colour, ...] = (  # of several sources, in order: far apart in hue
    (76, 201, 240),  # sky
    (255, 209, 102),  # sand
    (240, 128, 176),  # rose
    (112, 211, 150),  # mint
    (170, 145, 250),  # violet
    (244, 140, 70),  # apricot
)
_FEW = 40  # more ghosts than this are drawn as dots, coloured by age
_AGES: tuple[Colour, ...] = ((150, 96, 208), (112, 118, 230), (76, 160, 240), (76, 211, 220))


class GhostGroup:
    """Ghosts that start together: all poses at a step in one array lookup.

    drives   (n,)
    pushed   whether they have no heading, so that the direction of motion is shown
    length   steps of the longest
    age      (n,) from 0 for the first to 1 for the last: the progress of the training
    leader   index of the best: the fastest that finishes, else the one with the most gates
    best     that ghost; None of an empty group
    """

    def __init__(self, drives: Sequence[Ghost], pushed: bool = False) -> None:
        def rank(index: int) -> tuple[bool, int, int]:
            ghost = drives[index]
            return ghost.finish, ghost.gates, -ghost.steps if ghost.finish else ghost.steps

        self.drives = drives
        self.steps = np.array([ghost.steps for ghost in drives], np.int64)
        self.age = np.linspace(0.0, 1.0, len(drives))
        self.length = int(self.steps.max(initial=0))
        self.leader = max(range(len(drives)), key=rank, default=None)
        self.best = None if self.leader is None else drives[self.leader]
        poses = [_point_along_path(ghost.pose) if pushed else ghost.pose for ghost in drives]
        self._pose = np.concatenate([np.zeros((0, 3), np.float32), *poses])
        self._first = np.cumsum(self.steps + 1) - self.steps - 1
        self._finish = np.array([ghost.finish for ghost in drives], bool)
        self._crash = np.array([ghost.crash for ghost in drives], bool)

    def poses(self, step: int) -> NDArray[np.float32]:
        """x, y and heading (n, 3) at a step; the last pose after the end."""
        found: NDArray[np.float32] = self._pose[self._first + np.minimum(step, self.steps)]
        return found

    def states(self, step: int) -> dict[str, NDArray[np.bool_]]:
        """Ghosts (n,) that are driving, that have finished and that have crashed by then."""
        driving = step < self.steps
        return {
            "driving": driving,
            "finished": ~driving & self._finish,
            "crashed": ~driving & self._crash,
        }

    def counts(self, step: int) -> dict[str, int]:
        """Numbers of those that drive, have finished and have crashed."""
        return {name: int(each.sum()) for name, each in self.states(step).items()}


def _point_along_path(pose: NDArray[np.float32]) -> NDArray[np.float32]:
    """Poses (S + 1, 3) with the direction of motion as heading."""
    moved = np.diff(pose[:, :2], axis=0, prepend=pose[:1, :2])
    heading = np.arctan2(moved[:, 1], moved[:, 0])
    return np.column_stack((pose[:, :2], heading)).astype(np.float32)


class GhostView:
    """A batch of ghosts of each source, started together on the track of the first one's leader.

    sources  name -> ghosts; several have a colour each, a single one is coloured by outcome and age
    seen     (S + 1, obs) recorded observations of a single ghost, if any
    length   control steps of the longest
    seed     of the episode of the first source's leader
    legend   name of a source -> its colour, where there are several
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        sources: Mapping[str, Sequence[Ghost]],
        seen: Floats | None = None,
    ) -> None:
        self._world: Any = env.unwrapped
        self._seen = seen
        pushed = not env.get_wrapper_attr("TURNS")
        self.groups = {name: GhostGroup(drives, pushed) for name, drives in sources.items()}
        self.group = next(iter(self.groups.values()))
        self.length = max(group.length for group in self.groups.values())
        self.seed = self.group.best.seed if self.group.best else -1
        self._reset()
        self._track = env.get_wrapper_attr("track")
        several = len(sources) > 1
        self.legend: Mapping[str, Colour] = (
            dict(zip(sources, COLOURS, strict=False)) if several else {}
        )

    def draw(self, step: int, size: tuple[int, int]) -> pygame.Surface:
        """The track with all ghosts, the leaders on top."""
        surface, place = self.ground(size), self.place(size)
        if not self.legend:
            ages = _AGES if len(self.group.drives) > _FEW else (CYAN,)
            _draw_group(surface, place, self.group, step, ages, GREEN, RED)
            _draw_legend(surface, ages)
            _draw_leader(surface, place, self.group, step, AMBER)
            return surface
        for name, colour in self.legend.items():
            _draw_group(surface, place, self.groups[name], step, (colour,), colour, colour)
        for name, colour in reversed([*self.legend.items()]):
            _draw_leader(surface, place, self.groups[name], step, colour)
        return surface

    def ground(self, size: tuple[int, int]) -> pygame.Surface:
        """The track with its gates, without ghosts."""
        surface = self.place(size).ground.copy()
        draw_gates(surface, self.place(size), -1)
        return surface

    def place(self, size: tuple[int, int]) -> Scene:
        """The track on a surface of this size."""
        return scene(self._track, size)

    def facts(self, step: int) -> Facts:
        """Counts of ghosts, and the state of the leader; of several sources for each."""
        facts: Facts = []
        for name, group in self.groups.items() if self.legend else ():
            numbers = " / ".join(f"{count:,}" for count in group.counts(step).values())
            facts += [(name, ""), ("driving / finished / crashed", numbers)]
            facts.append(("leader", self._describe_result(group.best)))
        if self.legend:
            return facts
        drives, best = self.group.drives, self.group.best
        facts = [(name, f"{count:,}") for name, count in self.group.counts(step).items()]
        facts.append(("ghosts", f"{len(drives):,}"))
        if trained := [ghost.env_step for ghost in drives if ghost.env_step]:
            facts.append(("training steps", f"{min(trained):,} – {max(trained):,}"))
        if best is None:
            return facts
        now = min(step, best.steps)
        end = "finish" if best.finish else "crash" if best.crash else "no finish"
        return [
            *facts,
            ("leader", f"{end}, {best.gates} of {len(self._track.gates)} gates"),
            ("its time", self._describe_time(best)),
            ("its speed", f"{best.speed[now] / 100:.2f} m/s"),
            ("its reward", f"{best.reward[:now].sum():+.2f}"),
        ]

    def observations(self) -> Floats:
        """Recorded observations of the leader, else reconstructed ones."""
        if self._seen is not None:
            return self._seen
        if self.group.best is None:
            return np.zeros((0, 0))
        self._reset()
        return ghost_observations(self.group.best, self._world)

    def action(self, step: int) -> int | None:
        """The discrete action of the leader; None where actions are continuous."""
        ghost = self.group.best
        if ghost is None or ghost.action.ndim != 1 or not ghost.steps:
            return None
        return int(ghost.action[min(step, ghost.steps - 1)])

    def _reset(self) -> None:
        """Reset with the leader's seed, which decides a random track."""
        self._world.reset(seed=max(self.seed, 0))

    def _describe_result(self, ghost: Ghost | None) -> str:
        if ghost is None:
            return "nobody"
        end = "finish" if ghost.finish else f"{ghost.gates} of {len(self._track.gates)} gates"
        return f"{end}, {self._describe_time(ghost)}"

    def _describe_time(self, ghost: Ghost) -> str:
        return f"{ghost.steps * self._world.CONTROL_DT:.2f} s"


# drawing


def _draw_group(
    surface: pygame.Surface,
    place: Scene,
    group: GhostGroup,
    step: int,
    ages: Sequence[Colour],
    finished: Colour,
    crashed: Colour,
) -> None:
    """Draw moving ghosts, and where the others ended, over a track.

    ages  colours of moving ghosts, from the start to the end of the training
    """
    poses, states = group.poses(step), group.states(step)
    points, driving = place.at(poses[:, :2]), states["driving"]
    _draw_dots(surface, points[states["crashed"]], crashed, 3)
    _draw_dots(surface, points[states["finished"]], finished, 3)
    age = np.minimum(group.age * len(ages), len(ages) - 1).astype(int)
    for number, colour in enumerate(ages):
        these = np.flatnonzero(driving & (age == number))
        if driving.sum() > _FEW:
            _draw_dots(surface, points[these], colour, max(3, round(9 * place.scale)))
        else:
            for index in these:
                draw_kart(surface, place, tuple(poses[index].tolist()), colour, 150)


def _draw_leader(
    surface: pygame.Surface, place: Scene, group: GhostGroup, step: int, colour: Colour
) -> None:
    """Draw the best ghost and its path."""
    if group.best is None or group.leader is None:
        return
    points = place.at(group.best.pose[: step + 1, :2])
    if len(points) > 1:
        pygame.draw.aalines(surface, colour, False, [tuple(point) for point in points])
    draw_kart(surface, place, tuple(group.poses(step)[group.leader].tolist()), colour)


def _draw_legend(surface: pygame.Surface, ages: tuple[Colour, ...]) -> None:
    """Draw a legend in the lower left corner."""
    x, y = 20.0, surface.get_height() - 18.0
    name = "driving" if len(ages) == 1 else "driving, of early to late training"
    entries = [("leader", (AMBER,)), ("finished", (GREEN,)), ("crashed", (RED,)), (name, ages)]
    for text, shades in entries:
        for colour in shades:
            pygame.draw.aacircle(surface, colour, (x, y), 5)
            x += 14
        x = write(surface, text, (x - 2, y), 12, DIM, anchor="midleft").right + 20


def _draw_dots(surface: pygame.Surface, points: Floats, colour: Colour, radius: int) -> None:
    dot = pygame.Surface((2 * radius + 2, 2 * radius + 2), pygame.SRCALPHA)
    pygame.draw.aacircle(dot, (*colour, 120), (radius + 1, radius + 1), radius)
    corners = np.rint(points - radius - 1).astype(int).tolist()
    surface.blits([(dot, tuple(corner)) for corner in corners], doreturn=False)


# observations along a path: a ghost records poses only


def ghost_observations(ghost: Ghost, world: Any) -> Floats:  # noqa: ANN401
    """Observations (S + 1, obs) that the environment would have made at the poses of a ghost."""
    pose = ghost.pose.astype(np.float64)
    change = np.diff(pose[:, 2], prepend=pose[:1, 2])  # [rad] in the step before
    turn = ((change + np.pi) % (2 * np.pi) - np.pi) / world.CONTROL_DT
    if "forward" in world.ACTIONS:  # turns are observed a step before the kart moves
        turn = np.append(turn[1:], 0.0)
    if world.TURNS:
        direction = np.stack((np.cos(pose[:, 2]), np.sin(pose[:, 2])), axis=1)
    else:  # no heading: the path
        moved = np.diff(pose[:, :2], axis=0, prepend=pose[:1, :2])
        direction = moved / np.maximum(np.hypot(*moved.T), 1e-9)[:, None]
    velocity = ghost.speed[:, None] * direction
    gates = count_gates(pose[:, :2], world.track.gates)
    return np.stack(
        [
            world.observe_at(*pose[k], velocity[k], float(turn[k]), int(gates[k]))
            for k in range(len(pose))
        ]
    )


def count_gates(path: Floats, gates: Floats) -> NDArray[np.int64]:
    """Number of gates passed in order at each point of a path (S + 1,)."""
    passed = np.zeros(len(path), np.int64)
    start = 0
    for number, (a, b) in enumerate(gates, 1):
        along, points = b - a, path[start:]
        share = np.clip((points - a) @ along / (along @ along), 0.0, 1.0)
        distance = np.hypot(*(points - a - share[:, None] * along).T)
        touches = np.flatnonzero(distance <= RADIUS)
        if not len(touches):
            break
        start += int(touches[0])
        passed[start:] = number
    return passed
