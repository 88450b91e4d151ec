"""A lock for objects that are copied."""

from threading import Lock


class SerialCalls:
    """Makes calls from several threads wait for one another; a copy has a lock of its own.

    lock: to be held during a call.
    """

    __slots__ = ("lock",)

    def __init__(self) -> None:
        self.lock = Lock()

    def __reduce__(self) -> "tuple[type[SerialCalls], tuple[()]]":
        return SerialCalls, ()
