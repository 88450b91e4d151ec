"""Generated graphs that end in readouts: convolutions, loops, delays, skips, two Outputs.

Weights and decays are small fractions of powers of 2, so that every sum is exact in any order.
"""

import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.emulator.network import FloatMachine
from spikedeploy.runtime.errors import RuleError
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph.ports import split
from tests.runtime.float_model.test_wired_graphs import eighths, networks

TIMESTEPS = 8


def readout(kind, shape):
    """Decays 1/2 and 3/4, a leak of 1/8 a timestep, and gain 1."""
    full = {v: np.full(shape, v) for v in (0.5, 2.0, 2e-3, 4e-3, 4.0, 1000.0)}
    if kind == "I":
        return nir.I(full[1000.0])
    if kind == "LI":
        return nir.LI(full[4e-3], full[4.0], full[0.5])
    return nir.CubaLI(full[2e-3], full[4e-3], full[4.0], full[0.5], w_in=full[2.0])


@st.composite
def ended(draw):
    """A generated network whose Outputs receive readouts, directly or over an Affine."""
    network = draw(networks())
    nodes, edges = dict(network.nodes), set(network.edges)
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    for end in ("output", "more"):
        kind = draw(
            st.sampled_from(["LI", "CubaLI", "I", "none"] if end == "more" else ["LI", "I"])
        )
        if end not in nodes or kind == "none":
            continue
        (before,) = [source for source, target in edges if target == end]
        shape = tuple(int(n) for n in nodes[end].output_type["output"])
        name = f"read {end}"
        nodes[name] = readout(kind, shape)
        edges = edges - {(before, end)} | {(before, name)}
        of_shape = tuple(int(n) for n in nodes["in"].output_type["output"])
        if of_shape == shape and draw(st.booleans()):
            edges.add(("in", name))
        if len(shape) == 1 and draw(st.booleans()):
            nodes[f"map {end}"] = nir.Affine(eighths(rng, (shape[0],) * 2), eighths(rng, shape))
            edges |= {(name, f"map {end}"), (f"map {end}", end)}
        else:
            edges.add((name, end))
    return nir.NIRGraph(nodes, draw(st.permutations(sorted(edges))), type_check=False)


def compiled(artifact, on, **options):
    """The program, or None where something but readouts is refused."""
    try:
        return compile_program(artifact, on, **options)
    except RuleError as error:
        said = ("begin late", "it receives several layers", "becomes 0", "without neurons between")
        assert any(each in str(error) for each in said)  # noqa: PT017
        return None


@settings(max_examples=150, deadline=None)
@given(ended(), st.integers(0, 1000), st.sampled_from([0, 1]), st.booleans(), st.booleans())
def test_generated_readouts_equal_the_float_graph_on_chip_and_host(
    network, seed, delay, kept, on_host
):
    convention = Convention(1e-3, delay=delay, state="kept" if kept else "reset")
    artifact = Artifact(network, None, convention)
    on = chip("ideal", membrane_output="none" if on_host else "software")
    if (program := compiled(artifact, on)) is None:
        return
    assert bool(program.host) == on_host
    twin, rng = FloatGraph(artifact), np.random.default_rng(seed)
    machines = [Machine(program, 2, backend=name) for name in ("numpy", "interpreter")]
    for _ in range(2):
        raster = (rng.random((2, TIMESTEPS, program.width)) < 0.4).astype(np.uint8)
        expected = twin.run(split(program.inputs, raster))
        for machine in machines:
            for name, found in split(program.outputs, machine.infer(raster)).items():
                wanted = expected["output" if len(program.outputs) == 1 else name]
                np.testing.assert_array_equal(found, wanted)


@settings(max_examples=60, deadline=None)
@given(ended(), st.integers(0, 1000), st.sampled_from(["loihi1", "loihi1-nengo"]))
def test_generated_readouts_on_loihi_equal_the_interpreter(network, seed, name):
    artifact = Artifact(network, None, Convention(1e-3))
    program = compiled(artifact, chip(name), clock="pipelined", limits=False)
    if program is None:
        return
    raster = np.random.default_rng(seed).random((2, TIMESTEPS, program.width)) < 0.4
    raster = raster.astype(np.uint8)
    expected = trace(program, raster)
    slow = Machine(program, 2, backend="interpreter")
    output = slow.infer(raster)
    for backend in ("numpy", "auto"):
        machine = Machine(program, 2, trace=True, backend=backend)
        np.testing.assert_array_equal(machine.infer(raster), output)
        for layer, found in machine.recordings.items():
            np.testing.assert_array_equal(found.membrane, expected[layer].membrane)
            np.testing.assert_array_equal(found.spikes, expected[layer].spikes)
        np.testing.assert_array_equal(machine.ledger.counts, slow.ledger.counts)


@pytest.mark.parametrize("kind", ["LI", "CubaLI", "I"])
def test_a_readout_of_several_dimensions_keeps_the_shape_of_its_output(kind):
    shape = (1, 4, 4)
    kernel = nir.Conv2d((4, 4), np.ones((1, 1, 3, 3)), 1, 1, 1, 1, np.zeros(1))
    nodes = {"input": nir.Input(np.array(shape)), "k": kernel, "r": readout(kind, shape)}
    nodes["output"] = nir.Output(np.array(shape))
    network = nir.NIRGraph(nodes, [("input", "k"), ("k", "r"), ("r", "output")], type_check=False)
    artifact = Artifact(network, None, Convention(1e-3))
    raster = np.random.default_rng(0).random((2, 5, 16)) < 0.3
    program = compile_program(artifact, chip("ideal"))
    found = Machine(program, 2).infer(raster.astype(np.uint8))
    wanted = FloatMachine(artifact).infer({"input": raster.reshape(2, 5, *shape).astype(np.uint8)})
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
