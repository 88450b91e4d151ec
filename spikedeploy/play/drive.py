"""`spikedeploy play`: drive with the keys, command a robot, or watch a policy."""

import itertools
import math
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pygame
from numpy.typing import NDArray

from spikedeploy import envs, zoo
from spikedeploy.envs.foreign import AdaptedEnv
from spikedeploy.envs.rollout import EpisodeRecorder, Rollout
from spikedeploy.make_env import make_env
from spikedeploy.play.spikes import WIDTH as SPIKES_WIDTH
from spikedeploy.play.spikes import WINDOW, InferenceTrace, draw_inference, last_scores
from spikedeploy.play.theme import (
    AMBER,
    CYAN,
    DIM,
    GREEN,
    LINE,
    RED,
    TEXT,
    TRACK,
    Panel,
    banner,
    env_picture,
    is_kart,
    picture_size,
    signed_bar,
    write,
)
from spikedeploy.play.window import App
from spikedeploy.policies.costs import priced_by
from spikedeploy.policies.nir import NirController
from spikedeploy.policies.registry import Candidate, Player, find
from spikedeploy.recordings import Inference, costs_of_each, ledger_of, open_with_traces
from spikedeploy.reports.columns import quoted_among
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix

Floats = NDArray[np.float64]
_UNKNOWN = 1 / 30  # [s] control step where an environment does not say
_PAUSE = 1.5  # [s] that the end of an episode stays on the screen
_MEAN = 30  # control steps of which costs are the mean


# drivers


class Driver:
    """A controller that receives key events.

    name    for people
    legend  keys and what they do
    meter   of a spiking policy that drives
    """

    name = "you"
    legend: list[tuple[str, str]] = []  # noqa: RUF012
    meter: "NetworkMeter | None" = None

    def reset(self, seed: int) -> None:
        """Start an episode."""

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press or release."""

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action for an observation."""
        raise NotImplementedError


_ARROWS = {
    "up": (pygame.K_w, pygame.K_UP),
    "down": (pygame.K_s, pygame.K_DOWN),
    "left": (pygame.K_a, pygame.K_LEFT),
    "right": (pygame.K_d, pygame.K_RIGHT),
    "forward": (pygame.K_w, pygame.K_UP),
    "accelerate": (pygame.K_w, pygame.K_UP),
    "brake": (pygame.K_s, pygame.K_SPACE, pygame.K_DOWN),
    "slightly left": (pygame.K_q,),
    "slightly right": (pygame.K_e,),
}  # action -> keys, that of the legend first


class KeyboardDriver(Driver):
    """A person at the keys: the key pressed last acts, or all that are held add up.

    actions  names of an environment's actions, in its order; "straight" is no action, or the first
    effects  of a continuous action: name -> numbers (act,), which add up
    """

    def __init__(
        self, actions: tuple[str, ...], effects: Mapping[str, tuple[float, ...]] | None = None
    ) -> None:
        self._actions, self._effects = actions, effects
        self._idle = "straight" if "straight" in actions else actions[0]
        self._meaning = {key: name for name in actions for key in _ARROWS.get(name, ())}
        self._held: list[int] = []
        self.legend = [(chr(_ARROWS[n][0]).upper(), n) for n in actions if n in _ARROWS]

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press or release; other keys than those that drive are ignored."""
        if event.key in self._held:
            self._held.remove(event.key)
        if event.type == pygame.KEYDOWN and event.key in self._meaning:
            self._held.append(event.key)

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action () of the key that was pressed last and is still held, or their sum (act,)."""
        names = [self._idle, *(self._meaning[key] for key in self._held)]
        if self._effects is None:
            return np.asarray(self._actions.index(names[-1]))
        effects = [self._effects[name] for name in names]
        return np.asarray(np.clip(np.sum(effects, axis=0), -1.0, 1.0))


