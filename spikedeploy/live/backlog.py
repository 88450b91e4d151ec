"""What browsers are yet to be told; a slow one loses the oldest control steps, nobody waits."""

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from spikedeploy.live.steps import Message


class Backlog:
    """Messages in order, at most so many of control steps; `begin` replaces all before it.

    What is lost shows in the numbers of the steps that are left.
    """

    def __init__(self, most: int, messages: Iterable[Message] = ()) -> None:
        self._most, self._messages = most, list(messages)

    def __len__(self) -> int:
        return len(self._messages)

    def __iter__(self) -> Iterator[Message]:
        return iter(self._messages)

    def add(self, message: Message) -> None:
        """Append a message."""
        if message.kind == "begin":
            self._messages.clear()
        self._messages.append(message)
        steps = [place for place, m in enumerate(self._messages) if m.kind == "steps"]
        if len(steps) > self._most:
            del self._messages[steps[0]]

    def take(self) -> list[Message]:
        """All messages, which are then no longer here."""
        taken, self._messages = self._messages, []
        return taken


class Listeners:
    """The browsers that listen, and what one that comes later is told first.

    most  messages of control steps that wait for a browser, and are kept for later ones
    """

    def __init__(self, most: int = 200) -> None:
        self._most = most
        self._changed = threading.Condition()
        self._kept = Backlog(most)
        self._waiting: list[Backlog] = []

    def tell(self, message: Message) -> None:
        """Hand a message to all."""
        with self._changed:
            for backlog in (self._kept, *self._waiting):
                backlog.add(message)
            self._changed.notify_all()

    @contextmanager
    def one(self) -> Iterator[Backlog]:
        """The backlog of a browser that comes, until it leaves."""
        with self._changed:
            backlog = Backlog(self._most, self._kept)
            self._waiting.append(backlog)
            self._changed.notify_all()
        try:
            yield backlog
        finally:
            with self._changed:
                # by identity: two that wait for the same messages are two
                self._waiting = [each for each in self._waiting if each is not backlog]
                self._changed.notify_all()

    def next(self, backlog: Backlog, timeout: float) -> list[Message]:
        """What is new; empty after a silence of so many seconds."""
        with self._changed:
            self._changed.wait_for(lambda: len(backlog), timeout)
            return backlog.take()

    def some(self, timeout: float) -> bool:
        """Wait for the first browser; whether one listens."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._waiting), timeout)

    def drained(self, timeout: float) -> bool:
        """Wait until all have left, as they do when they were told of the end."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._waiting, timeout)
