"""The core in Verilator as a process: tokens in, words, clocks and states out."""

import struct
import subprocess
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.verilog.image import FORGET, STEP, CoreImage, OutputWords
from spikedeploy.runtime.errors import ConfigError

PROGRAM = "policy_sim"
_PROBED = np.dtype([("current", "<i8"), ("membrane", "<i8"), ("spike", "u1")])


@dataclass(frozen=True)
class Timestep:
    """A timestep of the core.

    clocks: from its first token until it could take another one.
    values: (N,) of each layer that the host reads: membranes [state units], or spikes.
    current, membrane: (N,) of all neurons [state units]; spikes: (N,).
    """

    clocks: int
    values: Mapping[str, NDArray[np.int64]]
    current: NDArray[np.int64]
    membrane: NDArray[np.int64]
    spikes: NDArray[np.uint8]


class RtlProcess:
    """A running simulation, with the states of all neurons; use it as a context.

    program: built from sim_main.cpp, or what speaks as it does.
    image: of the core.
    stall: seed of random waiting; None for none.
    """

    def __init__(self, program: Path, image: CoreImage, stall: int | None = None) -> None:
        self._outputs, self._neurons = image.outputs, image.neurons
        program = program.absolute()
        self._process = subprocess.Popen(
            [str(program), "--probe", *([] if stall is None else ["--stall", str(stall)])],
            cwd=program.parent,  # the contents of the memories are there
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    def __enter__(self) -> "RtlProcess":
        return self

    def __exit__(self, *_: object) -> None:
        """End the process, also one that ended by itself or does not end."""
        process = self._process
        for pipe in (process.stdin, process.stdout):
            with suppress(BrokenPipeError):  # bytes are left that nothing reads
                if pipe is not None:
                    pipe.close()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def reset(self) -> None:
        """Begin a new episode: forget every state and spike."""
        self._send(FORGET)

    def step(self, axons: Iterable[int]) -> Timestep:
        """Compute a timestep in which these input axons spike."""
        self._send(*axons, STEP)
        (clocks,) = struct.unpack("<I", self._read(4))
        probed = np.frombuffer(self._read(self._neurons * _PROBED.itemsize), _PROBED)
        values = {
            output.layer: decode_words(np.frombuffer(self._read(4 * output.words), "<u4"), output)
            for output in self._outputs
        }
        return Timestep(clocks, values, probed["current"], probed["membrane"], probed["spike"])

    def _send(self, *tokens: int) -> None:
        pipe = self._process.stdin
        try:
            if pipe is None:
                raise BrokenPipeError
            pipe.write(np.array([len(tokens), *tokens], "<u2").tobytes())
            pipe.flush()
        except BrokenPipeError:
            raise self._ended() from None

    def _read(self, count: int) -> bytes:
        pipe = self._process.stdout
        found = pipe.read(count) if pipe else b""
        if len(found) < count:
            raise self._ended()
        return found

    def _ended(self) -> ConfigError:
        return ConfigError(f"the simulation {self._process.args!r} has ended by itself")


def decode_words(words: NDArray[np.uint32], output: OutputWords) -> NDArray[np.int64]:
    """Membranes, or spikes (N,), that a layer's words stand for."""
    if output.silent:
        return words.astype("<u4").view("<i4").astype(np.int64)
    bits = np.unpackbits(words.astype("<u4").view(np.uint8), bitorder="little")
    return bits[: output.neurons].astype(np.int64)