class NetworkMeter:
    """The last inferences of a spiking policy, and what they cost.

    table    of the energy
    seconds  time of the last action [s]
    """

    def __init__(self, player: NirController) -> None:
        self._player, self.table = player, quoted_among(priced_by(player.chip))
        self.reset()

    def reset(self) -> None:
        """Start an episode."""
        self._inferences: deque[tuple[Inference, Floats]] = deque(maxlen=WINDOW)
        self._costs: deque[tuple[float, float]] = deque(maxlen=_MEAN)
        self._before, self.seconds = ledger_of(self._player), 0.0

    def read(self, seconds: float) -> None:
        """Read the inference of an action that took so long."""
        self.seconds = seconds
        self._inferences.append(last_scores(self._player))
        before, self._before = self._before, ledger_of(self._player)
        if before is not None and self._before is not None:
            sops, joules = costs_of_each(self._before.since(before), self.table)
            self._costs.append((float(sops[0]), float(joules[0])))

    @property
    def trace(self) -> InferenceTrace | None:
        """The last control steps; None before the first."""
        return InferenceTrace.of(self._inferences) if self._inferences else None

    @property
    def costs(self) -> tuple[float, float] | None:
        """Synaptic operations and energy [J] of a control step; None if they are not counted.

        Means of the last control steps.
        """
        if not self._costs:
            return None
        sops, joules = np.mean(self._costs, axis=0).tolist()
        return sops, joules


class PolicyDriver(Driver):
    """A policy that drives by itself."""

    def __init__(self, player: Player, name: str) -> None:
        self.name, self._player = name, player
        self.meter = NetworkMeter(player) if isinstance(player, NirController) else None

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self._player.reset(seed)
        if self.meter:
            self.meter.reset()

    def act(self, observation: Floats) -> NDArray[Any]:
        """The policy's action."""
        begin = time.perf_counter()
        action = self._player.act(observation)
        if self.meter:
            self.meter.read(time.perf_counter() - begin)
        return action


class CommandedPolicyDriver(PolicyDriver):
    """A policy that follows the velocity commands of a person, who changes them in steps.

    speed, turn  that are commanded [m/s], [rad/s]
    """

    SPEED = (-0.25, 0.45)  # [m/s]
    TURN = (-0.8, 0.8)  # [rad/s]
    _STEPS = {  # noqa: RUF012 - key -> change of speed and turn rate
        pygame.K_UP: (0.05, 0.0),
        pygame.K_DOWN: (-0.05, 0.0),
        pygame.K_LEFT: (0.0, 0.2),
        pygame.K_RIGHT: (0.0, -0.2),
    }
    legend = [("↑ ↓", "speed"), ("← →", "turn"), ("SPACE", "stand")]  # noqa: RUF012

    def __init__(self, player: Player, name: str, world: Any) -> None:  # noqa: ANN401
        super().__init__(player, name)
        self._world = world
        self.speed, self.turn = 0.25, 0.0

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press."""
        if event.type != pygame.KEYDOWN:
            return
        if event.key == pygame.K_SPACE:
            self.speed = self.turn = 0.0
        speed, turn = self._STEPS.get(event.key, (0.0, 0.0))
        self.speed = round(min(max(self.speed + speed, self.SPEED[0]), self.SPEED[1]), 2)
        self.turn = round(min(max(self.turn + turn, self.TURN[0]), self.TURN[1]), 2)

    def act(self, observation: Floats) -> NDArray[Any]:
        """The policy's action; the next observation contains the command."""
        self._world.steer(self.speed, self.turn)
        return super().act(observation)


class SteeredPolicyDriver(PolicyDriver):
    """A policy that walks straight along a course, which a person turns."""

    _STEPS = {pygame.K_LEFT: math.radians(10), pygame.K_RIGHT: -math.radians(10)}  # noqa: RUF012
    legend = [("← →", "turn")]  # noqa: RUF012

    def __init__(self, player: Player, name: str, world: Any) -> None:  # noqa: ANN401
        super().__init__(player, name)
        self._world = world

    def handle(self, event: pygame.Event) -> None:
        """Handle a key press; the next observation is relative to the course."""
        if event.type == pygame.KEYDOWN and event.key in self._STEPS:
            self._world.steer(self._world.course + self._STEPS[event.key])


# a session: one driver in one environment


_REASONS = {"finish": "finish", "wrong": "wrong arm"} | {
    name: name for name in ("crash", "stalled", "fall")
}  # key of the step infos -> word


