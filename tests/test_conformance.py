"""Equal to lava-nc 0.10.0's bit-accurate models in every current, voltage and spike."""

import numpy as np
import pytest
from tests.programs import GOLDEN, golden

from runtime.interpreter import trace
from runtime.machine import Machine

TRACES = sorted(GOLDEN.glob("lava_*.json"))


def test_there_are_traces_to_compare_with():
    assert [path.name[5] for path in TRACES] == list("ABFHIKL")


def check(layers, ran):
    for k, expected in enumerate(layers):
        found = ran[f"layer{k}"]
        np.testing.assert_array_equal(found.current[0], expected["u"])
        np.testing.assert_array_equal(found.membrane[0], expected["v"])
        np.testing.assert_array_equal(found.spikes[0], expected["s"])


@pytest.mark.parametrize("path", TRACES, ids=lambda path: path.stem)
def test_the_interpreter_equals_lava(path):
    program, raster, layers = golden(path)
    check(layers, trace(program, raster))


@pytest.mark.parametrize("path", TRACES, ids=lambda path: path.stem)
def test_the_machine_equals_lava(path):
    program, raster, layers = golden(path)
    machine = Machine(program, trace=True)
    machine.infer(raster)
    check(layers, machine.recordings)


@pytest.mark.parametrize("path", TRACES, ids=lambda path: path.stem)
def test_streaming_equals_lava(path):
    program, raster, layers = golden(path)
    machine = Machine(program)
    for t in range(raster.shape[1]):
        machine.step(raster[:, t])
        for k, expected in enumerate(layers):
            np.testing.assert_array_equal(machine.current[f"layer{k}"][0], expected["u"][t])
            np.testing.assert_array_equal(machine.membrane[f"layer{k}"][0], expected["v"][t])
