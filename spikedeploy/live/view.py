"""What a loop hands its control steps to: they are put together and sent in a thread of their own.

The loop appends to a bounded list and goes on, whatever browsers do.
"""

import threading
from collections import deque
from collections.abc import Mapping
from typing import Any

from spikedeploy.live.backlog import Listeners
from spikedeploy.live.server import LiveServer
from spikedeploy.live.steps import WatchedStep, message, told

_EVERY = 0.05  # [s] between two messages
_MOST_STEPS = 2000  # control steps that wait to be put together
_GOODBYE = 2.0  # [s] that browsers have to hear of the end


class LiveView:
    """The view of a run; to be closed.

    address  of its page
    """

    def __init__(self, port: int = 0) -> None:
        self._listeners = Listeners()
        self._server = LiveServer(self._listeners, port)
        self.address = self._server.address
        self._steps: deque[WatchedStep] = deque(maxlen=_MOST_STEPS)
        self._table, self._deadline = "", 1.0
        self._sending, self._closed = threading.Lock(), threading.Event()
        threading.Thread(target=self._send, daemon=True).start()

    def wait(self, seconds: float) -> bool:
        """Wait for a browser; whether one looks."""
        return self._listeners.some(seconds)

    def begin(self, episode: Mapping[str, Any], table: str, deadline: float) -> None:
        """An episode begins.

        episode   label, scene, period [s] and the like
        table     of the energy
        deadline  of the policy [s]
        """
        with self._sending:
            self._flush()
            self._table, self._deadline = table, deadline
            shown = {**episode, "table": table, "deadline": deadline}
            self._listeners.tell(message("begin", shown))

    def step(self, step: WatchedStep) -> None:
        """A control step was taken."""
        self._steps.append(step)

    def over(self, outcome: Mapping[str, Any]) -> None:
        """The episode is over."""
        with self._sending:
            self._flush()
            self._listeners.tell(message("over", outcome))

    def close(self) -> None:
        """Tell browsers of the end, and give the port back."""
        self._closed.set()
        with self._sending:
            self._flush()
            self._listeners.tell(message("end", {}))
        self._listeners.drained(_GOODBYE)
        self._server.close()

    def _send(self) -> None:
        while not self._closed.wait(_EVERY):
            with self._sending:
                self._flush()

    def _flush(self) -> None:
        batch = [self._steps.popleft() for _ in range(len(self._steps))]
        if batch:
            self._listeners.tell(told(batch, self._table, self._deadline))
