"""`spikedeploy replay`: training episodes as ghosts, batch after batch or all at once."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium
import pygame

from spikedeploy import envs
from spikedeploy.make_env import make_env
from spikedeploy.play.env_picture import is_kart
from spikedeploy.play.overlay_view import OverlayReel, check_alike, distinct
from spikedeploy.play.playback import Playback
from spikedeploy.play.replay_source import Source, open_source
from spikedeploy.play.replay_views import GhostReel, ReplayView, WalkReel, action_names
from spikedeploy.play.spike_panel import WIDTH as THOUGHTS
from spikedeploy.play.spike_panel import draw_thoughts
from spikedeploy.play.spike_recorder import InferenceTrace, SpikeRecorder
from spikedeploy.play.theme import (
    AMBER,
    CYAN,
    DIM,
    PANEL,
    TEXT,
    bar,
    fitting,
    heading,
    keycaps,
    write,
)
from spikedeploy.policies.interface import check_fit
from spikedeploy.policies.registry import find
from spikedeploy.runtime.errors import ConfigError

HEIGHT = 800
WIDTH = 340
PAD = 26
KEYS = [
    ("SPACE", "pause"),
    ("← →", "seek"),
    ("↑ ↓", "speed"),
    ("N", "next batch"),
    ("B", "before"),
    ("P", "picture"),
    ("ESC", "leave"),
]
MODES = ("batch", "all")


class Replay:
    """A source on the screen, or several over one another.

    title, name, fps  as of a window.App
    playback          its time
    """

    fps = 60.0

    def __init__(
        self,
        sources: Mapping[str, Source],
        env: gymnasium.Env[Any, Any],
        mode: str = "batch",
        brain: SpikeRecorder | None = None,
        speed: float = 1.0,
    ) -> None:
        self._first = next(iter(sources.values()))
        self.name = envs.spec(self._first.env_id).short
        self._heading = self._first.name if len(sources) == 1 else f"{len(sources)} sources"
        self.title = f"{self._heading} – spikedeploy"
        self._sources, self._env, self._mode, self._brain = sources, env, mode, brain
        self._world: Any = env.unwrapped
        kart = is_kart(self._world)
        self._size = (HEIGHT, HEIGHT) if kart else (HEIGHT * 4 // 3, HEIGHT)
        batches = max(map(len, sources.values())) if mode == "batch" else 1
        dt = float(env.get_wrapper_attr("CONTROL_DT"))
        self.playback = Playback(batches, dt, speed=speed)
        self._reel = lru_cache(maxsize=4)(self._cut)
        self._think = lru_cache(maxsize=2)(self._thought)
        self._load()

    def open(self, batch: int) -> None:
        """Go to the start of a batch, counted from 0."""
        self.playback.turn(batch - self.playback.batch)
        self._load()

    def handle(self, event: pygame.Event) -> None:
        """Every key is the playback's."""
        self.playback.handle(event)
        self._load()

    def tick(self) -> None:
        """The time of one frame."""
        self.playback.tick(1.0 / self.fps)
        self._load()

    def draw(self) -> pygame.Surface:
        """The reel, the spikes of the leader, and the panel."""
        width, height = self._size
        thoughts = THOUGHTS if self._brain else 0
        surface = pygame.Surface((width + thoughts + WIDTH, height))
        surface.blit(self.reel.draw(self.playback.now, self._size), (0, 0))
        if self._brain:
            self._draw_thoughts(surface, pygame.Rect(width, 0, thoughts, height))
        self._draw_panel(surface, pygame.Rect(width + thoughts, 0, WIDTH, height))
        return surface

    @property
    def reel(self) -> ReplayView:
        """The batch that is on."""
        return self._reel(self.playback.batch)

    @property
    def thoughts(self) -> InferenceTrace | None:
        """What the policy does while it sees what the leader saw."""
        return self._think(self.playback.batch)

    def _load(self) -> None:
        self.playback.length = self.reel.length

    def _cut(self, batch: int) -> ReplayView:
        if self._first.rollout is not None and not is_kart(self._world):
            return WalkReel(self._env, self._first.rollout)
        if len(self._sources) == 1:
            return self._ghosts(self._first, batch)
        return OverlayReel({name: self._ghosts(s, batch) for name, s in self._sources.items()})

    def _ghosts(self, source: Source, batch: int) -> GhostReel:
        """A batch of a source; of one that has fewer, the last."""
        index = min(batch, len(source) - 1)
        ghosts = source.everything() if self._mode == "all" else source.batch(index)
        seen = None if source.rollout is None else source.rollout.observation
        return GhostReel(self._env, ghosts, seen)

    def _thought(self, batch: int) -> InferenceTrace | None:
        observations = self._reel(batch).observations()
        if self._brain is None or not len(observations):
            return None
        return self._brain.think(observations, self._reel(batch).seed)

    def _draw_thoughts(self, surface: pygame.Surface, place: pygame.Rect) -> None:
        pygame.draw.rect(surface, PANEL, place)
        thoughts = self.thoughts
        if thoughts is None or self._brain is None:
            return
        step = min(self.playback.now, len(thoughts.scores) - 1)
        names = action_names(self._world, thoughts.scores.shape[1])
        taken = self.reel.action(step)
        draw_thoughts(surface, place, self._brain.name, thoughts, step, names, taken)

    def _draw_panel(self, surface: pygame.Surface, place: pygame.Rect) -> None:
        """What is replayed, where it is, and the facts of the reel."""
        pygame.draw.rect(surface, PANEL, place)
        inner = place.inflate(-2 * PAD, -2 * PAD)
        track = f" · {self._world.track.name}" if is_kart(self._world) else ""
        write(surface, self.name + track, inner.topleft, 20, TEXT, "bold")
        write(surface, self._heading, (inner.left, inner.top + 28), 12, DIM)
        self._draw_facts(surface, inner, self._draw_time(surface, inner, inner.top + 66))
        keycaps(surface, KEYS, (inner.left, inner.bottom - 106), inner.width)

    def _draw_facts(self, surface: pygame.Surface, inner: pygame.Rect, y: int) -> None:
        """Names and values; below the names of sources, closer together."""
        legend = self.reel.legend
        size, gap = (12, 20) if legend else (14, 26)
        for name, value in self.reel.facts(self.playback.now):
            if name in legend:
                pygame.draw.aacircle(surface, legend[name], (inner.left + 6, y + 8), 6)
                text = fitting(name, inner.width - 20, size, "bold")
                write(surface, text, (inner.left + 20, y), size, TEXT, "bold")
            else:
                write(surface, name, (inner.left + 20 * bool(legend), y), size, DIM)
                last = name == "leader" and bool(legend)
                write(surface, value, (inner.right, y), size, TEXT, "plain", "topright")
                y += 10 * last
            y += gap

    def _draw_time(self, surface: pygame.Surface, inner: pygame.Rect, y: int) -> int:
        play = self.playback
        heading(surface, "time", (inner.left, y))
        number = write(surface, f"{play.now * play.dt:.2f}", (inner.left, y + 14), 40, TEXT, "bold")
        whole = f"/ {play.length * play.dt:.2f} s"
        write(surface, whole, (number.right + 8, number.bottom - 8), 14, DIM, anchor="bottomleft")
        speed = "paused" if play.paused else f"× {play.speed:g}"
        write(surface, speed, (inner.right, y + 30), 16, AMBER, "bold", "topright")
        place = pygame.Rect(inner.left, y + 70, inner.width, 8)
        bar(surface, place, play.now / max(play.length, 1), CYAN)
        y += 100
        heading(surface, "batch", (inner.left, y))
        told = "all" if self._mode == "all" else f"{play.batch + 1} / {play.batches}"
        write(surface, told, (inner.right, y - 4), 16, TEXT, "bold", "topright")
        share = 1.0 if self._mode == "all" else (play.batch + 1) / play.batches
        bar(surface, pygame.Rect(inner.left, y + 20, inner.width, 6), share, AMBER)
        return y + 50


