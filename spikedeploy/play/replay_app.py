"""`spikedeploy replay`: episodes of a training as ghosts, batch by batch or all at once."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium
import pygame

from spikedeploy import envs
from spikedeploy.make_env import make_env
from spikedeploy.play.env_picture import is_kart
from spikedeploy.play.overlay_view import OverlayView, check_same_world, distinct_names
from spikedeploy.play.playback import Playback
from spikedeploy.play.replay_source import Source, open_source
from spikedeploy.play.replay_views import GhostView, ReplayView, RolloutView, action_names
from spikedeploy.play.spike_panel import WIDTH as SPIKES_WIDTH
from spikedeploy.play.spike_panel import draw_inference
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
from spikedeploy.policies.registry import check_fit, find
from spikedeploy.runtime.errors import ConfigError

_HEIGHT = 800
WIDTH = 340
_PAD = 26
_KEYS = [
    ("SPACE", "pause"),
    ("← →", "seek"),
    ("↑ ↓", "speed"),
    ("N", "next batch"),
    ("B", "before"),
    ("P", "picture"),
    ("ESC", "leave"),
]
_MODES = ("batch", "all")


class ReplayApp:
    """The app: one source, or several on one track.

    title, name, fps  as of a window.App
    playback          position and speed
    """

    fps = 60.0

    def __init__(
        self,
        sources: Mapping[str, Source],
        env: gymnasium.Env[Any, Any],
        mode: str = "batch",
        recorder: SpikeRecorder | None = None,
        speed: float = 1.0,
    ) -> None:
        self._first = next(iter(sources.values()))
        self.name = envs.spec(self._first.env_id).short
        self._heading = self._first.name if len(sources) == 1 else f"{len(sources)} sources"
        self.title = f"{self._heading} – spikedeploy"
        self._sources, self._env, self._mode, self._recorder = (
            sources,
            env,
            mode,
            recorder,
        )
        self._world: Any = env.unwrapped
        kart = is_kart(self._world)
        self._size = (_HEIGHT, _HEIGHT) if kart else (_HEIGHT * 4 // 3, _HEIGHT)
        batches = max(map(len, sources.values())) if mode == "batch" else 1
        dt = float(env.get_wrapper_attr("CONTROL_DT"))
        self.playback = Playback(batches, dt, speed=speed)
        self._view = lru_cache(maxsize=4)(self._open_view)
        self._record = lru_cache(maxsize=2)(self._recorded)
        self._load()

    def open(self, batch: int) -> None:
        """Go to the start of a batch, counted from 0."""
        self.playback.skip(batch - self.playback.batch)
        self._load()

    def handle(self, event: pygame.Event) -> None:
        """Pass a key to the playback."""
        self.playback.handle(event)
        self._load()

    def tick(self) -> None:
        """Advance by one frame."""
        self.playback.tick(1.0 / self.fps)
        self._load()

    def draw(self) -> pygame.Surface:
        """The view, the spikes of the leader, and the panel."""
        width, height = self._size
        inferences = SPIKES_WIDTH if self._recorder else 0
        surface = pygame.Surface((width + inferences + WIDTH, height))
        surface.blit(self.view.draw(self.playback.now, self._size), (0, 0))
        if self._recorder:
            self._draw_inferences(surface, pygame.Rect(width, 0, inferences, height))
        self._draw_panel(surface, pygame.Rect(width + inferences, 0, WIDTH, height))
        return surface

    @property
    def view(self) -> ReplayView:
        """The current batch."""
        return self._view(self.playback.batch)

    @property
    def inferences(self) -> InferenceTrace | None:
        """Inferences of the policy on the observations of the leader."""
        return self._record(self.playback.batch)

    def _load(self) -> None:
        self.playback.length = self.view.length

    def _open_view(self, batch: int) -> ReplayView:
        if self._first.rollout is not None and not is_kart(self._world):
            return RolloutView(self._env, self._first.rollout)
        if len(self._sources) == 1:
            return self._ghosts(self._first, batch)
        return OverlayView({name: self._ghosts(s, batch) for name, s in self._sources.items()})

    def _ghosts(self, source: Source, batch: int) -> GhostView:
        """A batch of a source; its last one where it has fewer."""
        index = min(batch, len(source) - 1)
        ghosts = source.everything() if self._mode == "all" else source.batch(index)
        seen = None if source.rollout is None else source.rollout.observation
        return GhostView(self._env, ghosts, seen)

    def _recorded(self, batch: int) -> InferenceTrace | None:
        observations = self._view(batch).observations()
        if self._recorder is None or not len(observations):
            return None
        return self._recorder.record(observations, self._view(batch).seed)

    def _draw_inferences(self, surface: pygame.Surface, place: pygame.Rect) -> None:
        pygame.draw.rect(surface, PANEL, place)
        inferences = self.inferences
        if inferences is None or self._recorder is None:
            return
        step = min(self.playback.now, len(inferences.scores) - 1)
        names = action_names(self._world, inferences.scores.shape[1])
        taken = self.view.action(step)
        draw_inference(surface, place, self._recorder.name, inferences, step, names, taken)

    def _draw_panel(self, surface: pygame.Surface, place: pygame.Rect) -> None:
        """Name, position in time, and the facts of the view."""
        pygame.draw.rect(surface, PANEL, place)
        inner = place.inflate(-2 * _PAD, -2 * _PAD)
        track = f" · {self._world.track.name}" if is_kart(self._world) else ""
        write(surface, self.name + track, inner.topleft, 20, TEXT, "bold")
        write(surface, self._heading, (inner.left, inner.top + 28), 12, DIM)
        self._draw_facts(surface, inner, self._draw_time(surface, inner, inner.top + 66))
        keycaps(surface, _KEYS, (inner.left, inner.bottom - 106), inner.width)

    def _draw_facts(self, surface: pygame.Surface, inner: pygame.Rect, y: int) -> None:
        """Names and values, in smaller type where there are several sources."""
        legend = self.view.legend
        size, gap = (12, 20) if legend else (14, 26)
        for name, value in self.view.facts(self.playback.now):
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
        counter = "all" if self._mode == "all" else f"{play.batch + 1} / {play.batches}"
        write(surface, counter, (inner.right, y - 4), 16, TEXT, "bold", "topright")
        share = 1.0 if self._mode == "all" else (play.batch + 1) / play.batches
        bar(surface, pygame.Rect(inner.left, y + 20, inner.width, 6), share, AMBER)
        return y + 50


def open_replay(
    path: Path,
    mode: str = "batch",
    batch: int = 1,
    spikes: str | None = None,
    chip: str = "loihi1",
    speed: float = 1.0,
    options: Mapping[str, Any] | None = None,
    beside: Sequence[Path] = (),
) -> ReplayApp:
    """The app for `spikedeploy replay`.

    path     run folder, folder of ghost files, ghost file, or rollout
    mode     one of MODES
    batch    the first that is shown, from 1 on
    spikes   spiking policy whose spikes on the leader's observations are shown
    chip     of that policy
    options  of the environment; they take precedence over the file
    beside   further sources of the same environment, on the same track
    """
    if mode not in _MODES:
        raise ConfigError(f"--mode {mode}: choose {' or '.join(_MODES)}")
    if not 0.0 < speed <= 100.0:
        raise ConfigError(f"--speed {speed:g}: choose a factor above 0, up to 100; 1 is real time")
    paths = (path, *beside)
    sources = [open_source(each) for each in paths]
    check_same_world(sources, options or {})
    first = sources[0]
    env = make_env(first.env_id, {**first.options, **(options or {})}, render_mode="rgb_array")
    if beside and not is_kart(env.unwrapped):
        raise ConfigError(f"{first.name} is no kart: only karts can be shown together")
    named = dict(zip(distinct_names(paths), sources, strict=True))
    app = ReplayApp(named, env, mode, _recorder(spikes, chip, env), speed)
    if not 1 <= batch <= app.playback.batches:
        raise ConfigError(f"--batch {batch}: {first.name} has 1 to {app.playback.batches}")
    app.open(batch - 1)
    return app


def _recorder(spikes: str | None, chip: str, env: gymnasium.Env[Any, Any]) -> SpikeRecorder | None:
    if spikes is None:
        return None
    candidate = find(spikes)
    check_fit(candidate, env)
    return SpikeRecorder(candidate, chip)
