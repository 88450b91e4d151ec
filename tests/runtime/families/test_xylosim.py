"""Compiled networks against xylosim, SynSense's simulator of the chip, where it is installed.

`./spike test` installs it where there is a C++ compiler, with which it is built.
"""

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.interpreter import trace
from spikedeploy.runtime.errors import RuleError
from tests.xylo_networks import network, random_cores, random_networks

TIMESTEPS = 60

v2 = pytest.importorskip(
    "xylosim.v2", reason="xylosim is not installed: it needs a C++ compiler", exc_type=ImportError
)


class Simulated:
    """A program as one of xylosim's layers; the simulator holds bare pointers to its synapses."""

    def __init__(self, program, shift):
        outputs = {program.output} if program.output_apart else set()
        hidden = [layer for layer in program.layers if layer.name not in outputs]
        out = [layer for layer in program.layers if layer.name in outputs]
        self.first = offsets(hidden) | offsets(out)
        size = sum(layer.size for layer in hidden)
        incoming = [[] for _ in range(program.width)]
        recurrent, outgoing = ([[] for _ in range(size)] for _ in range(2))
        for layer in program.layers:
            for synapses in layer.synapses:
                rows = outgoing if layer.name in outputs else recurrent
                self._connect(
                    incoming if synapses.source == program.input else rows,
                    self.first.get(synapses.source, 0),
                    self.first[layer.name],
                    synapses.weight >> shift,
                    synapses.current,
                )
        self._kept = (incoming, recurrent, outgoing)
        self.program, self.outputs = program, outputs
        self.layer = v2.XyloLayer(
            synapses_in=incoming, synapses_rec=recurrent, synapses_out=outgoing,
            aliases=[list(row) for a in hidden for row in a.aliases or [()] * a.size],
            threshold=numbers(hidden, "threshold"), threshold_out=numbers(out, "threshold"),
            has_bias=any(layer.voltage_bias.any() for layer in program.layers),
            bias=numbers(hidden, "voltage_bias"), bias_out=numbers(out, "voltage_bias"),
            weight_shift_inp=shift, weight_shift_rec=shift, weight_shift_out=shift,
            dash_mem=numbers(hidden, "membrane_decay"), dash_mem_out=numbers(out, "membrane_decay"),
            dash_syns=[[*row, 0][:2] for a in hidden for row in a.current_decay.T.tolist()],
            dash_syns_out=[[d] for d in numbers(out, "current_decay")], name="compiled",
        )  # fmt: skip

    @staticmethod
    def _connect(rows, first, target, weight, current):
        for axon, neuron in np.argwhere(weight):
            synapse = v2.XyloSynapse(int(target + neuron), current, int(weight[axon, neuron]))
            rows[first + axon].append(synapse)

    def _read(self, name):
        if isinstance(name, str):
            return getattr(self.layer, name)
        return [getattr(self.layer, each) for each in name]

    def run(self, raster):
        """Currents (T, K, N), membrane and spikes (T, N) of each layer; T of the chip."""
        self.layer.evolve(raster.tolist())
        both = {
            "hidden": (["rec_i_syn", "rec_i_syn2"], "rec_v_mem", "rec_recurrent_spikes"),
            "output": (["rec_i_syn_out"], "rec_v_mem_out", "rec_out_spikes"),
        }
        found = {}
        for layer in self.program.layers:
            names = both["output" if layer.name in self.outputs else "hidden"]
            currents, membrane, spikes = (np.array(self._read(name)) for name in names)
            these = slice(self.first[layer.name], self.first[layer.name] + layer.size)
            currents = currents[: len(layer.current_decay), these].transpose(2, 0, 1)
            found[layer.name] = (currents, membrane[these].T, spikes[:, these])
        return found


def offsets(layers):
    ends = np.cumsum([layer.size for layer in layers])
    return {a.name: int(end) - a.size for a, end in zip(layers, ends, strict=True)}


def numbers(layers, field):
    return [int(x) for layer in layers for x in np.ravel(getattr(layer, field))]


def check_equal(program, raster, shift=0):
    """Every current, membrane and spike; how many spikes there were."""
    expected = trace(program, raster[None])
    steps = program.steps(program.rows(len(raster)))
    wait = next(s.delay for a in program.layers for s in a.synapses if s.source == program.input)
    played = np.zeros((steps + wait, program.width), np.int64)
    played[wait : wait + len(raster)] = raster
    spikes = 0
    for name, found in Simulated(program, shift).run(played[:steps]).items():
        window = slice(program.layer(name).start, program.layer(name).start + len(raster))
        current, membrane, output_spikes = (table[window] for table in found)
        np.testing.assert_array_equal(expected[name].current[0], current)
        np.testing.assert_array_equal(expected[name].membrane[0], membrane)
        np.testing.assert_array_equal(expected[name].spikes[0], output_spikes)
        spikes += int(output_spikes.sum())
    return spikes


@settings(max_examples=10)
@given(
    random_networks(),
    st.sampled_from(["layer", "channel"]),
    st.sampled_from([0, 0, 3, 8]),
    st.sampled_from([1, 3, 15]),
    st.integers(0, 2**32 - 1),
)
def test_compiled_networks_equal_xylosim_in_every_current_membrane_and_spike(
    artifact, granularity, shift, most, seed
):
    try:
        choice = Quantisation(granularity, weight_shift=shift)
        program = compile_program(artifact, chip("xylo-a2"), choice, limits=False)
    except RuleError:  # a threshold or all weights of a layer that come out as 0
        reject()
    raster = np.random.default_rng(seed).integers(0, most + 1, (TIMESTEPS, program.width))
    check_equal(program, raster.astype(np.uint8), shift)


@settings(max_examples=10)
@given(random_cores(), st.sampled_from([1, 15]), st.integers(0, 2**32 - 1))
def test_registers_of_any_content_equal_xylosim(core, most, seed):
    program, shift = core
    raster = np.random.default_rng(seed).integers(0, most + 1, (TIMESTEPS, program.width))
    check_equal(program, raster.astype(np.uint8), shift)


@pytest.mark.parametrize("granularity", ["layer", "channel"])
@pytest.mark.parametrize("biased", [False, True])
def test_a_recurrent_network_of_many_spikes_equals_xylosim(granularity, biased):
    rng = np.random.default_rng(7)
    artifact = network(rng, [16, 60, 40, 8], ["cuba"] * 3, loops={1, 2}, biased=biased)
    # 60 + 40 synapses of a spike are more than Xylo has room for; xylosim does not count them
    program = compile_program(artifact, chip("xylo-a2"), Quantisation(granularity), limits=False)
    raster = (rng.random((300, 16)) < 0.3).astype(np.uint8)
    assert check_equal(program, raster) > 3000


def test_saturating_sums_equal_xylosim():
    rng = np.random.default_rng(3)
    artifact = network(rng, [16, 30, 20, 8], ["cuba"] * 3, loops={1})
    program = compile_program(artifact, chip("xylo-a2"), Quantisation(weight_shift=7), limits=False)
    raster = rng.integers(0, 16, (100, 16)).astype(np.uint8)
    assert check_equal(program, raster, shift=7) > 1000
    assert sum(t.overflows.sum() for t in trace(program, raster[None]).values()) > 1000
