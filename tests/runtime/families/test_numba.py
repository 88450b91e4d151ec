"""The compiled machine equals the interpreter and the NumPy kernels in everything, and is lean."""

import subprocess
import sys
from dataclasses import fields, replace
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.backend import backend_class
from spikedeploy.runtime.emulator.interpreter import Interpreter
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families import numba_frame as shared
from spikedeploy.runtime.families import numba_pipeline as pipeline
from spikedeploy.runtime.families.cuba import numba_steps as kernels
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.numpy_backend import NumpyPipeline
from tests.equality import check_equal, runs
from tests.networks import popsan
from tests.paths import ROOT
from tests.programs import layer, random_programs, rasters
from tests.runtime.families.test_backends import known

compiled = pytest.mark.skipif(
    find_spec("numba") is None, reason="numba is not installed (pip install '.[fast]')"
)


@pytest.mark.parametrize("name", [pytest.param("numba", marks=compiled), "interpreter"])
@settings(max_examples=10)
@given(random_programs().map(known), runs, st.booleans())
def test_without_a_trace_it_equals_the_numpy_kernels_in_all_that_is_left(
    name, program, run, streaming
):
    batch, *_ = run
    ours, numpy = machines = [Machine(program, batch, backend=each) for each in (name, "numpy")]
    for raster in rasters(program, *run, inferences=2):
        for step in range(raster.shape[1] if streaming else 1):
            if streaming:
                outputs = [machine.step(raster[:, step]) for machine in machines]
            else:
                outputs = [machine.infer(raster) for machine in machines]
            np.testing.assert_array_equal(*outputs)
            for found, expected in ((ours.current, numpy.current), (ours.membrane, numpy.membrane)):
                assert found.keys() == expected.keys()
                for name, values in found.items():
                    assert values.dtype == expected[name].dtype
                    np.testing.assert_array_equal(values, expected[name])
        check_ledgers(ours, numpy)
        for machine in machines if streaming else ():
            machine.reset()
            assert not any(values.any() for values in machine.membrane.values())


def check_ledgers(ours, numpy):
    found, expected = ours.ledger, numpy.ledger
    np.testing.assert_array_equal(found.counts, expected.counts)
    assert (found.inferences, found.timesteps, found.steps) == (
        expected.inferences, expected.timesteps, expected.steps,
    )  # fmt: skip


@compiled
def test_states_that_are_kept_go_on_in_windows_of_another_length_where_numpy_does_too():
    artifact = popsan()
    kept = replace(artifact, convention=replace(artifact.convention, state="kept"))
    forward = compile_program(kept, chip("loihi1"))
    machine = Machine(forward, backend="numba")
    machine.infer(np.zeros((1, 5, 30), np.uint8))
    with pytest.raises(ConfigError, match="Call reset"):
        machine.infer(np.zeros((1, 4, 30), np.uint8))
    # a loop: rows run one after another, however many
    last = forward.layers[-1]
    wire = replace(last.synapses[0], source=last.name, delay=1, weight=np.ones((20, 20), np.int16))
    looped = replace(last, synapses=(*last.synapses, wire))
    program = replace(forward, layers=(*forward.layers[:-1], looped))
    ours, numpy = (Machine(program, 2, backend=name) for name in ("numba", "numpy"))
    for timesteps in (5, 3, 8):
        raster = rasters(program, 2, timesteps, 0.4, seed=timesteps)[0]
        np.testing.assert_array_equal(ours.infer(raster), numpy.infer(raster))
    for name, membrane in numpy.membrane.items():
        np.testing.assert_array_equal(ours.membrane[name], membrane)
    check_ledgers(ours, numpy)


@compiled
def test_weights_and_sums_of_any_width_are_exact():
    narrow = compile_program(popsan(hidden=(40, 12)), chip("loihi1"), clock="gated")
    raster = rasters(narrow, 2, 5, 0.5, seed=3)[0]
    none = Register(62, "none")
    datasheet = chip("loihi1", accumulator=none, current=none, membrane=none)
    for factor in (1, 1 << 7, 1 << 30):  # sums of 16, 32 and 64 bits, weights of 16 and 64
        layers = [
            replace(
                one,
                synapses=tuple(
                    replace(s, weight=s.weight.astype(np.int64) * factor) for s in one.synapses
                ),
                bias=one.bias.astype(np.int64) * factor,
                threshold=one.threshold * factor,
            )
            for one in narrow.layers
        ]
        program = replace(narrow, chip=datasheet, layers=tuple(layers))
        machine = Machine(program, 2, trace=True, backend="numba")
        machine.infer(raster)
        check_equal(machine.recordings, Interpreter(program, 2).run(raster))


