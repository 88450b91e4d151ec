"""The core in Verilator as a process: tokens in, words, clocks and states out."""

import struct
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.verilog.image import FORGET, STEP, CoreImage, Output
from spikedeploy.runtime.errors import ConfigError

PROGRAM = "policy_sim"
_PROBED = np.dtype([("current", "<i8"), ("membrane", "<i8"), ("spike", "u1")])


@dataclass(frozen=True)
class Timestep:
    """A timestep of the core.

    clocks: from its first token until it could take another one.
    values: (N,) of each layer that the host listens to: membranes [state units], or spikes.
    current, membrane: (N,) of all neurons [state units]; spikes: (N,); empty without a probe.
    """

    clocks: int
    values: Mapping[str, NDArray[np.int64]]
    current: NDArray[np.int64]
    membrane: NDArray[np.int64]
    spikes: NDArray[np.uint8]


class RtlProcess:
    """A running simulation; close it, or use it as a context.

    program: built from sim_main.cpp, or what speaks as it does.
    outputs: layers that the host listens to.
    neurons: N of all layers.
    probe: whether each timestep has the states of all neurons.
    stall: seed of random waiting; None for none.
    """

    def __init__(
        self,
        program: Path,
        outputs: Sequence[Output],
        neurons: int,
        probe: bool = False,
        stall: int | None = None,
    ) -> None:
        options = ["--probe"] * probe + ([] if stall is None else ["--stall", str(stall)])
        self._outputs, self._neurons, self._probe = tuple(outputs), neurons, probe
        self._process = subprocess.Popen(
            [str(program.absolute()), *options],
            cwd=program.absolute().parent,  # the contents of the memories are there
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )

    def __enter__(self) -> "RtlProcess":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the process, also one that ended by itself or does not end."""
        process = self._process
        if process.stdin and not process.stdin.closed:
            with suppress(BrokenPipeError):  # of bytes that nobody reads any more
                process.stdin.close()
        if process.stdout:
            process.stdout.close()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def reset(self) -> None:
        """Begin a new episode: forget every state and spike."""
        self.send([FORGET])

    def step(self, axons: Iterable[int]) -> Timestep:
        """Compute a timestep in which these input axons spike."""
        self.send([*axons, STEP])
        (clocks,) = struct.unpack("<I", self._read(4))
        none = np.zeros(0, np.int64)
        current, membrane, spikes = none, none, np.zeros(0, np.uint8)
        if self._probe:
            probed = np.frombuffer(self._read(self._neurons * _PROBED.itemsize), _PROBED)
            current, membrane = probed["current"], probed["membrane"]
            spikes = probed["spike"]
        return Timestep(clocks, self._values(), current, membrane, spikes)

    def send(self, tokens: Sequence[int]) -> None:
        """Send tokens as they are."""
        found = np.array([len(tokens), *tokens], "<u2").tobytes()
        pipe = self._process.stdin
        try:
            if pipe is None:
                raise BrokenPipeError
            pipe.write(found)
            pipe.flush()
        except BrokenPipeError:
            raise self._ended() from None

    def _values(self) -> dict[str, NDArray[np.int64]]:
        """What has come of each layer."""
        found = {}
        for output in self._outputs:
            words = np.frombuffer(self._read(4 * output.words), "<u4")
            found[output.layer] = decode_words(words, output)
        return found

    def _read(self, count: int) -> bytes:
        pipe = self._process.stdout
        found = pipe.read(count) if pipe else b""
        if len(found) < count:
            raise self._ended()
        return found

    def _ended(self) -> ConfigError:
        return ConfigError(f"the simulation {self._process.args!r} has ended by itself")


def decode_words(words: NDArray[np.uint32], output: Output) -> NDArray[np.int64]:
    """Membranes, or spikes (N,), that a layer's words stand for."""
    if output.silent:
        return words.astype("<u4").view("<i4").astype(np.int64)
    bits = np.unpackbits(words.astype("<u4").view(np.uint8), bitorder="little")
    return bits[: output.neurons].astype(np.int64)


def image_process(program: Path, image: CoreImage, stall: int | None = None) -> RtlProcess:
    """A simulation of an image, with its probe."""
    return RtlProcess(program, image.outputs, image.neurons, True, stall)