@dataclass(frozen=True)
class Outcome:
    """The end of an episode.

    word     "finish", "wrong arm", "crash", "stalled", "fall", "the end" or "time is up"
    good     whether it was a success
    steps    of the episode
    total    return
    seconds  of the lap, where one was finished
    """

    word: str
    good: bool
    steps: int
    total: float
    seconds: float | None = None

    @classmethod
    def of(cls, played: Rollout, info: Mapping[str, Any]) -> "Outcome":
        """The outcome of an episode, whose last info has the reason if it has one."""
        reasons = (word for name, word in _REASONS.items() if info.get(name))
        word = next(reasons, "the end" if played.terminated else "time is up")
        lap = float(info["lap_time"]) if info.get("finish") else None
        return cls(word, bool(info.get("success")), played.steps, played.total, lap)

    @property
    def line(self) -> str:
        """The outcome in one line."""
        lap = "" if self.seconds is None else f" in {self.seconds:.2f} s"
        return f"{self.word}{lap}, {self.steps} steps, return {self.total:.2f}"


class Session:
    """One driver in one environment, episode after episode.

    seed      of the first episode; each further one has the next
    record    file for the rollouts; the second goes to <name>-2, and so on
    period    time of a control step [s]
    episode   the recorder of the current episode
    sums      reward term -> sum over the episode
    outcomes  of the episodes that ended
    files     of recorded rollouts
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        driver: Driver,
        seed: int,
        record: Path | None = None,
    ) -> None:
        self.env, self.driver, self._record = env, driver, record
        self.world: Any = env.unwrapped
        self.period = float(getattr(self.world, "CONTROL_DT", None) or _UNKNOWN)
        self.outcomes: list[Outcome] = []
        self.files: list[Path] = []
        self._seed = seed - 1
        self.restart()

    @property
    def info(self) -> Mapping[str, Any]:
        """The info of the last step or reset."""
        return self.episode.info

    @property
    def waiting(self) -> bool:
        """True while the end of an episode is shown."""
        return self._wait > 0

    def restart(self) -> None:
        """Start the next episode; an unfinished one is dropped."""
        self._seed += 1
        self._wait = 0
        self.episode = EpisodeRecorder(self.env, self._seed)
        self.driver.reset(self._seed)
        self.sums: Counter[str] = Counter()

    def tick(self) -> None:
        """Advance by one control step, or keep showing the end of an episode."""
        if self._wait:
            self._wait -= 1
            if not self._wait:
                self.restart()
            return
        self.episode.step(self.driver.act(self.episode.observation))
        self.sums.update(self.info.get("reward_terms", {"reward": self.episode.reward}))
        if self.episode.over:
            played = self.episode.rollout()
            self.outcomes.append(Outcome.of(played, self.info))
            self._keep(played)
            self._wait = max(1, round(_PAUSE / self.period))

    def close(self) -> None:
        """Record the unfinished episode, if recording, and close the environment."""
        if not self.waiting and self.episode.steps:
            self._keep(self.episode.rollout())
        self.env.close()

    def _keep(self, played: Rollout) -> None:
        """Write a rollout, if recording; all but the first to a file that is not there."""
        if self._record is None:
            return
        stem, numbers = self._record.stem, itertools.count(len(self.files) + 1)
        others = (self._record.with_stem(f"{stem}-{number}") for number in numbers)
        path = next(p for p in others if not p.exists()) if self.files else self._record
        self.files.append(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        played.save(path)


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
    chip     of a spiking policy; None is that of its training, or loihi1
    """
    if record is not None and suffix(record) != ".npz":
        raise ConfigError(f"--record {record}: a drive is kept in a file that ends in .npz")
    world = make_env(env, options, render_mode="rgb_array")
    return Session(world, _driver(env, world, policy, chip), seed, record)