def replay(
    path: Path,
    mode: str = "batch",
    batch: int = 1,
    spikes: str | None = None,
    chip: str = "loihi1",
    speed: float = 1.0,
    options: Mapping[str, Any] | None = None,
    beside: Sequence[Path] = (),
) -> Replay:
    """The app that `replay` shows.

    path     run folder, folder of ghost files, ghost file, or rollout
    mode     one of MODES
    batch    the first that is shown, from 1 on
    spikes   spiking policy whose spikes are shown beside, while it sees what the leader saw
    chip     that it runs on
    options  of the environment, which go before those in the file
    beside   further sources of the same world, laid over the first
    """
    if mode not in MODES:
        raise ConfigError(f"--mode {mode}: choose {' or '.join(MODES)}")
    if not 0.0 < speed <= 100.0:
        raise ConfigError(f"--speed {speed:g}: choose a factor above 0, up to 100; 1 is real time")
    paths = (path, *beside)
    sources = [open_source(each) for each in paths]
    check_alike(sources, options or {})
    first = sources[0]
    env = make_env(first.env_id, {**first.options, **(options or {})}, render_mode="rgb_array")
    if beside and not is_kart(env.unwrapped):
        raise ConfigError(f"{first.name} is a walk: only drives of karts are laid over one another")
    named = dict(zip(distinct(paths), sources, strict=True))
    app = Replay(named, env, mode, _brain(spikes, chip, env), speed)
    if not 1 <= batch <= app.playback.batches:
        raise ConfigError(f"--batch {batch}: {first.name} has 1 to {app.playback.batches}")
    app.open(batch - 1)
    return app


def _brain(spikes: str | None, chip: str, env: gymnasium.Env[Any, Any]) -> SpikeRecorder | None:
    if spikes is None:
        return None
    candidate = find(spikes)
    check_fit(candidate, env)
    return SpikeRecorder(candidate, chip)
