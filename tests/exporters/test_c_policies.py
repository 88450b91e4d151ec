"""Policies in C do what the interpreter does: encoder, network, decoder, whole episodes."""

import ctypes
from dataclasses import replace

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.exporters.c.codec_values import exponents
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.codec import Codec, DeltaEncoder, Normaliser
from spikedeploy.runtime.codec.population import pattern_table
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.compile import own_clock
from spikedeploy.runtime.convention import CLOCKS, Convention
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.shipping.export_c import export_c
from tests import readouts
from tests.c_builds import (
    COMPILERS,
    LOIHI,
    SANITIZED,
    built,
    called,
    check_policy,
    library,
    needs_c,
    passed,
    run,
    written,
)
from tests.networks import event_driven, popsan, spiking_mlp, with_last

# a policy of each code, clock and kind of neuron
SHIPPED = [
    *("hexapod/sparse", "hexapod-command/sparse-gated", "hexapod/popsan", "kart-grid/snn"),
    *(f"chips/CartPole-v1/{on}" for on in ("loihi2", "odin", "speck2f", "spiker", "truenorth")),
]


def walk(codec, steps=40, seed=0):
    """Observations (S, obs) that drift, some of them beyond the clip of the normaliser."""
    rng = np.random.default_rng(seed)
    size = codec.encoder.observed
    rows = np.cumsum(0.3 * rng.normal(size=(steps, size)), axis=0)
    rows[rng.random(rows.shape) < 0.01] *= 100
    return rows * codec.normaliser.std + codec.normaliser.mean


def stepped(loaded, observation, count, kind=np.float64):
    """Result and action of one control step."""
    action = np.zeros(count, kind)
    row = np.ascontiguousarray(observation, np.float64)
    return called(loaded.policy_step, row, action), action


@needs_c
@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_policy_equals_the_interpreter(tmp_path, name):
    artifact = load(zoo.path(name))
    on = replace(chip(artifact.trained_for or "loihi1"), clocks=CLOCKS)
    check_policy(artifact, walk(artifact.codec, 12), tmp_path, on)


def with_rate(mode):
    artifact = spiking_mlp(seed=4)
    encoder = RateEncoder(np.linspace(-1, 0, 6), np.linspace(0.5, 2, 6), mode)
    normaliser = Normaliser(np.arange(6.0), np.ones(6), 3.0)
    return replace(artifact, codec=Codec(normaliser, encoder, 16, "argmax"))


def onto_readouts(kind, delay=0, **options):
    """A delta code before a network that ends in neurons without a threshold."""
    source = readouts.network(kind, **options)
    encoder = DeltaEncoder(np.full(3, 0.2), most=2)
    normaliser = Normaliser(np.array([0.0, 2.0, -1.0]), np.array([1.0, 3.0, 0.2]), 4.0)
    convention = Convention(readouts.DT, delay=delay, state=source.convention.state)
    return Artifact(source.graph, Codec(normaliser, encoder, 1 + 2 * delay), convention)


POLICIES = {
    "population": lambda: popsan(obs=3, act=2),
    "population, kept": lambda: replace(popsan(), convention=Convention(1e-3, state="kept")),
    "population, delays": lambda: replace(popsan(), convention=Convention(1e-3, delay=1)),
    "rate": lambda: with_rate("regular"),
    "random rate": lambda: with_rate("bernoulli"),
    "delta": lambda: event_driven(),
    "delta of one observation": lambda: event_driven(obs=2),
    "one-hot delta of several timesteps": lambda: event_driven(code="one-hot", timesteps=3),
    "delta onto readouts": lambda: onto_readouts("same"),
    "delta onto readouts, the last": lambda: with_last(onto_readouts("same")),
    "delta onto two readouts, the last": lambda: with_last(onto_readouts("second", delay=1)),
    "delta onto spikes, the last": lambda: with_last(event_driven(), 2),
    "delta onto two layers": lambda: onto_readouts("two layers"),
    "delta onto two readouts": lambda: onto_readouts("second"),
    "delta onto readouts, delays": lambda: onto_readouts("same", delay=1),
    "delta onto readouts, delays, reset": lambda: onto_readouts("second", delay=1, state="reset"),
    "delta without a spike": lambda: onto_readouts("only"),
}


@needs_c
@pytest.mark.parametrize("name", POLICIES)
def test_policies_of_every_code_equal_the_interpreter(tmp_path, name):
    artifact = POLICIES[name]()
    flags = SANITIZED if name in ("population, delays", "random rate", "delta") else ()
    check_policy(artifact, walk(artifact.codec), tmp_path, flags=flags)


@needs_c
@pytest.mark.parametrize("name", ["int", "int:membrane=12,weight_bits=4", "loihi1-nengo", "loihi2"])
def test_a_policy_equals_the_interpreter_on_other_chips(tmp_path, name):
    artifact = popsan()
    check_policy(artifact, walk(artifact.codec), tmp_path, chip(name))


