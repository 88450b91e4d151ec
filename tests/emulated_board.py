"""A board behind a pseudo-terminal: frames as link.v answers them, the core as its model."""

import os
import pty
import random
import select
import threading
import tty

from spikedeploy.exporters.verilog.image import FORGET, STEP
from tests.board_designs import scripts
from tests.core_model import CoreModel

LINK = scripts().link


class FilePort:
    """A serial port on a file, with the calls of pyserial."""

    def __init__(self, path):
        self.timeout = None
        self._file = os.open(path, os.O_RDWR | os.O_NOCTTY)

    def write(self, data):
        return os.write(self._file, data)

    def read(self, size=1):
        found = b""
        while len(found) < size and select.select([self._file], [], [], self.timeout)[0]:
            found += os.read(self._file, size - len(found))
        return found

    def close(self):
        os.close(self._file)


class EmulatedBoard:
    """A board on a pseudo-terminal.

    path: of the port.
    lose: share of requests that it does not hear, and of replies that come damaged.
    """

    def __init__(self, image, lose=0.0):
        self._core, self._lose, self._random = CoreModel(image), lose, random.Random(0)
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        self.path = os.ttyname(self._theirs)
        self._done, self._reply = 0, []
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        os.write(self._stop_write, b"x")
        self._thread.join()
        for each in (self._ours, self._theirs, self._stop_read, self._stop_write):
            os.close(each)

    def _serve(self):
        received = bytearray()
        while True:
            # a pause ends a request
            wait = LINK.PAUSE if received else None
            ready = select.select([self._ours, self._stop_read], [], [], wait)[0]
            if self._stop_read in ready:
                return
            if not ready:
                received.clear()
                continue
            received += os.read(self._ours, 4096)
            while received and received[0] != LINK.REQUEST:
                del received[0]
            if len(received) < 3 or len(received) < (size := 5 + 2 * received[2]):
                continue
            frame = bytes(received[1:size])
            del received[:size]
            if LINK.crc(frame) or self._random.random() < self._lose:
                continue
            os.write(self._ours, self._answer(frame))

    def _answer(self, frame):
        sequence = frame[0]
        if sequence != self._done:
            self._done, self._reply = sequence, []
            tokens = memoryview(frame[2:-2]).cast("H")
            for token in tokens:
                if token == FORGET:
                    self._core.reset()
                    self._axons = []
                elif token == STEP:
                    self._reply += self._core.step(self._axons).words
                    self._axons = []
                else:
                    self._axons.append(token)
        found = bytearray(LINK.reply(sequence, self._reply))
        if self._random.random() < self._lose:
            found[self._random.randrange(len(found))] ^= 1
        return bytes(found)

    _axons = ()
