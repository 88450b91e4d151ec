"""The model of the core equals the emulator in every current, membrane, spike and word."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from spikedeploy.exporters.verilog.bench import record
from spikedeploy.exporters.verilog.image import core_image
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.convention import CLOCKS, Convention
from spikedeploy.runtime.errors import ConfigError, RuleError
from tests.core_model import CoreModel
from tests.exporters.test_c_networks import delayed
from tests.programs import random_convolutions, random_neurons, random_programs
from tests.rtl_builds import EDGES, differing, edges, recorded

ZOO = Path(__file__).parents[3] / "spikedeploy" / "zoo"


def shipped(name, on="loihi1"):
    """A shipped policy, and its program where a layer is updated when it is told to."""
    artifact, datasheet = load(ZOO / f"{name}.nir"), chip(on)
    software = replace(datasheet, clocks=CLOCKS)
    return artifact, compile_program(artifact, software, clock=own_clock(artifact.convention))


@settings(
    max_examples=12,
    derandomize=True,
    suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow],
)
@given(random_programs(), st.sampled_from(["zero", "subtract"]), st.integers(1, 5))
def test_random_networks_equal_the_emulator(program, reset, timesteps):
    program = replace(program, convention=replace(program.convention, reset=reset))
    try:
        core_image(program)
    except ConfigError:  # nothing bounds its states
        assume(False)
    assert differing(*recorded(program, timesteps)) == 0


@pytest.mark.parametrize("seed", range(4))
def test_delays_loops_and_refractory_periods_equal_the_emulator(seed):
    program = replace(delayed(seed), clock="pipelined")
    assert differing(*recorded(program, timesteps=7, seed=seed)) == 0


@pytest.mark.parametrize("seed", [0, 6, 13])
def test_convolutions_equal_the_emulator_synapse_by_synapse(seed):
    rng, convention = np.random.default_rng(seed), Convention(1e-3, state="kept")
    program = random_convolutions(rng, random_neurons, chip("loihi1"), convention, loop=True)
    image, found = recorded(program, timesteps=3, seed=seed)
    assert found.spikes.any()
    assert differing(image, found) == 0


@pytest.mark.parametrize("reset", ["zero", "subtract"])
@pytest.mark.parametrize(("name", "register"), EDGES)
def test_the_edges_of_each_register_equal_the_emulator(name, register, reset):
    program, raster = edges(name, register, reset)
    image = core_image(program)
    assert differing(image, record(image, raster)) == 0


@pytest.mark.parametrize(
    ("name", "on"),
    [
        ("hexapod/sparse", "loihi1"),
        ("hexapod/sparse", "loihi1-nengo"),
        ("hexapod/sparse", "int:current=30-clip,membrane=31-wrap"),
        ("kart-steer/sparse-gated", "loihi1"),
        ("kart-grid/snn", "loihi1-brian2"),
        ("chips/Pendulum-v1/loihi2", "loihi2"),
    ],
)
def test_shipped_policies_equal_the_emulator(name, on):
    artifact, program = shipped(name, on)
    timesteps = min(artifact.codec.timesteps, 4)
    found = recorded(program, timesteps, inferences=4, rate=0.2, codec=artifact.codec)
    assert found[1].spikes.any()
    assert differing(*found) == 0


def test_the_clocks_of_a_timestep_are_its_updates_and_what_its_spikes_deliver():
    artifact, program = shipped("hexapod/sparse")
    image = core_image(program, artifact.codec)
    idle = CoreModel(image).step([]).clocks
    # 8 neurons decay twice, 18 once; then the words
    assert idle == 1 + 8 * (4 + 1 + 2 * 13) + 18 * (4 + 2 + 13 + 1)
    # one event: its token, its row, and what it adds up
    fan_out = sum(int(s.fan_out[9]) for a in program.layers for s in a.synapses[:1])
    assert CoreModel(image).step([9]).clocks == idle + 4 + fan_out


def test_rows_that_are_equal_or_negatives_are_stored_once():
    _, program = shipped("hexapod/sparse")
    image, synapses = core_image(program), 0
    for layer in program.layers:
        synapses += sum(int(each.fan_out.sum()) for each in layer.synapses)
    assert synapses == 1174
    assert len(image.rows.words) < 620
    assert image.rows.bits <= 16


def test_the_widths_are_those_that_the_numbers_need():
    image = core_image(delayed(2))
    rules = image.program.chip.arithmetic
    assert rules.current.bits == 24
    assert image.state_bits == 25  # the current reaches +2**23
    most = max(
        m.arriving // layer.unit
        for m, layer in zip(image.plan.magnitudes.values(), image.plan.layers, strict=True)
    )
    assert image.sum_bits == most.bit_length() + 1


def only(program, **fields):
    """The program with other fields of its first layer."""
    first, *others = program.layers
    return replace(program, layers=(replace(first, **fields), *others))


def shifted():
    synapses = tuple(replace(each, shift=2) for each in delayed(1).layers[0].synapses)
    return only(delayed(1), synapses=synapses)


def full():
    fields = ("bias", "voltage_bias", "threshold", "current_decay", "membrane_decay")
    synapses = (Synapses("input", np.ones((9, 32768), np.int16), 1),)
    numbers = {name: np.zeros(32768, np.int64) for name in fields}
    layer = replace(delayed(1).layers[0], synapses=synapses, **numbers)
    return replace(delayed(1), layers=(layer,), output="a")


def wide():
    on = chip("int", membrane=Register(36, "clip"), current=Register(36, "wrap"))
    *others, last = delayed(5).layers
    return replace(delayed(5), chip=on, layers=(*others, replace(last, spiking=False)))


def on(name, **options):
    return replace(delayed(1, longest=2), chip=chip(name, **options))


REFUSED = [
    *(("arithmetic", lambda name=name: on(name)) for name in ("ideal", "xylo-a2", "odin")),
    ("clock", lambda: replace(delayed(1), clock="free")),
    ("synapses", shifted),
    ("memory", full),
    ("word", wide),
    ("threshold", lambda: only(delayed(1), threshold=delayed(1).layers[0].threshold * 0 - 64)),
    ("register", lambda: on("loihi1", membrane=Register(24, "clip", (5, 9)))),
    ("axons", lambda: replace(delayed(1), width=1 << 16)),
]


@pytest.mark.parametrize(("rule", "program"), REFUSED)
def test_a_program_that_the_core_has_not_is_refused_by_its_rule(rule, program):
    with pytest.raises(RuleError, match=f"^rule {rule}: "):
        core_image(program())
