"""`run --watch`: episodes in browsers of this machine while they are played.

The paced loop appends its control steps to a bounded list and goes on. A server on 127.0.0.1 looks
there for each browser, in a thread of its own, and sends what is new as Server-Sent Events: a slow
browser misses the oldest control steps, and nobody waits for it.
"""

import json
import re
import sys
import threading
import time
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
import typer

from spikedeploy import envs
from spikedeploy.console import say
from spikedeploy.envs.rollout import EpisodeRecorder, Rollout
from spikedeploy.evaluation_setup import Setup
from spikedeploy.play.display import has_desktop
from spikedeploy.policies.costs import FLOAT_TABLES, priced_by
from spikedeploy.policies.nir import NirController
from spikedeploy.policies.registry import Candidate, Controller, Env
from spikedeploy.realtime.paced_loop import PacedLoop, Pacing, pacing
from spikedeploy.recordings import (
    Step,
    StepTracer,
    curve,
    info_curves,
    network_json,
    open_with_traces,
    scene_of,
    series_json,
    trace_network,
)
from spikedeploy.reports.columns import quoted_among
from spikedeploy.reports.page import REPLAY_ASSETS, asset
from spikedeploy.runtime.errors import ConfigError

# the paced loop

_RATE = 30.0  # [Hz] where neither the user nor the environment says one
_BROWSER = 5.0  # [s] that a browser has to open before the first episode begins


@contextmanager
def watched_loop(
    port: int | None,
    rate: float | None,
    deadline: str | None,
    lasting: str | None,
    tables: Sequence[str],
) -> Iterator["WatchedLoop"]:
    """The loop of `run --watch`, whose page is opened; arguments as of WatchedLoop."""
    view = LiveView(port or 0)
    try:
        loop = WatchedLoop(view, rate, deadline, lasting, tables)
        say(f"watch at {view.address}")
        if has_desktop() and not typer.launch(view.address):
            view.wait(_BROWSER)
        yield loop
    finally:
        view.close()


class WatchedLoop(PacedLoop):
    """Plays as PacedLoop does, and hands every control step to a view.

    rate: [Hz]; None for that of the environment
    deadline: as the option; None for the period
    lasting: likewise; None for as many episodes as were asked for
    tables: energy tables of --energy; none for the one that reports quote
    """

    def __init__(
        self,
        view: "LiveView",
        rate: float | None,
        deadline: str | None,
        lasting: str | None,
        tables: Sequence[str] = (),
    ) -> None:
        self._options = deadline, lasting
        super().__init__(self._paced(_RATE if rate is None else rate))
        self._view, self._tables, self._rate = view, tables, rate
        self._episode, self._missed, self._total = 0, 0, 0.0
        self._tracer: StepTracer

    def _paced(self, rate: float) -> Pacing:
        found = pacing(rate, *self._options)
        assert found is not None
        return found

    def open(self, candidate: Candidate, chip: str | None, env: Env, setup: Setup) -> Controller:
        """The policy, whose network keeps its spikes; the rate is now known."""
        period = getattr(env.unwrapped, "CONTROL_DT", None)
        if self._rate is None:
            self._pace(self._paced(1 / period if period else _RATE))
        controller = open_with_traces(candidate, chip, env, setup)
        table = next(iter(self._tables), "") or quoted_among(
            priced_by(controller.chip) if isinstance(controller, NirController) else FLOAT_TABLES
        )
        self._env, self._head = (
            env,
            {
                "label": candidate.name if chip is None else f"{candidate.name} · {chip}",
                "kind": candidate.kind,
                "env": envs.spec(env.spec.id).short if env.spec else "",
                "period": period,
                "rate": self._pacing.rate,
                "table": table,
                "deadline": self._pacing.deadline,
            },
        )
        return controller

    def rollout(self, env: Env, controller: Controller, seed: int) -> Rollout:
        """One episode, a control step in each period."""
        played = super().rollout(env, controller, seed)
        why = "terminal state" if played.terminated else "time limit"
        self._view.over({"total": played.total, "success": played.success, "why": why})
        return played

    def _on_step(self, recorder: EpisodeRecorder) -> None:
        if recorder.steps:
            super()._on_step(recorder)
            policy = self._acted - self._woke
            self._total += recorder.reward
            self._missed += policy > self._pacing.deadline
            step, number = self._tracer.take(recorder), recorder.steps - 1
            skipped = self._metronome.skipped
            self._view.step(WatchedStep(step, number, self._total, policy, self._missed, skipped))
            return
        self._episode, self._total, scene = self._episode + 1, 0.0, scene_of(self._env)
        now = {"episode": self._episode, "seed": self._seed, "scene": scene and scene.shapes}
        self._view.begin({**self._head, **now})
        super()._on_step(recorder)
        self._tracer = StepTracer(self._controller, scene)