def _driver(env: str, world: Any, policy: str | None, chip: str | None) -> Driver:  # noqa: ANN401
    """A person where keys can drive and no policy is named, else a policy."""
    inner = world.unwrapped
    if policy is None and hasattr(inner, "ACTIONS"):
        if chip is not None:
            raise ConfigError("--chip is for a policy: name one with --policy")
        is_discrete = isinstance(world.action_space, gymnasium.spaces.Discrete)
        return KeyboardDriver(inner.ACTIONS, None if is_discrete else inner.EFFECTS)
    candidate = _shipped(env) if policy is None else find(policy)
    chip = chip or candidate.default_chip
    player = open_with_traces(candidate, chip, world, "total")
    name = f"{candidate.name} on {chip}" if chip else candidate.name
    if hasattr(inner, "course"):  # a direction; other walkers are given a velocity
        return SteeredPolicyDriver(player, name, inner)
    if hasattr(inner, "steer"):
        return CommandedPolicyDriver(player, name, inner)
    return PolicyDriver(player, name)


def _shipped(env: str) -> Candidate:
    """A shipped policy of the environment, a spiking one if there is one."""
    spec = envs.spec(env)
    found = [find(str(path)) for path in zoo.policies(spec.short)]
    spiking = [candidate for candidate in found if candidate.kind == "snn"]
    return (spiking or found or [find(spec.controls[0])])[0]


# the app

_WIDTH = 400  # of its panel


class DriveApp(App):
    """A session in a window, and its panel."""

    def __init__(self, session: Session, env: str) -> None:
        self.session = session
        self.name = envs.spec(env).short
        self.title = f"{self.name} – spikedeploy"
        self.fps = 1.0 / session.period
        track = getattr(session.world, "track", None)
        self._heading = f"{self.name} · {track.name}" if track else self.name
        self._size = picture_size(session.world)

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
        session, driver, (width, height) = self.session, self.session.driver, self._size
        spikes = SPIKES_WIDTH if driver.meter else 0
        surface = pygame.Surface((width + spikes + _WIDTH, height))
        seen = surface.blit(env_picture(session.world, self._size), (0, 0))
        if driver.meter:
            place, trace = pygame.Rect(width, 0, spikes, height), driver.meter.trace
            draw_inference(surface, place, driver.name, trace, WINDOW, session.world, None)
        keys = [*driver.legend, ("R", "restart"), ("P", "picture"), ("ESC", "leave")]
        place = pygame.Rect(width + spikes, 0, _WIDTH, height)
        _draw_sections(Panel(surface, place, self._heading, driver.name, keys, 1), session)
        if session.waiting:
            outcome = session.outcomes[-1]
            lap = "" if outcome.seconds is None else f"  {outcome.seconds:.2f} s"
            banner(surface, seen, outcome.word + lap, GREEN if outcome.good else RED)
        return surface


# sections of its panel

_TOPS = {
    "up": 4.0,
    "forward": 4.4,
    "accelerate": 5.99,
    "straight": 3.0,
}  # action of one kind of kart -> [m/s]


def _draw_sections(panel: Panel, session: Session) -> None:
    world, meter = session.world, session.driver.meter
    if not isinstance(world, AdaptedEnv):
        _draw_speed(panel, session)
    panel.y += 24
    seconds = session.episode.steps * session.period
    cells = [("time", f"{seconds:.2f} s", TEXT if seconds else DIM)]
    if is_kart(world):
        laps = [each.seconds for each in session.outcomes if each.seconds is not None]
        last, best = (f"{laps[-1]:.2f} s", f"{min(laps):.2f} s") if laps else ("–", "–")
        cells.append(("last lap", last, TEXT if laps else DIM))
        cells.append(("best lap", best, GREEN if laps else DIM))
    panel.columns(cells, 19)
    panel.y += 66
    if is_kart(world):
        _draw_passed(panel, "gates", len(world.track.gates), int(world.next_gate))
        _draw_lidar(panel, world)
    if (forks := session.info.get("forks")) is not None:
        _draw_passed(panel, "forks", world.options.forks, int(forks))
    if meter is not None:
        share = meter.seconds / session.period
        sops, joules = meter.costs or (None, None)
        cells = [
            ("SOPs", "–" if sops is None else f"{sops:,.0f}", TEXT),
            ("energy", "–" if joules is None else f"{1e9 * joules:,.3g} nJ", TEXT),
            ("deadline use", f"{100 * share:.1f} %", RED if share > 1 else TEXT),
        ]
        panel.columns(cells, 15)
        panel.text(f"means of {_MEAN} steps · energy by {meter.table}", 40, 12)
        panel.y += 78
    _draw_rewards(panel, session.sums)


