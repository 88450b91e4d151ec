"""Frames over a serial port to the core on the board, as link.v has them.

    request   A5  sequence  n  n tokens of 2 bytes  CRC of 2 bytes
    reply     5A  sequence  n  n words of 4 bytes   CRC of 2 bytes

A request that is not answered in time is repeated with its sequence number, and the board, which
knows the number, does nothing twice. A board that has restarted, and has forgotten its states,
answers nothing until an empty request comes, which a Link sends where it begins. The standard
library is all that is needed.
"""

import struct
from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

REQUEST, REPLY = 0xA5, 0x5A
END_OF_TIMESTEP, NEW_EPISODE = 0x8000, 0x8001
_HEAD = 3  # bytes before the tokens or words
_CHECK = 2  # and behind them
# bytes without a reply among them after which a request is repeated
_PATIENCE = 4096
# [seconds] that the board waits for the rest of a request
PAUSE = 0.006


class Port(Protocol):
    """A serial port, such as serial.Serial with a timeout."""

    timeout: float | None

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""

    def read(self, size: int = 1, /) -> bytes:
        """Read so many bytes, or those that came before the timeout."""


class LinkError(Exception):
    """A board that does not answer, or not as the policy does."""


def crc(data: Iterable[int]) -> int:
    """CRC-16/MCRF4XX: polynomial 1021 reflected, from FFFF."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x8408 if value & 1 else 0)
    return value


def request(sequence: int, tokens: Sequence[int]) -> bytes:
    """The bytes of a request."""
    body = struct.pack(f"<BB{len(tokens)}H", sequence, len(tokens), *tokens)
    return bytes([REQUEST]) + body + struct.pack("<H", crc(body))


def reply(sequence: int, words: Sequence[int]) -> bytes:
    """The bytes of a reply."""
    body = struct.pack(f"<BB{len(words)}I", sequence, len(words), *words)
    return bytes([REPLY]) + body + struct.pack("<H", crc(body))


def find_reply(received: bytearray, sequence: int) -> tuple[list[int] | None, int]:
    """The words of the reply with this number; or None, and the bytes that are missing at least.

    What cannot be part of it is removed from `received`.
    """
    while received:
        if received[0] != REPLY or (len(received) > 1 and received[1] != sequence):
            del received[0]
            continue
        size = _HEAD + 4 * received[2] + _CHECK if len(received) >= _HEAD else _HEAD + _CHECK
        if len(received) < size:
            return None, size - len(received)
        if crc(received[1:size]):
            del received[0]
            continue
        words = struct.unpack_from(f"<{received[2]}I", received, _HEAD)
        del received[:size]
        return list(words), 0
    return None, _HEAD + _CHECK


class Link:
    """The core on a board.

    port: to the board; its timeout is set.
    tokens_most: of a request.
    words_most: of a reply.
    words: of a timestep.
    seconds: in which a timestep is computed, at most, and the operating system hands bytes on.
    tries: requests until the board is given up.
    repeated: requests that were sent again.
    """

    def __init__(
        self,
        port: Port,
        tokens_most: int,
        words_most: int,
        words: int,
        seconds: float = 0.05,
        tries: int = 5,
    ) -> None:
        self.port, self.tokens_most, self.words_most = port, tokens_most, words_most
        self.words, self.tries, self.repeated = words, tries, 0
        port.timeout = max(seconds, 2 * PAUSE)
        self._received = bytearray()
        self._sequence = 0
        # an empty request: whatever the board did last, the next number is new to it
        self.exchange([])
        self.reset()

    def reset(self) -> None:
        """Begin an episode: all states are forgotten."""
        self.exchange([NEW_EPISODE])

    def infer(self, timesteps: Iterable[Sequence[int]], forget: bool = False) -> list[list[int]]:
        """The words of each timestep, of the input axons that spike in it.

        LinkError where the board does not answer, or answers more or fewer words.
        forget: whether all states are forgotten before.
        """
        tokens, found, count = [NEW_EPISODE] * forget, [], 0
        for axons in timesteps:
            tokens += [*axons, END_OF_TIMESTEP]
            count += 1
        for part in self._parts(tokens):
            found += self.exchange(part)
        if len(found) != self.words * count:
            raise LinkError(
                f"the board has answered {len(found)} words to {count} timesteps of {self.words} "
                "words each. Is the bitstream on it of this policy?"
            )
        return [found[k : k + self.words] for k in range(0, len(found), self.words)]

    def _parts(self, tokens: Sequence[int]) -> Iterator[Sequence[int]]:
        """Split tokens so that each request, and its reply, fits the board's buffer."""
        ends = max(1, self.words_most // max(self.words, 1))
        part: list[int] = []
        left = ends
        for token in tokens:
            part.append(token)
            left -= token == END_OF_TIMESTEP
            if len(part) == self.tokens_most or not left:
                yield part
                part, left = [], ends
        if part:
            yield part

    def exchange(self, tokens: Sequence[int]) -> list[int]:
        """The words that the board answers to tokens; LinkError where it does not."""
        self._sequence = (self._sequence + 1) % 256
        for attempt in range(self.tries):
            self.repeated += attempt > 0
            self.port.write(request(self._sequence, tokens))
            words = self._answer()
            if words is not None:
                return words
        raise LinkError(
            f"the board has not answered {self.tries} requests. Is the bitstream on it, and is "
            "this its port and its baud rate, or has it restarted?"
        )

    def _answer(self) -> list[int] | None:
        """The words of the reply; None where none comes in time."""
        left = _PATIENCE
        while left > 0:
            words, missing = find_reply(self._received, self._sequence)
            if words is not None:
                return words
            came = self.port.read(missing)
            if not came:
                return None
            self._received += came
            left -= len(came)
        return None
