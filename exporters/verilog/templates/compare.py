"""Comparison of the design with the emulator, word by word; the standard library.

Usage: `python3 compare.py core PROGRAM [STEPS]`, of the core or its netlist, which sim_main.cpp
drives; `python3 compare.py pins PROGRAM [STEPS]`, of the design of the board, by its UART.
"""

import json
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from link import END_OF_TIMESTEP, NEW_EPISODE, Link
from pins import PinsPort


@dataclass(frozen=True)
class Vector:
    """A timestep of the emulator.

    new: whether an episode begins with it.
    axons: that spike in it.
    words: that leave the core.
    """

    new: bool
    axons: tuple[int, ...]
    words: tuple[int, ...]


def read_vectors(steps: int | None = None) -> Iterator[Vector]:
    """The timesteps of tokens.hex and words.hex, in which the last word of each is marked."""
    words = map(_number, Path("words.hex").read_text("ascii").split())
    new, axons, count = False, [], 0
    for token in map(_number, Path("tokens.hex").read_text("ascii").split()):
        if count == steps:
            return
        if token == NEW_EPISODE:
            new = True
        elif token == END_OF_TIMESTEP:
            leaving = []
            while not leaving or not leaving[-1] >> 32:
                leaving.append(next(words))
            yield Vector(new, tuple(axons), tuple(word & 0xFFFFFFFF for word in leaving))
            new, axons, count = False, [], count + 1
        else:
            axons.append(token)


def _number(text: str) -> int:
    return int(text, 16)


class CoreProcess:
    """The core as a process that sim_main.cpp makes of it."""

    def __init__(self, program: str, words: int) -> None:
        self._words, self.clocks = words, 0
        self._process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def run(self, step: Vector) -> tuple[int, ...]:
        """The words of a timestep."""
        tokens = [NEW_EPISODE] * step.new + [*step.axons, END_OF_TIMESTEP]
        into, out = self._process.stdin, self._process.stdout
        assert into is not None
        assert out is not None
        into.write(struct.pack(f"<{len(tokens) + 1}H", len(tokens), *tokens))
        into.flush()
        clocks, *words = struct.unpack(f"<{1 + self._words}I", out.read(4 + 4 * self._words))
        self.clocks += clocks
        return tuple(words)


class PinsProcess:
    """The design of the board behind its UART."""

    def __init__(self, program: str) -> None:
        sizes = json.loads(Path("policy.json").read_text("utf-8"))["link"]
        self._port = PinsPort(Path(program))
        self._link = Link(self._port, sizes["tokens"], sizes["words"], sizes["timestep"])

    @property
    def clocks(self) -> int:
        """Clocks of the design so far, with those of the UART."""
        return self._port.clocks

    def run(self, step: Vector) -> tuple[int, ...]:
        """The words of a timestep."""
        return tuple(self._link.infer([step.axons], forget=step.new)[0])


def main(arguments: Sequence[str]) -> int:
    """Replay the vectors; 0 where all words are equal."""
    kind, program, *rest = arguments
    try:
        steps = list(read_vectors(int(rest[0]) if rest else None))
    except (OSError, ValueError, RuntimeError) as error:
        print(f"tokens.hex, words.hex or STEPS cannot be read ({error})", file=sys.stderr)
        return 2
    if not steps:
        print("no timestep to compare: STEPS is 0, or tokens.hex has none", file=sys.stderr)
        return 2
    words = len(steps[0].words)
    process = CoreProcess(program, words) if kind == "core" else PinsProcess(program)
    for number, step in enumerate(steps):
        found = process.run(step)
        if found != step.words:
            at = next(k for k in range(words) if found[k : k + 1] != step.words[k : k + 1])
            print(
                f"differs: timestep {number}, word {at}: expected {step.words[at]:08x}, found "
                f"{' '.join(f'{word:08x}' for word in found[at : at + 1]) or 'none'}"
            )
            return 1
    mean = process.clocks / len(steps)
    print(f"equal: {len(steps)} timesteps, {words} words each; {mean:,.0f} clocks a timestep")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
