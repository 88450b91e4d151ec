"""A stand-in for a core in simulation: the interpreter behind the interface of hardware."""

import numpy as np

from spikedeploy.exporters.verilog.simulation import Timestep
from spikedeploy.runtime.emulator.interpreter import Interpreter


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
            if layer.name in self.program.to_host:
                outputs[layer.name] = (spikes if layer.spiking else membrane)[part]
        return Timestep(100, outputs, current, membrane, spikes)
