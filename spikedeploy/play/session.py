"""A drive: one driver in one environment, episode after episode, recorded."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium

from spikedeploy.envs.rollout import EpisodeRecorder, Rollout
from spikedeploy.play.drivers import Driver

_UNKNOWN = 1 / 30  # [s] control step where an environment does not say
_PAUSE = 1.5  # [s] that the end of an episode stays on the screen


@dataclass(frozen=True)
class _Outcome:
    """How an episode ended.

    word     "finish", "crash", "stalled", "fall", "the end" or "time is up"
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

    @property
    def line(self) -> str:
        """The outcome in one line."""
        lap = "" if self.seconds is None else f" in {self.seconds:.2f} s"
        return f"{self.word}{lap}, {self.steps} steps, return {self.total:.2f}"


class Session:
    """One driver in one environment.

    seed      of the first episode; each further one has the next
    record    file for the rollouts; the second goes to <name>-2, and so on
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
        self.outcomes: list[_Outcome] = []
        self.files: list[Path] = []
        self.sums: Counter[str] = Counter()
        self._seed, self._wait = seed - 1, 0
        self.restart()

    @property
    def info(self) -> Mapping[str, Any]:
        """The info of the last step or reset."""
        return self.episode.info

    @property
    def waiting(self) -> bool:
        """Whether the end of an episode is shown."""
        return self._wait > 0

    @property
    def seconds(self) -> float:
        """Seconds since the start of the episode."""
        return self.episode.steps * self.period

    @property
    def period(self) -> float:
        """Time of a control step [s]."""
        return float(self.world.CONTROL_DT or _UNKNOWN)

    @property
    def best(self) -> float | None:
        """The fastest lap [s]."""
        return min((o.seconds for o in self.outcomes if o.seconds is not None), default=None)

    @property
    def last(self) -> float | None:
        """The newest lap [s]."""
        laps = [o.seconds for o in self.outcomes if o.seconds is not None]
        return laps[-1] if laps else None

    def restart(self) -> None:
        """Start the next episode; an unfinished one is dropped."""
        self._seed += 1
        self._wait = 0
        self.episode = EpisodeRecorder(self.env, self._seed)
        self.driver.reset(self._seed)
        self.sums = Counter()

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
            self._end()

    def close(self) -> None:
        """Record the unfinished episode, if recording, and close the environment."""
        if not self.waiting and self.episode.steps:
            self._keep(self.episode.rollout())
        self.env.close()

    def _end(self) -> None:
        played = self.episode.rollout()
        finished = bool(self.info.get("finish"))
        self.outcomes.append(
            _Outcome(
                word=_word(self.info, played.terminated),
                good=bool(self.info.get("success")),
                steps=played.steps,
                total=played.total,
                seconds=float(self.info["lap_time"]) if finished else None,
            )
        )
        self._keep(played)
        self._wait = max(1, round(_PAUSE / self.period))

    def _keep(self, played: Rollout) -> None:
        """Write a rollout, if recording."""
        if self._record is None:
            return
        self.files.append(_free(self._record, len(self.files) + 1))
        self._record.parent.mkdir(parents=True, exist_ok=True)
        played.save(self.files[-1])


def _free(record: Path, number: int) -> Path:
    """The file of a drive; of the second and later the next that is not there.

    An earlier drive cannot be driven again; `play` asks whether the first may be replaced.
    """
    while number > 1 and (path := record.with_stem(f"{record.stem}-{number}")).exists():
        number += 1
    return record if number == 1 else path


def _word(info: Mapping[str, Any], terminated: bool) -> str:
    """The reason why an episode ended, as far as the info has it."""
    reasons = (name for name in ("finish", "crash", "stalled", "fall") if info.get(name))
    return next(reasons, "the end" if terminated else "time is up")
