"""`spikedeploy replay`: episodes of a training as ghosts, or a recorded episode, also as a film."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium
import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.envs.ghosts import Ghost, Ghosts
from spikedeploy.envs.rollout import Rollout
from spikedeploy.make_env import make_env
from spikedeploy.outputs import mark
from spikedeploy.play.ghosts import COLOURS, Facts, GhostView
from spikedeploy.play.spikes import WIDTH as SPIKES_WIDTH
from spikedeploy.play.spikes import InferenceTrace, draw_inference, trace_of
from spikedeploy.play.theme import (
    AMBER,
    DIM,
    TEXT,
    Colour,
    Panel,
    env_picture,
    is_kart,
    picture_size,
    shorten,
    write,
)
from spikedeploy.play.window import App
from spikedeploy.policies.nir import NirController
from spikedeploy.policies.registry import check_fit, find
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix
from spikedeploy.video import Frame, gif, mp4

Floats = NDArray[np.float64]
_MODES = ("batch", "all")


# sources


@dataclass(frozen=True)
class Source:
    """Batches of ghosts of one environment, or one recorded rollout.

    name     for people
    env_id   gymnasium's identifier
    options  of the environment
    files    (n,) ghost files in order; empty for a rollout
    rollout  the recorded rollout, where the source is one
    """

    name: str
    env_id: str
    options: Mapping[str, Any]
    files: Sequence[Path] = ()
    rollout: Rollout | None = None

    def __len__(self) -> int:
        return len(self.files) if self.rollout is None else 1

    def batch(self, index: int | None) -> Sequence[Ghost]:
        """The ghosts of one batch, of the last one for larger numbers, or of all for None."""
        if self.rollout is not None:
            return Ghosts.from_rollout(self.rollout).drives
        if index is None:
            return [ghost for file in self.files for ghost in _read(file).drives]
        return _read(self.files[min(index, len(self) - 1)]).drives


@lru_cache(maxsize=8)
def _read(path: Path) -> Ghosts:
    return Ghosts.load(path)


def open_source(path: Path) -> Source:
    """The source in a run folder, a folder of ghost files, a ghost file or a rollout."""
    files, name = [path], path.stem
    if path.is_dir():
        folder = path / "ghosts" if (path / "ghosts").is_dir() else path
        files, name = sorted(folder.glob("*.npz")), path.resolve().name
        if not files:
            raise ConfigError(
                f"{path}: no ghosts in it; the trainers of karts write them to ghosts/ of a run "
                "folder"
            )
    elif not path.is_file():
        raise ConfigError(f"{path}: no such run folder, ghost file or rollout")
    elif _is_rollout(path):
        played = Rollout.load(path)
        return Source(name, played.env_id, played.options, rollout=played)
    first = _read(files[0])
    return Source(name, first.env_id, first.options, files)


def _is_rollout(path: Path) -> bool:
    """True of an archive with observations; not of what is none, which its reader refuses."""
    with suppress(Exception), np.load(path, allow_pickle=False) as archive:
        return "observation" in getattr(archive, "files", [])
    return False


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """Distinct names of sources: the shortest ends of their paths that differ."""
    full = [path.resolve().with_suffix("") if path.is_file() else path.resolve() for path in paths]
    repeated = next((path for n, path in enumerate(paths) if full[n] in full[:n]), None)
    if repeated is not None:
        raise ConfigError(f"{repeated} is named twice; lay each source over the others once")
    parts = [[part for part in path.parts if part != "ghosts"] for path in full]
    for length in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-length:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in paths]


def _check_same_world(first: Source, others: Sequence[Source], options: Mapping[str, Any]) -> None:
    """Refuse other environments or tracks; observations and rewards may differ."""
    for other in others:
        ours, theirs = _world(first, options), _world(other, options)
        if ours != theirs:
            raise ConfigError(
                f"{other.name} was driven in {theirs}, {first.name} in {ours}: only sources of one "
                "environment and track can be shown together"
            )


def _world(source: Source, options: Mapping[str, Any]) -> str:
    """Environment and track of a source, in words."""
    short = envs.spec(source.env_id).short
    track = {"track": "big_S", **source.options, **options}["track"]
    place = Path(str(track))
    return f"{short} on {place.resolve() if suffix(place) == '.json' else place}"


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
        self.length, self.seed, self._at = played.steps, played.seed, played.steps + 1
        self.go(0)

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

    def observations(self) -> Floats:
        """The recorded observations."""
        return self._played.observation

    def action(self, step: int) -> int | None:
        """None: actions are continuous."""
        return None

    def go(self, step: int) -> None:
        """Simulate up to a step."""
        if step < self._at:
            self.newest, self._at = self._env.reset(seed=self.seed)[0], 0
        info = self._played.info
        for at in range(self._at, step):
            # a person's command is given again; those of the environment itself recur
            if "command_speed" in info:
                command = float(info["command_speed"][at]), float(info["command_turn"][at])
                if command != self.world.command:
                    self.world.steer(*command)
            if "course" in info:
                self.world.steer(float(info["course"][at]))
            self.newest = self._env.step(self._played.action[at])[0]
        self._at = step


# time

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
            jump = _JUMP if event.key == pygame.K_RIGHT else -_JUMP
            self.step = min(max(self.step + jump / self.dt, 0.0), float(self.length))
        elif event.key in (pygame.K_UP, pygame.K_DOWN):
            nearest = min(range(len(_SPEEDS)), key=lambda k: abs(_SPEEDS[k] - self.speed))
            nearest += 1 if event.key == pygame.K_UP else -1
            self.speed = _SPEEDS[min(max(nearest, 0), len(_SPEEDS) - 1)]
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

    def skip(self, batches: int) -> None:
        """Skip batches, cyclically."""
        self.batch = (self.batch + batches) % self.batches
        self.step = 0.0


# the app

_WIDTH = 340  # of the panel
_KEYS = [
    ("SPACE", "pause"),
    ("← →", "seek"),
    ("↑ ↓", "speed"),
    ("N", "next batch"),
    ("B", "before"),
    ("P", "picture"),
    ("ESC", "leave"),
]


class ReplayApp(App):
    """The app: one source, or several on one track.

    playback  position and speed
    spikes    name of a policy and its player, whose spikes are shown beside the leader
    """

    fps = 60.0

    def __init__(
        self,
        sources: Mapping[str, Source],
        env: gymnasium.Env[Any, Any],
        mode: str,
        spikes: tuple[str, NirController] | None,
        speed: float,
    ) -> None:
        self._first = next(iter(sources.values()))
        self.name = envs.spec(self._first.env_id).short
        self._heading = self._first.name if len(sources) == 1 else f"{len(sources)} sources"
        self.title = f"{self._heading} – spikedeploy"
        self._sources, self._env, self._is_all, self._spikes = sources, env, mode == "all", spikes
        self._world: Any = env.unwrapped
        self._size = picture_size(self._world)
        batches = 1 if self._is_all else max(map(len, sources.values()))
        dt = float(env.get_wrapper_attr("CONTROL_DT"))
        self.playback = Playback(batches, dt, speed=speed)
        self._view = lru_cache(maxsize=4)(self._open_view)
        self._trace = lru_cache(maxsize=2)(self._record)
        self.playback.length = self.view.length

    def open(self, batch: int) -> None:
        """Go to the start of a batch, counted from 0."""
        self.playback.skip(batch - self.playback.batch)
        self.playback.length = self.view.length

    def handle(self, event: pygame.Event) -> None:
        """Pass a key to the playback."""
        self.playback.handle(event)
        self.playback.length = self.view.length

    def tick(self) -> None:
        """Advance by one frame."""
        self.playback.tick(1.0 / self.fps)
        self.playback.length = self.view.length

    def draw(self) -> pygame.Surface:
        """The view, the spikes of the leader, and the panel."""
        (width, height), now = self._size, self.playback.now
        spikes = SPIKES_WIDTH if self._spikes else 0
        surface = pygame.Surface((width + spikes + _WIDTH, height))
        surface.blit(self.view.draw(now, self._size), (0, 0))
        if self._spikes:
            place, trace = pygame.Rect(width, 0, spikes, height), self.inferences
            taken = self.view.action(min(now, len(trace.scores) - 1)) if trace else None
            draw_inference(surface, place, self._spikes[0], trace, now, self._world, taken)
        track = f" · {self._world.track.name}" if is_kart(self._world) else ""
        place = pygame.Rect(width + spikes, 0, _WIDTH, height)
        panel = Panel(surface, place, self.name + track, self._heading, _KEYS, 3)
        self._draw_time(panel)
        self._draw_facts(panel)
        return surface

    @property
    def view(self) -> GhostView | RolloutView:
        """The current batch."""
        return self._view(self.playback.batch)

    @property
    def inferences(self) -> InferenceTrace | None:
        """Inferences of the policy on the observations of the leader."""
        return self._trace(self.playback.batch)

    def _open_view(self, batch: int) -> GhostView | RolloutView:
        rollout = self._first.rollout
        if rollout is not None and not is_kart(self._world):
            return RolloutView(self._env, rollout)
        index = None if self._is_all else batch
        ghosts = {name: source.batch(index) for name, source in self._sources.items()}
        return GhostView(self._env, ghosts, None if rollout is None else rollout.observation)

    def _record(self, batch: int) -> InferenceTrace | None:
        observations = self._view(batch).observations()
        if self._spikes is None or not len(observations):
            return None
        return trace_of(self._spikes[1], observations, self._view(batch).seed)

    def _draw_facts(self, panel: Panel) -> None:
        """Names and values, in smaller type where there are several sources."""
        legend, inner = self.view.legend, panel.inner
        size, height = (12, 20) if legend else (14, 26)
        for name, value in self.view.facts(self.playback.now):
            if name in legend:
                dot = inner.left + 6, panel.y + 8
                pygame.draw.aacircle(panel.surface, legend[name], dot, 6)
                text = shorten(name, inner.width - 20, size, "bold")
                write(panel.surface, text, (inner.left + 20, panel.y), size, TEXT, "bold")
            else:
                at = inner.left + 20 * bool(legend), panel.y
                write(panel.surface, name, at, size, DIM)
                panel.value(value, 0, size)
                panel.y += 10 if legend and name == "leader" else 0
            panel.y += height

    def _draw_time(self, panel: Panel) -> None:
        play = self.playback
        panel.title("time")
        number = panel.text(f"{play.now * play.dt:.2f}", 14, 40, TEXT, "bold")
        end, at = f"/ {play.length * play.dt:.2f} s", (number.right + 8, number.bottom - 8)
        write(panel.surface, end, at, 14, DIM, anchor="bottomleft")
        panel.value("paused" if play.paused else f"× {play.speed:g}", 30, 16, AMBER, "bold")
        panel.bar(play.now / max(play.length, 1), 70, 8)
        panel.title("batch", 100)
        counter = "all" if self._is_all else f"{play.batch + 1} / {play.batches}"
        panel.value(counter, 96, 16, TEXT, "bold")
        panel.bar((play.batch + 1) / play.batches, 120, 6, AMBER)
        panel.y += 150


def open_replay(
    path: Path,
    mode: str = "batch",
    batch: int = 1,
    spikes: str | None = None,
    chip: str = "loihi1",
    speed: float = 1.0,
    options: Mapping[str, Any] = MappingProxyType({}),
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
    if len(paths) > len(COLOURS):
        raise ConfigError(f"{len(paths)} sources: at most {len(COLOURS)} can be told apart")
    first, *others = sources = [open_source(each) for each in paths]
    _check_same_world(first, others, options)
    env = make_env(first.env_id, {**first.options, **options}, render_mode="rgb_array")
    if beside and not is_kart(env.unwrapped):
        raise ConfigError(f"{first.name} is no kart: only karts can be shown together")
    shown = _open_spikes(spikes, chip, env) if spikes else None
    named = dict(zip(distinct_names(paths), sources, strict=True))
    app = ReplayApp(named, env, mode, shown, speed)
    if not 1 <= batch <= app.playback.batches:
        raise ConfigError(f"--batch {batch}: {first.name} has 1 to {app.playback.batches}")
    app.open(batch - 1)
    return app


def _open_spikes(policy: str, chip: str, env: gymnasium.Env[Any, Any]) -> tuple[str, NirController]:
    candidate = find(policy)
    if candidate.format != ".nir":
        raise ConfigError(f"{policy} shows no spikes: give a .nir file, which `export` writes")
    check_fit(candidate, env)
    player = NirController.open(candidate, chip, env, False, trace=True)
    return f"{candidate.name} on {chip}", player


# films

_FILM_FPS = {".mp4": 30, ".gif": 20}  # frame times of a GIF are whole hundredths of a second
_GIF_SCALE = 0.6


def save_film(app: ReplayApp, path: Path, seconds: float) -> Path:
    """Write one round through the batches, at most so many seconds; return the path.

    .mp4  as large as the window, 30 frames per second
    .gif  smaller, 20 frames per second
    """
    form = suffix(path)
    if form not in _FILM_FPS:
        raise ConfigError(f"--video {path}: choose a name that ends in {' or '.join(_FILM_FPS)}")
    fps = _FILM_FPS[form]
    every = round(app.fps / fps)

    def frames() -> Iterator[Frame]:
        while not app.playback.rounds:
            frame = app.draw()
            if form == ".gif":
                frame = pygame.transform.smoothscale_by(frame, _GIF_SCALE)
            yield pygame.surfarray.array3d(frame).swapaxes(0, 1)
            for _ in range(every):
                app.tick()

    film = islice(frames(), max(1, round(seconds * fps)))
    if form == ".gif":
        gif(path, film, 1 / fps, mark("replay"))
        return path
    with mp4(path, fps, mark("replay")) as write_frame:
        for frame in film:
            write_frame(frame)
    return path
