"""Equal to other emulators of Loihi in every current, voltage and spike.

The chip is lava's reading (lava-nc 0.10.0). The traces of brian2_loihi 0.5.2 and nengo-loihi 1.1.0
show that the datasheet's options say what these do differently.
"""

import numpy as np
import pytest

from runtime.interpreter import trace
from runtime.machine import Machine
from tests.programs import GOLDEN, golden

TRACES = sorted(path for path in GOLDEN.glob("*.json") if path.name[:6] != "sanafe")


def test_there_are_traces_to_compare_with():
    names = [path.stem.split("_")[:2] for path in TRACES]
    assert ["lava", "L"] in names
    assert len(names) == 7 + 4 + 2


def check(layers, ran):
    for k, expected in enumerate(layers):
        found = ran[f"layer{k}"]
        np.testing.assert_array_equal(found.current[0], expected["u"])
        np.testing.assert_array_equal(found.membrane[0], expected["v"])
        np.testing.assert_array_equal(found.spikes[0], expected["s"])


@pytest.mark.parametrize("path", TRACES, ids=lambda path: path.stem)
def test_the_interpreter_equals_the_trace(path):
    program, raster, layers = golden(path)
    check(layers, trace(program, raster))


@pytest.mark.parametrize("path", TRACES, ids=lambda path: path.stem)
def test_the_machine_equals_the_trace(path):
    program, raster, layers = golden(path)
    machine = Machine(program, trace=True)
    machine.infer(raster)
    check(layers, machine.recordings)


@pytest.mark.parametrize("path", TRACES, ids=lambda path: path.stem)
def test_streaming_equals_the_trace(path):
    program, raster, layers = golden(path)
    machine = Machine(program)
    for t in range(raster.shape[1]):
        machine.step(raster[:, t])
        for k, expected in enumerate(layers):
            np.testing.assert_array_equal(machine.current[f"layer{k}"][0], expected["u"][t])
            np.testing.assert_array_equal(machine.membrane[f"layer{k}"][0], expected["v"][t])
