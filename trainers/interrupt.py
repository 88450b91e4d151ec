"""Signals that ask a training to stop: at a checkpoint, so that it can be resumed."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from spikedeploy.trainers.progress import ProgressBar

# SIGTERM is what schedulers and `kill` send, SIGHUP a terminal that is closed; Windows lacks both
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


class Interrupt:
    """While entered, Ctrl-C (SIGINT), SIGTERM and SIGHUP request a stop; a second one ends at once.

    requested: number of the signal that came, 0 for none
    share: part of the training that is done, where it stopped before its end
    """

    def __init__(self) -> None:
        self.requested = 0
        self.share: float | None = None
        self._before: dict[int, Any] = {}
        self._say: Callable[[str], None] | None = None

    def __call__(self) -> bool:
        """Return whether a stop was requested."""
        return bool(self.requested)

    @property
    def exit_code(self) -> int:
        """What shells return for the signal: 130, 143 or 129."""
        return 128 + (self.requested or signal.SIGINT)

    @contextmanager
    def acknowledged(self, bar: ProgressBar, quiet: bool) -> Iterator[None]:
        """Say beside the bar that it was pressed, at once."""
        self._say = None if quiet else bar.say
        with self:
            yield
        self._say = None

    def __enter__(self) -> "Interrupt":
        if threading.current_thread() is threading.main_thread():  # elsewhere Python forbids it
            for number in _heard():
                self._before[number] = signal.signal(number, self._request)
        return self

    def __exit__(self, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        self._before = {}

    def _request(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = number
        if self._say is not None:
            with suppress(OSError):  # of a terminal that was closed
                self._say("stopping after this step … (Ctrl-C again stops at once)")


def _heard() -> list[int]:
    """The signals to listen to; SIGHUP is not one where nohup has it ignored."""
    found = [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
    ignored = signal.Handlers.SIG_IGN
    return [
        number
        for number in found
        if signal.getsignal(number) is not None
        and (number == signal.SIGINT or signal.getsignal(number) != ignored)
    ]