# messages

# infos of our environments, of which curves are drawn; which ones others have changes by the step
_OURS = {"command_turn", "slip", "gates"}
_MOST_NEURONS = 4096  # of a layer whose spikes are sent


@dataclass(frozen=True)
class WatchedStep:
    """A control step that was taken, and the loop after it.

    number: index of the step in its episode, from 0
    total: return so far
    policy: time of the policy [s]
    missed: deadlines that the policy missed so far, in all episodes
    skipped: periods so far, likewise
    """

    step: Step
    number: int
    total: float
    policy: float
    missed: int
    skipped: int


def event(kind: str, data: Mapping[str, Any]) -> bytes:
    """A Server-Sent Event: "begin", "steps", "over" or "end", with data as JSON."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return f"event: {kind}\ndata: {text}\n\n".encode()


def steps_event(batch: Sequence[WatchedStep], table: str, deadline: float) -> bytes:
    """Consecutive control steps as an event.

    table: energy table
    deadline: [s] of the policy
    """
    steps, last = [each.step for each in batch], batch[-1]
    use = np.array([100 * each.policy / deadline for each in batch])
    curves = [curve("time of the policy, of its deadline", "%", use)]
    names = steps[-1].info
    if _OURS & names.keys():
        curves += info_curves({n: np.array([step.info[n] for step in steps]) for n in names})
    poses = [step.pose for step in steps if step.pose is not None]
    network = trace_network(steps, table)
    data = {
        "first": batch[0].number,
        "steps": len(batch),
        "total": last.total,
        "missed": last.missed,
        "skipped": last.skipped,
        **series_json(
            np.stack(poses) if poses else None,
            [step.reward for step in steps],
            np.stack([step.action for step in steps]),
            curves,
            network_json(network, _MOST_NEURONS) if network else None,
        ),
    }
    return event("steps", data)


# the view

_EVERY = 0.05  # [s] between two looks at what is new
_SILENCE = 2.0  # [s] after which a comment shows whether the browser is still there
_MOST_STEPS = 1000  # control steps of an episode that are kept
_CLOSING = 2.0  # [s] for browsers to receive the end


@dataclass
class _Episode:
    """The episode that is played.

    head: label, scene, period [s] and the like, energy table and deadline
    steps: the last ones
    outcome: outcome of an episode that is over
    """

    head: Mapping[str, Any]
    steps: deque[WatchedStep]
    outcome: Mapping[str, Any] | None = None


class LiveView:
    """The view of a run, with a server of its own; to be closed.

    address: address of its page
    """

    def __init__(self, port: int = 0) -> None:
        self._episode: _Episode | None = None
        self._is_ended = False
        self._browsers = 0
        self._changed = threading.Condition()  # how many browsers listen
        self._server = _Server(self, port)
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/"

    def wait(self, seconds: float) -> bool:
        """Wait for a browser; True if one listens."""
        with self._changed:
            return self._changed.wait_for(lambda: self._browsers > 0, seconds)

    def begin(self, head: Mapping[str, Any]) -> None:
        """Begin an episode: label, scene, period [s], energy table and deadline."""
        self._episode = _Episode(head, deque(maxlen=_MOST_STEPS))

    def step(self, step: WatchedStep) -> None:
        """Add a control step."""
        if self._episode:
            self._episode.steps.append(step)

    def over(self, outcome: Mapping[str, Any]) -> None:
        """End the episode."""
        if self._episode:
            self._episode.outcome = outcome

    def close(self) -> None:
        """Tell browsers of the end, and close the port."""
        self._is_ended = True
        with self._changed:
            self._changed.wait_for(lambda: self._browsers == 0, _CLOSING)
        self._server.shutdown()
        self._server.server_close()

    def events(self) -> Generator[bytes, None, None]:
        """The events for one browser, until the end; a slow one misses the oldest control steps."""
        self._count_browsers(1)
        try:
            yield from self._events()
        finally:
            self._count_browsers(-1)

    def _events(self) -> Iterator[bytes]:
        episode: _Episode | None = None
        heard = time.monotonic()
        while True:
            is_ended = self._is_ended  # before it is looked what there is: nothing is lost
            if self._episode and self._episode is not episode:
                episode, last, is_over = self._episode, -1, False
                yield event("begin", episode.head)
            if episode:
                outcome = episode.outcome
                if batch := [step for step in episode.steps.copy() if step.number > last]:
                    yield steps_event(batch, episode.head["table"], episode.head["deadline"])
                    last, heard = batch[-1].number, time.monotonic()
                if outcome and not is_over:
                    is_over = True
                    yield event("over", outcome)
            if is_ended:
                yield event("end", {})
                return
            if time.monotonic() - heard > _SILENCE:
                heard = time.monotonic()
                yield b": nothing new\n\n"
            time.sleep(_EVERY)

    def _count_browsers(self, change: int) -> None:
        with self._changed:
            self._browsers += change
            self._changed.notify_all()


# the server

_HOST = re.compile(r"(127\.0\.0\.1|localhost)(:[0-9]{1,5})?", re.IGNORECASE)
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
    "Connection": "close",
}
_PATIENCE = 10.0  # [s] of silence in a request, or for a browser to take what it is sent


class _Server(ThreadingHTTPServer):
    """The page and its events, over HTTP on 127.0.0.1, from the beginning on.

    Every program of this machine can read; nothing can be changed. Pages of other origins are kept
    out: by the name of the host, as DNS may lead a name of theirs here, and by what browsers say of
    where a request comes from.
    """

    def __init__(self, view: LiveView, port: int) -> None:
        self.view = view
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except OSError as error:
            raise ConfigError(
                f"--port {port}: cannot listen on 127.0.0.1 ({error.strerror}). Give another, or "
                "leave it out for one that is free."
            ) from error
        threading.Thread(target=self.serve_forever, args=(0.05,), daemon=True).start()

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        """Ignore a browser that leaves."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)


