"""A stand-in for a core in simulation: the interpreter behind the interface of hardware."""

import shlex
import struct
import sys

import numpy as np

from spikedeploy.exporters.verilog.image import FORGET, STEP
from spikedeploy.exporters.verilog.simulation import Timestep
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.interpreter import Interpreter
from tests.paths import ROOT


class EmulatedHardware:
    """Answers as a core does; `wrong` (timestep, neuron) has a bit of that membrane flipped."""

    def __init__(self, program, wrong=None):
        self.program, self.wrong, self.timesteps = program, wrong, 0
        self.reset()

    def reset(self):
        self.interpreter = Interpreter(self.program, 1)

    def step(self, axons):
        row = np.zeros((1, 1, self.program.width), np.uint8)
        row[0, 0, axons] = 1
        traces = self.interpreter.run(row)
        each = [traces[layer.name] for layer in self.program.layers]
        current, membrane, spikes = (
            np.concatenate([getattr(t, q)[0, 0].astype(np.int64) for t in each])
            for q in ("current", "membrane", "spikes")
        )
        if self.wrong is not None and self.wrong[0] == self.timesteps:
            membrane[self.wrong[1]] ^= 1
        self.timesteps += 1
        outputs, first = {}, 0
        for layer in self.program.layers:
            part = slice(first, first + layer.size)
            first = part.stop
            if layer.name in self.program.output_layers:
                outputs[layer.name] = (spikes if layer.spiking else membrane)[part]
        return Timestep(100, outputs, current, membrane, spikes)


def answer(policy, chip_name, wrong):
    """Speak on stdin and stdout as a simulation of the core does, with a probe."""
    artifact = load(policy)
    hardware = EmulatedHardware(compile_program(artifact, chip(chip_name)), wrong)
    into, out = sys.stdin.buffer, sys.stdout.buffer
    axons = []
    while head := into.read(2):
        (count,) = struct.unpack("<H", head)
        for token in struct.unpack(f"<{count}H", into.read(2 * count)):
            if token == FORGET:
                hardware.reset()
            elif token != STEP:
                axons.append(token)
                continue
            else:
                out.write(encoded(hardware, hardware.step(axons)))
                out.flush()
            axons = []


def encoded(hardware, found):
    """The bytes of a timestep."""
    text = struct.pack("<I", found.clocks)
    for each in zip(found.current, found.membrane, found.spikes, strict=True):
        text += struct.pack("<qqB", *map(int, each))
    for name, values in found.values.items():
        if hardware.program.layer(name).spiking:
            bits = np.packbits(values.astype(np.uint8), bitorder="little")
            text += bits.tobytes().ljust(-(-len(values) // 32) * 4, b"\0")
        else:
            text += values.astype("<i4").tobytes()
    return text


def makefile(policy, chip_name, wrong=None):
    """A Makefile whose simulation is this file."""
    words = [policy, chip_name, *(wrong or ())]
    run = f"{sys.executable} -c 'import tests.emulated_hardware as e; e.main()'"
    line = f'PYTHONPATH={ROOT} exec {run} {" ".join(map(str, words))} "$@"'.replace("$", "$$")
    return f"policy_sim:\n\t@(echo '#!/bin/sh'; echo {shlex.quote(line)}) >$@ && chmod +x $@\n"


def main():
    """Answer for the policy, the chip and the wrong bit in the command line."""
    policy, chip_name, *wrong = sys.argv[1:]
    numbers = tuple(int(word) for word in wrong if word.isdigit())
    answer(policy, chip_name, numbers or None)