@needs_c
def test_a_policy_with_a_scale_for_each_neuron_equals_the_interpreter(tmp_path):
    to, plain = tmp_path / "c", tmp_path / "plain"
    export_c("hexapod/popsan", to, observations=40, quantise="channel")
    for name in ("README.md", "interface.json"):
        assert "a scale for each channel" in (to / name).read_text()
    assert passed(built(to)) > 0
    export_c("hexapod/popsan", plain, observations=40)
    assert (to / "policy.c").read_text() != (plain / "policy.c").read_text()
    with pytest.raises(ConfigError, match="leave --chip and --quantise out"):
        export_c("hexapod/mlp-8", to, quantise="channel")


@needs_c
def test_every_compiler_builds_it_without_a_warning_and_a_wrong_number_fails(tmp_path):
    artifact = event_driven()
    written(artifact, tmp_path, walk(artifact.codec))
    for compiler in COMPILERS:
        for level in ("-O0", "-O2", "-Os"):
            assert passed(built(tmp_path, level, compiler=compiler)) > 0
    vectors = (tmp_path / "vectors.h").read_text()
    head, size, numbers = vectors.partition("vector_membrane[")
    first, _, rest = numbers.partition("{\n")
    number, _, rest = rest.partition(",")
    wrong = f"{head}{size}{first}{{\n    {int(number) + 1},{rest}"
    (tmp_path / "vectors.h").write_text(wrong)
    with pytest.raises(AssertionError, match="a membrane is"):
        passed(built(tmp_path))


@needs_c
def test_the_makefile_tests_and_builds_a_library_under_another_prefix(tmp_path):
    artifact = event_driven()
    written(artifact, tmp_path, walk(artifact.codec), prefix="walk")
    words = ["make", "-s", f"CC={COMPILERS[0]}", "CFLAGS=-O1", "test", "lib"]
    assert "0 differ" in run(*words, folder=tmp_path)
    assert (tmp_path / "libwalk.so").is_file()


@needs_c
def test_an_observation_that_is_not_finite_changes_nothing(tmp_path):
    artifact = event_driven()
    seen = walk(artifact.codec)
    written(artifact, tmp_path, seen)
    loaded = library(tmp_path, "policy.c", "codec.c")
    loaded.policy_reset()
    actions = [stepped(loaded, row, 2)[1] for row in seen]
    for value in (np.nan, np.inf, -np.inf):
        loaded.policy_reset()
        for row, before in zip(seen, actions, strict=True):
            bad = row.copy()
            bad[1] = value
            assert stepped(loaded, bad, 2)[0] == 1
            result, action = stepped(loaded, row, 2)
            assert result == 0
            np.testing.assert_array_equal(action, before)


@needs_c
def test_random_codes_draw_what_the_runtime_draws(tmp_path):
    artifact = with_rate("bernoulli")
    seen = walk(artifact.codec)
    written(artifact, tmp_path, seen)
    loaded = library(tmp_path, "policy.c", "codec.c")
    controller = SpikingController(artifact, LOIHI, clock=own_clock(artifact.convention))
    for seed in (0, 7, 2**40 + 3):
        controller.reset(seed)
        loaded.policy_reset()
        loaded.policy_seed(ctypes.c_uint64(seed))
        for row in seen:
            assert stepped(loaded, row, 1, np.int32)[1][0] == controller.act(row)


@needs_c
@pytest.mark.parametrize("scale", [1.0, 1e-200, 1e200])
def test_delta_codes_of_any_scale_send_the_same_events(tmp_path, scale):
    """Numbers on the very edge between two whole numbers are decided as NumPy decides them."""
    obs = 3
    encoder = DeltaEncoder(np.array([0.25, 0.1, 0.3]), most=2)
    mean, std = np.array([0.0, 1e3, -0.7]) * scale, np.array([1.0, 2.0, 0.3]) * scale
    normaliser = Normaliser(mean, std, 5.0)
    artifact = replace(event_driven(obs=obs), codec=Codec(normaliser, encoder, 1))
    artifact.graph.nodes["n1"].weight = np.random.default_rng(1).normal(size=(8, encoder.width))
    rng = np.random.default_rng(0)
    parts = rng.integers(-4000, 4000, (60, obs)) + 0.5
    parts[rng.random(parts.shape) < 0.5] -= 0.5
    seen = parts / 256 * encoder.step * normaliser.std + normaliser.mean
    seen[::7] = np.nextafter(seen[::7], np.inf)
    seen[3] = np.array([1e300, -1e300, 5e-324])
    check_policy(artifact, seen, tmp_path)


def test_exponents_are_the_last_that_do_not_exceed_a_drive():
    edges = pattern_table(0.999, 5, "<f8").edges
    found = exponents(edges)
    assert (np.exp(found) <= edges).all()
    assert (np.exp(np.nextafter(found, 0)) > edges).all()


def test_a_readout_that_the_host_integrates_is_refused(tmp_path):
    artifact = onto_readouts("same", neurons="IF", state="kept")
    with pytest.raises(ConfigError, match="rule readout"):
        written(artifact, tmp_path, walk(artifact.codec), chip("loihi1", membrane_output="none"))
