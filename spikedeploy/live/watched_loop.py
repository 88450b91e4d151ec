"""The paced loop whose episodes are watched."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import gymnasium
import typer

from spikedeploy import envs
from spikedeploy.console import say
from spikedeploy.envs.rollout import EpisodeRecorder, Rollout
from spikedeploy.live.steps import WatchedInference, WatchedStep
from spikedeploy.live.view import LiveView
from spikedeploy.play.display import has_desktop
from spikedeploy.policies.costs import FLOAT_TABLES, priced_by
from spikedeploy.policies.nir import NirController
from spikedeploy.policies.registry import Candidate, Player
from spikedeploy.realtime.paced_loop import TIMES, PacedLoop, paced, pacing
from spikedeploy.recordings.episode import ledger_of, membranes_of, spikes_of, traced
from spikedeploy.recordings.scenes import scene_of
from spikedeploy.reports.columns import quoted_among

_RATE = 30.0  # [Hz] where neither the user nor the environment says one
_BROWSER = 5.0  # [s] that a browser has to open before the first episode begins
_POLICY = TIMES.index("policy")


class WatchedLoop(PacedLoop):
    """Plays as PacedLoop does, and hands every control step to a view.

    rate      [Hz]; None for that of the environment
    deadline  as the option; None for the period
    lasting   likewise; None for as many episodes as were asked for
    tables    of energy that were asked for; none for the one that reports quote
    """

    def __init__(
        self,
        view: LiveView,
        rate: float | None,
        deadline: str | None,
        lasting: str | None,
        tables: Sequence[str] = (),
    ) -> None:
        super().__init__(paced(_RATE if rate is None else rate, deadline, lasting))
        self._view, self._tables = view, tables
        self._given = rate, deadline, lasting
        self._episode, self._missed = 0, 0

    def open(
        self,
        candidate: Candidate,
        chip: str | None,
        env: gymnasium.Env[Any, Any],
        sampled: bool,
    ) -> Player:
        """The policy, whose network keeps its spikes; the rate is now known."""
        rate, deadline, lasting = self._given
        period = getattr(env.unwrapped, "CONTROL_DT", None)
        own = 1 / period if period else _RATE
        self._pace(paced(own if rate is None else rate, deadline, lasting))
        self._label = candidate.name if chip is None else f"{candidate.name} · {chip}"
        self._kind, self._period = candidate.kind, period
        player = traced(candidate, chip, env, "total", sampled)
        self._table = next(iter(self._tables), "") or quoted_among(
            priced_by(player.chip) if isinstance(player, NirController) else FLOAT_TABLES
        )
        return player

    def rollout(self, env: gymnasium.Env[Any, Any], player: Player, seed: int) -> Rollout:
        """One episode, a control step in each period."""
        played = super().rollout(env, player, seed)
        why = "terminal state" if played.terminated else "time limit"
        self._view.over({"total": played.total, "success": played.success, "why": why})
        return played

    def _begun(
        self, recorder: EpisodeRecorder, env: gymnasium.Env[Any, Any], player: Player, seed: int
    ) -> None:
        self._episode, self._total = self._episode + 1, 0.0
        self._scene = scene_of(env)
        self._before = ledger_of(player) if isinstance(player, NirController) else None
        self._view.begin(
            {
                "label": self._label,
                "kind": self._kind,
                "env": envs.spec(env.spec.id).short if env.spec else "",
                "episode": self._episode,
                "seed": seed,
                "period": self._period,
                "rate": self._pacing.rate,
                "scene": self._scene.shapes() if self._scene else None,
            },
            self._table,
            self._pacing.deadline,
        )

    def _stepped(self, recorder: EpisodeRecorder, player: Player, times: Sequence[float]) -> None:
        self._total += recorder.reward
        self._missed += times[_POLICY] > self._pacing.deadline
        self._view.step(
            WatchedStep(
                recorder.steps - 1,
                recorder.action,
                recorder.reward,
                self._total,
                recorder.numbers,
                self._scene.pose() if self._scene else None,
                self._inference(player),
                times[_POLICY],
                self._missed,
                self._metronome.skipped,
            )
        )

    def _inference(self, player: Player) -> WatchedInference | None:
        if not isinstance(player, NirController):
            return None
        before, self._before = self._before, ledger_of(player)
        one = None if before is None or self._before is None else self._before.since(before)
        return WatchedInference(spikes_of(player), membranes_of(player), one)


@contextmanager
def loop_of_run(
    watch: bool,
    port: int | None,
    rate: float | None,
    deadline: str | None,
    lasting: str | None,
    tables: Sequence[str],
) -> Iterator[PacedLoop | None]:
    """The loop that `run` plays in: by --watch, by --rate, or None; arguments as of WatchedLoop."""
    if not watch:
        pace = pacing(rate, deadline, lasting)
        yield PacedLoop(pace) if pace else None
        return
    view = LiveView(port or 0)
    try:
        loop = WatchedLoop(view, rate, deadline, lasting, tables)
        say(f"watch at {view.address}")
        if has_desktop() and not typer.launch(view.address):
            view.wait(_BROWSER)
        yield loop
    finally:
        view.close()
