"""Boards: FPGA, clock and pins of those that can be bought, as boards.toml has them."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_toml

_FILE = Path(__file__).with_name("boards.toml")
# [seconds] of silence that end a request; a host that is held up for longer repeats it
_PAUSE = 0.004
# what a level is called in the constraints of an ECP5
_PULL = {"rx": "UP", "button": "DOWN", "clk": "NONE"}


@dataclass(frozen=True)
class Device:
    """An FPGA.

    name: as nextpnr calls it, without dashes.
    title: as its maker calls it.
    family: "ice40" or "ecp5".
    cells: each a LUT of four inputs and a flip-flop.
    block_rams: of block_bits bits each.
    large_rams: of 256 kbit without initial contents.
    multipliers: of 16 or 18 bits.
    source: of these numbers.
    """

    name: str
    title: str
    family: str
    cells: int
    block_rams: int
    block_bits: int
    large_rams: int
    multipliers: int
    source: str


@dataclass(frozen=True)
class Board:
    """A board.

    name: on the command line.
    title: as its makers call it.
    device: its FPGA; package: of that.
    clock_hz: of the oscillator [Hz].
    baud: of the UART [bits/s].
    pins: by what is connected: clk, rx, tx, lamp; and, where there are any, button, flash (low
        where the programmer talks to the memory that shares tx), high (to be held so).
    lamp_low, button_low: whether level 0 means on, or pressed.
    program: commands, without the file, that bring a bitstream onto it; one is enough.
    source: of the pins.
    note: on what has to be done to the board; "" where nothing.
    """

    name: str
    title: str
    device: Device
    package: str
    clock_hz: int
    baud: int
    pins: Mapping[str, str]
    lamp_low: bool
    button_low: bool
    program: tuple[str, ...]
    source: str
    note: str

    @property
    def divider(self) -> int:
        """Clocks of a bit of the UART."""
        return round(self.clock_hz / self.baud)

    @property
    def pause_bits(self) -> int:
        """Bits of the counter of clocks without a byte that end a request."""
        return max(8, round(self.clock_hz * _PAUSE).bit_length())

    @property
    def ports(self) -> dict[str, str]:
        """Ports of the top module: their names in Verilog, by what they are connected to."""
        low = {"lamp": self.lamp_low, "button": self.button_low, "flash": True}
        return {name: name + ("_n" if low.get(name) else "") for name in self.pins}

    @property
    def constraints(self) -> str:
        """The pins and the clock as nextpnr reads them."""
        lines = self._pcf() if self.device.family == "ice40" else self._lpf()
        return "\n".join([f"# {self.title}: {self.source}", *lines]) + "\n"

    @property
    def constraints_name(self) -> str:
        """The file of the constraints."""
        return self.name + (".pcf" if self.device.family == "ice40" else ".lpf")

    def _pcf(self) -> list[str]:
        lines = [
            f"set_io{' -pullup yes' if name in ('rx', 'flash', 'button') else ''} {port} "
            f"{self.pins[name]}"
            for name, port in self.ports.items()
        ]
        return [*lines, f"set_frequency clk {self.clock_hz / 1e6:g}"]

    def _lpf(self) -> list[str]:
        lines = []
        for name, port in self.ports.items():
            pull = f" PULLMODE={_PULL[name]}" if name in _PULL else ""
            lines.append(f'LOCATE COMP "{port}" SITE "{self.pins[name]}";')
            lines.append(f'IOBUF PORT "{port}" IO_TYPE=LVCMOS33{pull};')
        return [*lines, f'FREQUENCY PORT "clk" {self.clock_hz / 1e6:g} MHZ;']


@cache
def _tables() -> tuple[dict[str, Device], dict[str, Board]]:
    """Read boards.toml: FPGAs and boards by name."""
    read: dict[str, Any] = read_toml(_FILE)
    devices = {name: Device(name=name, **each) for name, each in read["device"].items()}
    boards = {
        name: Board(
            name=name,
            **{
                **each,
                "device": devices[each["device"]],
                "program": tuple(each["program"]),
            },
        )
        for name, each in read["board"].items()
    }
    return devices, boards


def board_names() -> tuple[str, ...]:
    """Names of the known boards."""
    return tuple(_tables()[1])


def board(name: str) -> Board:
    """The board of that name; ConfigError where there is none."""
    boards = _tables()[1]
    if name not in boards:
        near = get_close_matches(name, boards, n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ConfigError(f"--board: there is no board {name!r}.{hint} Known: {', '.join(boards)}.")
    return boards[name]
