"""Views of one batch of a replay: ghosts on a track, or a robot's episode simulated again.

A ghost records poses only; what its policy observed is computed along its path.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import gymnasium
import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy.envs.ghosts import Ghost, Ghosts
from spikedeploy.envs.kart.picture import Scene, scene
from spikedeploy.envs.kart.track import Track
from spikedeploy.envs.rollout import Rollout
from spikedeploy.play.env_picture import env_picture
from spikedeploy.play.ghost_group import GhostGroup
from spikedeploy.play.theme import Colour

Floats = NDArray[np.float64]
_RADIUS = 19.2  # [px] of a kart


def ghost_observations(ghost: Ghost, world: Any) -> Floats:  # noqa: ANN401
    """Observations (S + 1, obs) that the environment would have made at the poses of a ghost."""
    pose = ghost.pose.astype(np.float64)
    turn = _turn(pose[:, 2]) / world.CONTROL_DT
    if "forward" in world.ACTIONS:  # turns are observed a step before the kart moves
        turn = np.append(turn[1:], 0.0)
    velocity = ghost.speed[:, None] * _direction(pose, not world.TURNS)
    gates = gates_passed(pose[:, :2], world.track.gates)
    return np.stack(
        [
            world.observe_at(*pose[k], velocity[k], float(turn[k]), int(gates[k]))
            for k in range(len(pose))
        ]
    )


def gates_passed(path: Floats, gates: Floats) -> NDArray[np.int64]:
    """Number of gates passed in order at each point of a path (S + 1,)."""
    passed = np.zeros(len(path), np.int64)
    start = 0
    for number, (a, b) in enumerate(gates, 1):
        touches = np.flatnonzero(_distance(path[start:], a, b) <= _RADIUS)
        if not len(touches):
            break
        start += int(touches[0])
        passed[start:] = number
    return passed


def _distance(points: Floats, a: Floats, b: Floats) -> Floats:
    """Distances (n,) of points (n, 2) from a segment."""
    along = b - a
    share = np.clip((points - a) @ along / (along @ along), 0.0, 1.0)
    found: Floats = np.hypot(*(points - a - share[:, None] * along).T)
    return found


def _turn(heading: Floats) -> Floats:
    """Change of heading [rad] in the step before (S + 1,)."""
    change = np.diff(heading, prepend=heading[:1])
    found: Floats = (change + np.pi) % (2 * np.pi) - np.pi
    return found


def _direction(pose: Floats, pushed: bool) -> Floats:
    """Unit direction of motion (S + 1, 2): the heading, or if it has none (`pushed`) the path."""
    if not pushed:
        return np.stack((np.cos(pose[:, 2]), np.sin(pose[:, 2])), axis=1)
    moved = np.diff(pose[:, :2], axis=0, prepend=pose[:1, :2])
    found: Floats = moved / np.maximum(np.hypot(*moved.T), 1e-9)[:, None]
    return found


Facts = list[tuple[str, str]]


class ReplayView(Protocol):
    """One batch of a replay.

    length  control steps
    seed    of the leader's episode
    legend  names of facts that are titles -> their colours
    """

    length: int
    seed: int
    legend: Mapping[str, Colour]

    def draw(self, step: int, size: tuple[int, int]) -> pygame.Surface:
        """The picture of a step."""

    def facts(self, step: int) -> Facts:
        """Names and values for the panel."""

    def observations(self) -> NDArray[np.float64]:
        """The observations of the leader (S + 1, obs)."""

    def action(self, step: int) -> int | None:
        """The discrete action of the leader; None where actions are continuous."""


class GhostView:
    """Ghosts on their track.

    group  the ghosts
    seen   (S + 1, obs) recorded observations of a single ghost, if any
    """

    legend: Mapping[str, Colour] = {}

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        ghosts: Ghosts,
        seen: NDArray[np.float64] | None = None,
    ) -> None:
        self._seen = seen
        self._world: Any = env.unwrapped
        self.group = GhostGroup(ghosts.drives, pushed=not env.get_wrapper_attr("TURNS"))
        self.length = self.group.length
        self._leader = None if self.group.leader is None else ghosts.drives[self.group.leader]
        self.seed = self._leader.seed if self._leader else -1
        self._reset()
        self._track: Track = env.get_wrapper_attr("track")
        self._steps = [ghost.env_step for ghost in ghosts.drives if ghost.env_step]

    def draw(self, step: int, size: tuple[int, int]) -> pygame.Surface:
        """The track with all ghosts."""
        from spikedeploy.play.ghost_picture import (
            colours_by_age,
            draw_group,
            draw_leader,
            draw_legend,
        )

        surface, place, colours = self.ground(size), self.place(size), colours_by_age(self.group)
        draw_group(surface, place, self.group, step, colours)
        draw_legend(surface, colours)
        draw_leader(surface, place, self.group, step, colours.leader)
        return surface

    def ground(self, size: tuple[int, int]) -> pygame.Surface:
        """The track with its gates, without ghosts."""
        from spikedeploy.envs.kart.picture import draw_gates

        surface = self.place(size).ground.copy()
        draw_gates(surface, self.place(size), -1)
        return surface

    def place(self, size: tuple[int, int]) -> Scene:
        """The leader's track on a surface of this size."""
        return scene(self._track, size)

    def facts(self, step: int) -> Facts:
        """Counts of ghosts, and the state of the leader."""
        count = self.group.count(step)
        facts = [
            ("driving", f"{count.driving:,}"),
            ("finished", f"{count.finished:,}"),
            ("crashed", f"{count.crashed:,}"),
            ("ghosts", f"{len(self.group.drives):,}"),
        ]
        if self._steps:
            facts.append(("training steps", f"{min(self._steps):,} – {max(self._steps):,}"))
        return facts + self._leader_facts(min(step, self._leader.steps) if self._leader else 0)

    def observations(self) -> NDArray[np.float64]:
        """Recorded observations of the leader, else reconstructed ones."""
        if self._seen is not None:
            return self._seen
        if self._leader is None:
            return np.zeros((0, 0))
        self._reset()
        return ghost_observations(self._leader, self._world)

    def action(self, step: int) -> int | None:
        """The discrete action of the leader."""
        ghost = self._leader
        if ghost is None or ghost.action.ndim != 1 or not ghost.steps:
            return None
        return int(ghost.action[min(step, ghost.steps - 1)])

    def leader_result(self) -> str:
        """The outcome and time of the leader."""
        ghost = self._leader
        if ghost is None:
            return "nobody"
        time = f"{ghost.steps * self._world.CONTROL_DT:.2f} s"
        if ghost.finish:
            return f"finish, {time}"
        return f"{ghost.gates} of {len(self._track.gates)} gates, {time}"

    def _reset(self) -> None:
        """Reset with the leader's seed, which decides a random track."""
        self._world.reset(seed=max(self.seed, 0))

    def _leader_facts(self, step: int) -> Facts:
        ghost = self._leader
        if ghost is None:
            return []
        end = "finish" if ghost.finish else "crash" if ghost.crash else "no finish"
        return [
            ("leader", f"{end}, {ghost.gates} of {len(self._track.gates)} gates"),
            ("its time", f"{ghost.steps * self._world.CONTROL_DT:.2f} s"),
            ("its speed", f"{ghost.speed[step] / 100:.2f} m/s"),
            ("its reward", f"{ghost.reward[:step].sum():+.2f}"),
        ]


