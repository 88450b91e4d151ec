"""Port to the design in simulation, by the pins of its UART; the standard library only."""

import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

SILENCE, GLITCH, BROKEN = 0x200, 0x300, 0x100
_MOST = 1_000_000  # bit times to wait for a byte, so that a design that is stuck is noticed

Symbols = list[int]


class PinsPort:
    """A serial port, with the calls of pyserial, whose other end is a simulated design.

    program: that Verilator built.
    noise: what becomes of the bytes that are sent, as symbols of pins_main.cpp.
    bit_times: for which `read` waits.
    clocks: of the design so far.
    timeout: not used, as time stands still between two calls.
    """

    timeout: float | None = None

    def __init__(
        self, program: Path, noise: Callable[[Symbols], Symbols] = list, bit_times: int = 20_000
    ) -> None:
        self.noise, self.bit_times, self.clocks = noise, bit_times, 0
        self._symbols: Symbols = []
        self._process = subprocess.Popen(
            [program.resolve()], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
        )

    def write(self, data: bytes, /) -> int:
        """Send bytes, with the next `read`."""
        self._symbols += self.noise(list(data))
        return len(data)

    def read(self, size: int = 1, /) -> bytes:
        """Read at least so many bytes, or those that come before `bit_times` are over."""
        symbols, self._symbols = self._symbols, []
        head = struct.pack("<III", len(symbols), size, self.bit_times)
        self._process.stdin.write(head + struct.pack(f"<{len(symbols)}H", *symbols))  # type: ignore[union-attr]
        self.clocks, count = struct.unpack("<II", self._take(8))
        return self._take(count)

    def _take(self, size: int) -> bytes:
        """Read so many bytes from the simulation."""
        taken = b""
        while len(taken) < size:
            part = self._process.stdout.read(size - len(taken))  # type: ignore[union-attr]
            if not part:
                raise EOFError("the simulation has ended")
            taken += part
        return taken

    def close(self) -> None:
        """End the simulation."""
        self._process.stdin.close()  # type: ignore[union-attr]
        self._process.wait()
        self._process.stdout.close()  # type: ignore[union-attr]
