"""A network that streams for days takes no more memory than on its first day."""

import gc
import tracemalloc
from importlib.util import find_spec

import numpy as np
import pytest

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.machine import Machine
from tests.networks import popsan
from tests.programs import rasters

STEPS = 4_000
numba = pytest.param(
    "numba", marks=pytest.mark.skipif(find_spec("numba") is None, reason="numba is not installed")
)


def allocated():
    """Bytes that Python and NumPy hold."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


@pytest.mark.parametrize("ledger", ["none", "total"])
@pytest.mark.parametrize("backend", ["numpy", numba])
def test_streaming_allocates_nothing_that_stays(backend, ledger):
    program = compile_program(popsan(obs=1, act=1, hidden=(4,), populations=2), chip("loihi1"))
    machine = Machine(program, ledger=ledger, backend=backend)
    raster = rasters(program, 1, 64, 0.3, seed=0)[0]
    rows = [np.ascontiguousarray(raster[:, t]) for t in range(64)]

    def stream(steps):
        for step in range(steps):
            machine.step(rows[step % 64])
        if ledger == "total":  # counts what waits to be counted
            assert machine.ledger.steps

    stream(640)
    tracemalloc.start()
    try:
        stream(640)
        before = allocated()
        stream(STEPS)
        grown = allocated() - before
    finally:
        tracemalloc.stop()
    assert grown < STEPS / 20, f"{grown / STEPS:.2f} bytes a step"