def _draw_speed(panel: Panel, session: Session) -> None:
    """A large number and a bar; a robot's command below it."""
    scale = 100.0 if is_kart(session.world) else 1.0  # of the world's unit in a metre
    speed = float(session.info.get("speed", 0.0)) / scale
    panel.title("speed")
    number = panel.text(f"{speed:.2f}", 14, 44, TEXT, "bold")
    unit = number.right + 8, number.bottom - 9
    write(panel.surface, "m/s", unit, 15, DIM, anchor="bottomleft")
    top = next((_TOPS[a] for a in getattr(session.world, "ACTIONS", ()) if a in _TOPS), 0.5)
    panel.bar(abs(speed) / top, 72, 8)
    panel.y += 80
    if "command_speed" in session.info:
        speed, turn = (session.info[f"command_{name}"] for name in ("speed", "turn"))
        panel.text("commanded", 12, 13)
        panel.value(f"{speed:+.2f} m/s   {turn:+.2f} rad/s", 12, 13, AMBER, "mono")
        panel.y += 30


def _draw_passed(panel: Panel, name: str, count: int, passed: int) -> None:
    """A mark for each gate or fork: passed, next, to come."""
    panel.title(name)
    panel.value(f"{passed} / {count}", -3, 14, TEXT, "bold")
    gap = 6
    width = (panel.inner.width - gap * (count - 1)) / count
    for gate in range(count):
        colour = GREEN if gate < passed else AMBER if gate == passed else TRACK
        left = round(panel.inner.left + gate * (width + gap))
        mark = pygame.Rect(left, panel.y + 20, round(width), 8)
        pygame.draw.rect(panel.surface, colour, mark, border_radius=4)
    panel.y += 52


def _draw_lidar(panel: Panel, world: Any) -> None:  # noqa: ANN401
    """The LIDAR scan in the frame of the kart: ahead is up."""
    surface, radius = panel.surface, 78
    panel.title("lidar")
    panel.text(f"{world.lidar.range / 100:.1f} m", 18, 13)
    centre = np.array([panel.inner.centerx, panel.y + radius + 4])
    for share in (1.0, 2 / 3, 1 / 3):
        pygame.draw.aacircle(surface, LINE, tuple(centre), radius * share, 1)
    turned = np.asarray(world.lidar.angles) - np.pi / 2 * world.TURNS
    share = np.asarray(world.scan) / world.lidar.range
    points = centre + radius * share[:, None] * np.stack((np.cos(turned), np.sin(turned)), axis=1)
    seen_area = [tuple(point) for point in (centre, *points)]
    if world.lidar.options.field >= 2 * np.pi:
        seen_area.pop(0)
    if len(seen_area) > 2:
        veil = pygame.Surface(surface.get_size(), pygame.SRCALPHA)
        pygame.draw.polygon(veil, (*CYAN, 40), seen_area)
        surface.blit(veil, (0, 0))
    for point, reach in zip(points, share, strict=True):
        colour, size = (RED, 3) if reach < 0.999 else (LINE, 2)
        pygame.draw.aacircle(surface, colour, tuple(point), size)
    pygame.draw.aacircle(surface, CYAN, tuple(centre), 5)
    panel.y += 2 * radius + 32


def _draw_rewards(panel: Panel, sums: Mapping[str, float]) -> None:
    """Every reward term: its sum over the episode, as bar and number."""
    panel.title("reward so far")
    panel.value(f"{sum(sums.values()):+.2f}", -4, 16, TEXT, "bold")
    panel.y += 24
    inner, largest = panel.inner, max((abs(value) for value in sums.values()), default=0.0) or 1.0
    rows = max(1, (inner.bottom - 66 - panel.y) // 21)
    for name, value in [*sums.items()][:rows]:
        panel.text(name.replace("_", " "), 0, 13)
        place = pygame.Rect(inner.left + 130, panel.y + 5, inner.width - 130 - 74, 6)
        signed_bar(panel.surface, place, value / largest)
        panel.value(f"{value + 0.0:+.2f}", 0, 13, TEXT, "mono")
        panel.y += 21