@cache
def _files() -> dict[str, tuple[str, bytes]]:
    """Path -> type and content: nothing else is there to be read."""
    script = "\n".join(asset(name) for name in (*REPLAY_ASSETS, "live.js"))
    texts = {
        "/": ("text/html", asset("live.html")),
        "/live.js": ("text/javascript", script),
        "/live.css": ("text/css", asset("page.css") + asset("live.css")),
    }
    return {path: (kind, text.encode()) for path, (kind, text) in texts.items()}


class _Handler(BaseHTTPRequestHandler):
    """One request."""

    server: _Server
    server_version, sys_version, protocol_version = "spikedeploy", "", "HTTP/1.1"
    timeout = _PATIENCE

    def do_GET(self) -> None:
        """A file, or the events."""
        if not self._is_ours():
            self._refuse(HTTPStatus.FORBIDDEN)
        elif self.path == "/events":
            self._send_events()
        elif self.path in _files():
            kind, content = _files()[self.path]
            self._answer(HTTPStatus.OK, f"{kind}; charset=utf-8", content)
        else:
            self._refuse(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Refuse: there is nothing to change."""
        self._refuse(HTTPStatus.METHOD_NOT_ALLOWED)

    do_HEAD = do_PUT = do_DELETE = do_PATCH = do_OPTIONS = do_POST  # noqa: N815

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: the terminal belongs to the run."""

    def _is_ours(self) -> bool:
        """True of a request by our page, or by somebody who typed its address."""
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or not _HOST.fullmatch(hosts[0]):
            return False
        ours = {f"http://{hosts[0].lower()}"}
        origins = {each.lower() for each in self.headers.get_all("Origin", [])}
        site = self.headers.get("Sec-Fetch-Site", "none")
        # a link may lead to the page
        return self.path == "/" or (origins <= ours and site in ("none", "same-origin"))

    def _send_events(self) -> None:
        self._send_head(HTTPStatus.OK, "text/event-stream")
        with closing(self.server.view.events()) as events:
            for each in events:
                self.wfile.write(each)

    def _refuse(self, status: HTTPStatus) -> None:
        self._answer(status, "text/plain; charset=utf-8", f"{status.phrase}\n".encode())

    def _answer(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self._send_head(status, kind, {"Content-Length": str(len(content))})
        if self.command != "HEAD":
            self.wfile.write(content)

    def _send_head(
        self, status: HTTPStatus, kind: str, more: Mapping[str, str] | None = None
    ) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": kind, **_HEADERS, **(more or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        self.close_connection = True
