"""When inputs and spikes act on the Loihi of each emulator, on networks of several layers."""

import json
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.traces.verify import verify
from tests.paths import GOLDEN, ROOT
from tests.trace_files import recorded_trace

CHIPS = {"lava": "loihi1", "brian2loihi": "loihi1-brian2", "nengoloihi": "loihi1-nengo"}
CLOCKS = sorted(GOLDEN.glob("*_clock_*.json"))
CHAINS = sorted(GOLDEN.glob("*_chain_free.json"))
DELAYS = sorted(GOLDEN.glob("*_delays.json"))


def stem(path):
    return path.stem


@pytest.mark.parametrize("path", CLOCKS + CHAINS, ids=stem)
@pytest.mark.parametrize("layer", [0, 1])
def test_another_delay_is_found(path, layer, tmp_path):
    trace = json.loads(path.read_text())
    at_once = CHIPS[path.stem.split("_")[0]] == "loihi1-brian2" and layer == 0
    trace["layers"][layer]["delay"] = 1 if at_once else 0
    wrong = tmp_path / path.name
    wrong.write_text(json.dumps(trace))
    assert verify(wrong).difference.layer == f"layer{layer}"


@pytest.mark.parametrize("backend", ["numpy", "interpreter"])
@pytest.mark.parametrize("path", CHAINS, ids=stem)
def test_control_steps_of_the_clock_free_are_the_tools_timesteps(path, backend):
    recorded = recorded_trace(path)
    first = recorded.program.layers[0].synapses[0].delay
    layers = tuple(
        replace(layer, start=first + place) for place, layer in enumerate(recorded.program.layers)
    )
    program = replace(
        recorded.program,
        layers=layers,
        clock="free",
        convention=replace(recorded.program.convention, state="kept"),
    )
    timesteps = program.rows(1)
    assert timesteps == layers[-1].start + 1
    machine = Machine(program, trace=True, backend=backend)
    for begin in range(0, recorded.raster.shape[1], timesteps):
        machine.infer(recorded.raster[:, begin : begin + 1])
        for layer in layers:
            for quantity, expected in recorded.recorded[layer.name].items():
                found = getattr(machine.recordings[layer.name], quantity)[0]
                row = begin + layer.start
                np.testing.assert_array_equal(found, expected[row : row + 1])


def test_random_networks_on_nengo_loihis_emulator_equal_ours(tmp_path):
    if find_spec("nengo_loihi") is None:
        pytest.skip("nengo-loihi is not installed; ./spike test --peers compares with it")
    words = ["--random", "3", "--tool", "nengo_loihi", "--out", str(tmp_path)]
    command = [sys.executable, "-m", "lab", "record-traces", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    verdicts = [verify(path) for path in sorted(tmp_path.glob("*.json"))]
    assert len(verdicts) == 9
    assert [verdict.difference for verdict in verdicts] == [None] * 9