@compiled
def test_a_state_that_float64_cannot_decay_exactly_is_decayed_in_whole_numbers():
    # 49 bits times 12 are too many, though the next drive makes the sum small again
    none = Register(62, "none")
    datasheet = chip("loihi1", accumulator=none, current=none, membrane=none)
    rng = np.random.default_rng(0)
    large = (1 << 43) + rng.integers(0, 1 << 42, 300)
    weight = np.stack([large, -large])
    neurons = layer(
        datasheet.arithmetic, "n", weight.T, (Synapses("input", weight, delay=1),),
        decays=(0, 4096), threshold=1 << 60, start=1,
    )  # fmt: skip
    program = Program(datasheet, Convention(1e-3), "input", 2, (neurons,), "n", None)
    machine = Machine(program, trace=True, backend="numba")
    raster = np.array([[[1, 0], [0, 1], [0, 0]]], np.uint8)
    machine.infer(raster)
    check_equal(machine.recordings, Interpreter(program, 1).run(raster))


@compiled
def test_machine_code_is_kept_on_disk_under_a_name_that_tells_all_its_sources():
    # an index that an older version left may name classes that are gone, and is never opened
    folders = Path(shared.__file__).parent, Path(kernels.__file__).parent
    sources = [path for folder in folders for path in sorted(folder.glob("numba_*.py"))]
    digest = sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    run = kernels.CubaPipeline.kernel
    assert run.__qualname__ == f"run_numba_steps_{digest[:12]}"
    assert type(run._cache).__name__ == "FunctionCache"
    assert digest[:12] in run._cache._cache_file._index_name


def test_the_kernels_count_in_the_order_of_the_ledger():
    short = {"neuron_update": "UPDATE", "neuron_idle": "IDLE"}
    names = [short.get(name, name.upper()) for name in EVENTS]
    assert [getattr(shared, name) for name in names] == list(range(len(EVENTS)))


def test_the_kernels_know_every_field_of_the_arithmetic():
    # a new field changes what a chip computes: teach the kernels, or let NumbaPipeline refuse it
    at_compile_time = {
        "weight_bits", "weight_bits_allowed", "sign_mode", "step_rounding", "threshold_max",
        "bias_mantissa_max", "bias_exponent_max", "current_decay_offset", "membrane_decay_offset",
        "exponents", "decay_max", "input_acts",
    }  # fmt: skip
    in_the_kernels = {
        "mantissa_shift", "decay_bits", "accumulator", "current", "membrane", "refractory",
    }  # fmt: skip
    refused = {"push"}  # unless it lets everything through
    assert {f.name for f in fields(CubaFixedPoint)} == at_compile_time | in_the_kernels | refused
    assert {f.name for f in fields(Register)} == {"bits", "overflow", "between"}


@pytest.mark.parametrize(
    "register",
    [
        {"push": Register(24, "wrap")},
        {"membrane": Register(24, "wrap", (0, 1000))},
    ],
)
def test_registers_that_the_kernels_do_not_know_are_refused_and_auto_takes_numpy(register):
    program = compile_program(popsan(), chip("loihi1"))
    odd = replace(
        program, chip=replace(program.chip, arithmetic=replace(program.chip.arithmetic, **register))
    )
    with pytest.raises(ConfigError, match=r"'loihi1' has a register that the compiled kernels"):
        Machine(odd, backend="numba")
    assert backend_class(odd, "auto") is NumpyPipeline


@pytest.mark.parametrize(
    ("name", "installed", "message"),
    [
        ("loihi1", None, r"Numba is not installed.*pip install"),
        ("ideal", object(), r"chip 'ideal' computes with CubaFloat64, which is supported by"),
    ],
)
def test_what_cannot_be_compiled_is_refused_and_auto_takes_numpy(
    name, installed, message, monkeypatch
):
    monkeypatch.setattr(pipeline, "find_spec", lambda package: installed)
    program = compile_program(popsan(), chip(name))
    with pytest.raises(ConfigError, match=message):
        Machine(program, backend="numba")
    raster = rasters(program, 1, 5, 0.3, seed=0)[0]
    np.testing.assert_array_equal(
        Machine(program, backend="auto").infer(raster), Machine(program).infer(raster)
    )


def test_an_unknown_backend_is_refused():
    with pytest.raises(ConfigError, match="backend 'cuda' is unknown"):
        Machine(compile_program(popsan(), chip("loihi1")), backend="cuda")


def test_numba_is_not_loaded_for_another_backend():
    code = """
import sys
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.machine import Machine
from tests.networks import popsan
Machine(compile_program(popsan(), chip("loihi1")))
Machine(compile_program(popsan(), chip("ideal")), backend="auto")
assert "numba" not in sys.modules
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