class RolloutView:
    """A recorded episode, whose actions are simulated again.

    Seeking back restarts the episode, which is fast because nothing is rendered meanwhile.

    world   the environment
    newest  the last observation (obs,)
    """

    legend: Mapping[str, Colour] = {}

    def __init__(self, env: gymnasium.Env[Any, Any], played: Rollout) -> None:
        self._env, self._played = env, played
        self.world: Any = env.unwrapped
        self.length, self.seed = played.steps, played.seed
        self._at = 0
        self._begin()

    def draw(self, step: int, size: tuple[int, int]) -> pygame.Surface:
        """The camera picture after that many steps."""
        self.go(min(step, self.length))
        return env_picture(self.world, size)

    def facts(self, step: int) -> Facts:
        """Numbers of the step infos."""
        at = min(max(step - 1, 0), self.length - 1)
        names = ("speed", "command_speed", "command_turn", "distance", "cot", "episode_return")
        found = [(name, self._played.info[name][at]) for name in names if name in self._played.info]
        return [(name.replace("_", " "), f"{value:.2f}") for name, value in found]

    def observations(self) -> NDArray[np.float64]:
        """The recorded observations."""
        return self._played.observation

    def action(self, step: int) -> int | None:
        """None: actions are continuous."""
        return None

    def go(self, step: int) -> None:
        """Simulate up to a step."""
        if step < self._at:
            self._begin()
        for at in range(self._at, step):
            self._command(at)
            self.newest = self._env.step(self._played.action[at])[0]
        self._at = step

    def _begin(self) -> None:
        self.newest = self._env.reset(seed=self.seed)[0]
        self._at = 0

    def _command(self, at: int) -> None:
        """Repeat a command that a person gave."""
        info = self._played.info
        if "command_speed" not in info:
            return
        command = float(info["command_speed"][at]), float(info["command_turn"][at])
        if command != self.world.command:  # commands of the environment itself recur
            self.world.steer(*command)


def action_names(world: Any, scores: int) -> Sequence[str]:  # noqa: ANN401
    """Names of a policy's scores."""
    names: tuple[str, ...] = getattr(world, "ACTIONS", ())
    return names if len(names) == scores else [str(index) for index in range(scores)]
