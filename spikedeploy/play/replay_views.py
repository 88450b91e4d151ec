"""What a replay shows of one batch: ghosts on a track, or a robot that walks its walk again."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import gymnasium
import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy.envs.ghosts import Ghosts
from spikedeploy.envs.kart.scene import Scene, scene
from spikedeploy.envs.kart.track import Track
from spikedeploy.envs.rollout import Rollout
from spikedeploy.play.env_picture import stage
from spikedeploy.play.ghost_group import Crowd
from spikedeploy.play.spike_recorder import seen_by
from spikedeploy.play.theme import Colour

Facts = list[tuple[str, str]]


class ReplayView(Protocol):
    """One batch of a replay.

    length  control steps
    seed    of the episode that is looked at most closely
    legend  names of facts that are titles -> their colours
    """

    length: int
    seed: int
    legend: Mapping[str, Colour]

    def draw(self, step: int, size: tuple[int, int]) -> pygame.Surface:
        """The picture of a step."""

    def facts(self, step: int) -> Facts:
        """What a panel says of it: name and value."""

    def observations(self) -> NDArray[np.float64]:
        """What the leader saw, (S + 1, obs)."""

    def action(self, step: int) -> int | None:
        """The choice that the leader made there; None where actions are no choices."""


class GhostReel:
    """Ghosts on their track.

    crowd  the ghosts
    seen   (S + 1, obs) what the only ghost saw, where it was recorded
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
        self.crowd = Crowd(ghosts.drives, pushed=not env.get_wrapper_attr("TURNS"))
        self.length = self.crowd.length
        self._leader = None if self.crowd.leader is None else ghosts.drives[self.crowd.leader]
        self.seed = self._leader.seed if self._leader else -1
        self._enter()
        self._track: Track = env.get_wrapper_attr("track")
        self._steps = [ghost.env_step for ghost in ghosts.drives if ghost.env_step]

    def draw(self, step: int, size: tuple[int, int]) -> pygame.Surface:
        """The track with everybody on it."""
        from spikedeploy.play.ghost_picture import alone, draw_crowd, draw_leader, draw_legend

        surface, place, paint = self.ground(size), self.place(size), alone(self.crowd)
        draw_crowd(surface, place, self.crowd, step, paint)
        draw_legend(surface, paint)
        draw_leader(surface, place, self.crowd, step, paint.leader)
        return surface

    def ground(self, size: tuple[int, int]) -> pygame.Surface:
        """The track with its gates and nobody on it."""
        from spikedeploy.envs.kart.picture import draw_gates

        surface = self.place(size).ground.copy()
        draw_gates(surface, self.place(size), -1)
        return surface

    def place(self, size: tuple[int, int]) -> Scene:
        """The leader's track on a surface of this size."""
        return scene(self._track, size)

    def facts(self, step: int) -> Facts:
        """How many do what, and how the leader does."""
        count = self.crowd.count(step)
        facts = [
            ("driving", f"{count.driving:,}"),
            ("finished", f"{count.finished:,}"),
            ("crashed", f"{count.crashed:,}"),
            ("ghosts", f"{len(self.crowd.drives):,}"),
        ]
        if self._steps:
            facts.append(("training steps", f"{min(self._steps):,} – {max(self._steps):,}"))
        return facts + self._led(min(step, self._leader.steps) if self._leader else 0)

    def observations(self) -> NDArray[np.float64]:
        """What the world showed the leader, or would have shown it."""
        if self._seen is not None:
            return self._seen
        if self._leader is None:
            return np.zeros((0, 0))
        self._enter()
        return seen_by(self._leader, self._world)

    def action(self, step: int) -> int | None:
        """The choice that the leader made there."""
        ghost = self._leader
        if ghost is None or ghost.action.ndim != 1 or not ghost.steps:
            return None
        return int(ghost.action[min(step, ghost.steps - 1)])

    def led(self) -> str:
        """How the leader ended, and when."""
        ghost = self._leader
        if ghost is None:
            return "nobody"
        time = f"{ghost.steps * self._world.CONTROL_DT:.2f} s"
        if ghost.finish:
            return f"finish, {time}"
        return f"{ghost.gates} of {len(self._track.gates)} gates, {time}"

    def _enter(self) -> None:
        """Be on the leader's track, where tracks are drawn at random."""
        self._world.reset(seed=max(self.seed, 0))

    def _led(self, step: int) -> Facts:
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


class WalkReel:
    """A recorded episode, whose actions are played again in the same world.

    Going back means to begin anew, which is quick because nothing is drawn on the way.

    world   it walks in
    newest  what it observes now (obs,)
    """

    legend: Mapping[str, Colour] = {}

    def __init__(self, env: gymnasium.Env[Any, Any], played: Rollout) -> None:
        self._env, self._played = env, played
        self.world: Any = env.unwrapped
        self.length, self.seed = played.steps, played.seed
        self._at = 0
        self._begin()

    def draw(self, step: int, size: tuple[int, int]) -> pygame.Surface:
        """What the camera sees after so many steps."""
        self.go(min(step, self.length))
        return stage(self.world, size)

    def facts(self, step: int) -> Facts:
        """The numbers of the step infos."""
        at = min(max(step - 1, 0), self.length - 1)
        names = ("speed", "command_speed", "command_turn", "distance", "cot", "episode_return")
        found = [(name, self._played.info[name][at]) for name in names if name in self._played.info]
        return [(name.replace("_", " "), f"{value:.2f}") for name, value in found]

    def observations(self) -> NDArray[np.float64]:
        """What was recorded."""
        return self._played.observation

    def action(self, step: int) -> int | None:
        """Robots do not choose."""
        return None

    def go(self, step: int) -> None:
        """Be where the robot was after so many steps."""
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
        """Command what was commanded then, if that was a person's wish."""
        info = self._played.info
        if "command_speed" not in info:
            return
        wish = float(info["command_speed"][at]), float(info["command_turn"][at])
        if wish != self.world.command:  # the world's own commands come by themselves
            self.world.steer(*wish)


def action_names(world: Any, scores: int) -> Sequence[str]:  # noqa: ANN401
    """Names of the numbers that a policy puts out."""
    names: tuple[str, ...] = getattr(world, "ACTIONS", ())
    return names if len(names) == scores else [str(index) for index in range(scores)]
