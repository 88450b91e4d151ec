"""`spikedeploy play`: drive with the keys, command a robot, or watch a policy."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import pygame

from spikedeploy import envs, zoo
from spikedeploy.make_env import make_env
from spikedeploy.play.drive_panel import WIDTH, draw_drive_panel
from spikedeploy.play.drivers import (
    CombinedKeysDriver,
    CommandedPolicyDriver,
    Driver,
    KeyboardDriver,
    PolicyDriver,
)
from spikedeploy.play.driving_network import DrivingNetwork
from spikedeploy.play.env_picture import env_picture, is_kart
from spikedeploy.play.replay_views import action_names
from spikedeploy.play.session import Session
from spikedeploy.play.spike_panel import WIDTH as SPIKES_WIDTH
from spikedeploy.play.spike_panel import draw_inference
from spikedeploy.play.theme import GREEN, PANEL, RED, banner
from spikedeploy.policies.nir import NirController
from spikedeploy.policies.registry import Candidate, find
from spikedeploy.recordings.episode import traced
from spikedeploy.runtime.errors import ConfigError

_HEIGHT = 800
_SIZES = {
    True: (_HEIGHT, _HEIGHT),
    False: (_HEIGHT * 4 // 3, _HEIGHT),
}  # of a track, of a camera's view


class DriveApp:
    """The app: a session and its panel.

    title, name, fps  as of a window.App
    """

    def __init__(self, session: Session, env: str) -> None:
        self.session = session
        self.name = envs.spec(env).short
        self.title = f"{self.name} – spikedeploy"
        self.fps = 1.0 / session.period
        track = getattr(session.world, "track", None)
        self._heading = f"{self.name} · {track.name}" if track else self.name
        self._size = _SIZES[is_kart(session.world)]

    def handle(self, event: pygame.Event) -> None:
        """R restarts; any other key is passed to the driver."""
        if event.type == pygame.KEYDOWN and event.key == pygame.K_r:
            self.session.restart()
        else:
            self.session.driver.handle(event)

    def tick(self) -> None:
        """One control step."""
        self.session.tick()

    def draw(self) -> pygame.Surface:
        """The environment, the panel, and a banner at the end of an episode."""
        width, height = self._size
        spikes = SPIKES_WIDTH if self.session.driver.network else 0
        surface = pygame.Surface((width + spikes + WIDTH, height))
        seen = surface.blit(env_picture(self.session.world, self._size), (0, 0))
        if spikes:
            self._draw_spikes(surface, pygame.Rect(width, 0, spikes, height))
        place = pygame.Rect(width + spikes, 0, WIDTH, height)
        draw_drive_panel(surface, place, self.session, self._heading)
        if self.session.waiting:
            outcome = self.session.outcomes[-1]
            time = "" if outcome.seconds is None else f"  {outcome.seconds:.2f} s"
            banner(surface, seen, outcome.word + time, GREEN if outcome.good else RED)
        return surface

    def _draw_spikes(self, surface: pygame.Surface, place: pygame.Rect) -> None:
        driver = self.session.driver
        trace = driver.network.trace if driver.network else None
        if trace is None:
            pygame.draw.rect(surface, PANEL, place)
            return
        names = action_names(self.session.world, trace.scores.shape[1])
        draw_inference(surface, place, driver.name, trace, len(trace.scores) - 1, names, None)


def open_session(
    env: str,
    options: Mapping[str, Any],
    policy: str | None,
    chip: str | None,
    seed: int,
    record: Path | None = None,
) -> Session:
    """The session of `spikedeploy play`.

    env      short name or id
    options  of the environment
    policy   None for a person where keys can drive, else for a shipped policy
    chip     of a spiking policy; None is that of its training, or DEFAULT_CHIP
    """
    if record is not None and record.suffix != ".npz":
        raise ConfigError(f"--record {record}: a drive is kept in a file that ends in .npz")
    world = make_env(env, options, render_mode="rgb_array")
    return Session(world, _driver(env, world, policy, chip), seed, record)


def _driver(env: str, world: Any, policy: str | None, chip: str | None) -> Driver:  # noqa: ANN401
    """A person where keys can drive and no policy is named, else a policy."""
    if policy is None and hasattr(world.unwrapped, "ACTIONS"):
        if chip is not None:
            raise ConfigError("--chip is for a policy: name one with --policy")
        return _person(world)
    candidate = _shipped(env) if policy is None else find(policy)
    chip = chip or candidate.default_chip
    player = traced(candidate, chip, world, "total")
    if isinstance(player, NirController):
        player = DrivingNetwork(player)
    name = f"{candidate.name} on {chip}" if chip else candidate.name
    if hasattr(world.unwrapped, "steer"):
        return CommandedPolicyDriver(player, name, world.unwrapped)
    return PolicyDriver(player, name)


def _person(env: gymnasium.Env[Any, Any]) -> Driver:
    """A person at the keys, one action at a time or several together."""
    world: Any = env.unwrapped
    if isinstance(env.action_space, gymnasium.spaces.Discrete):
        return KeyboardDriver(world.ACTIONS)
    return CombinedKeysDriver(world.ACTIONS, world.EFFECTS)


def _shipped(env: str) -> Candidate:
    """A shipped policy of the environment, a spiking one if there is one."""
    spec = envs.spec(env)
    found = [find(str(path)) for path in zoo.policies(spec.short)]
    spiking = [candidate for candidate in found if candidate.kind == "snn"]
    return (spiking or found or [find(spec.controls[0])])[0]
