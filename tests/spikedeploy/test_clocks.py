"""Our clocks equal those of a reader of its own (tests/clock_reader.py), in the closed loop."""

import numpy as np
import pytest

import spikedeploy
from spikedeploy.runtime import SpikingController, load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from tests.clock_reader import CLOCKS, ClockedPolicy, Network, Neurons
from tests.paths import ROOT

STEPS = 60
POLICIES = ("hexapod", "hexapod-command")
# free, layers are recorded in their windows: of the hidden layer the second of three timesteps
WINDOW = {"gated": slice(None), "pipelined": slice(None), "free": slice(1, None, 3)}


def shipped(env_id, name="sparse-gated"):
    return ROOT / "spikedeploy" / "zoo" / env_id / f"{name}.nir"


def walk(env_id, policy):
    """Observations (S, obs), actions (S, act) and the return of the first control steps."""
    env = spikedeploy.make(env_id)
    observation, _ = env.reset(seed=10_000)
    observations, actions, total = [], [], 0.0
    for _ in range(STEPS):
        observations.append(observation)
        actions.append(policy.act(observation))
        observation, reward, terminated, truncated, _ = env.step(actions[-1])
        total += float(reward)
        if terminated or truncated:
            break
    return np.array(observations), np.array(actions), total


def hidden_spikes(controller):
    """Spikes (T, N) of the hidden layer in its window of the last call."""
    return controller.network.recordings["lif1"].spikes[0]


class Watched:
    """A controller and the hidden spikes of each of its calls."""

    def __init__(self, controller):
        self.controller, self.spikes = controller, []

    def act(self, observation):
        action = self.controller.act(observation)
        self.spikes.append(hidden_spikes(self.controller))
        return action


def test_the_clocks_are_different_policies():
    returns = {walk("hexapod", ClockedPolicy(shipped("hexapod"), clock))[2] for clock in CLOCKS}
    assert len(returns) == len(CLOCKS)


@pytest.mark.parametrize("env_id", POLICIES)
@pytest.mark.parametrize(("name", "clock"), [("sparse-gated", "gated"), ("sparse", "pipelined")])
def test_the_float_twin_is_the_reader_in_the_clock_of_its_training(env_id, name, clock):
    mine = walk(env_id, ClockedPolicy(shipped(env_id, name), clock))
    ours = walk(env_id, SpikingController(load(shipped(env_id, name))))
    np.testing.assert_array_equal(ours[0], mine[0])
    assert ours[2] == mine[2]


@pytest.mark.parametrize("env_id", POLICIES)
@pytest.mark.parametrize("clock", CLOCKS)
def test_spikes_actions_and_returns_without_rounding_are_the_readers(env_id, clock):
    artifact, ideal = load(shipped(env_id)), chip("ideal", delay=int(clock != "gated"))
    mine = ClockedPolicy(shipped(env_id), clock)
    expected = walk(env_id, mine)
    ours = Watched(SpikingController(artifact, ideal, trace=True, clock=clock))
    found = walk(env_id, ours)
    np.testing.assert_array_equal(np.concatenate(ours.spikes), mine.spikes[WINDOW[clock]])
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-9)
    assert found[2] == pytest.approx(expected[2], rel=1e-9)
    assert np.array(mine.spikes).any()


@pytest.mark.parametrize("env_id", POLICIES)
@pytest.mark.parametrize("clock", CLOCKS)
def test_spikes_actions_and_returns_on_loihi_are_the_readers_in_integers(env_id, clock):
    artifact = load(shipped(env_id))
    program = compile_program(artifact, chip("loihi1"), clock=clock)
    mine = ClockedPolicy(shipped(env_id), clock, in_integers(program))
    expected = walk(env_id, mine)
    ours = Watched(SpikingController(artifact, chip("loihi1"), trace=True, clock=clock))
    found = walk(env_id, ours)
    np.testing.assert_array_equal(np.concatenate(ours.spikes), mine.spikes[WINDOW[clock]])
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-12)
    assert found[2] == pytest.approx(expected[2], rel=1e-12)
    assert np.array(mine.spikes).any()


def in_integers(program):
    """The compiled weights, decays, leaks and thresholds, for the reader's own arithmetic."""
    weights = {
        (synapses.source, layer.name): synapses.weight.astype(np.int64).T << 6
        for layer in program.layers
        for synapses in layer.synapses
    }
    lif, readout = (
        Neurons(*(each.astype(np.int64) for each in states))
        for states in (
            (layer.current_decay, layer.membrane_decay, layer.voltage_bias, layer.threshold)
            for layer in map(program.layer, ("lif1", "readout"))
        )
    )
    return Network(
        hidden=weights["input", "lif1"],
        skip=weights["input", "readout"],
        onward=weights["lif1", "readout"],
        lif=lif,
        readout=readout,
        action=program.readout.weight.T,
        offset=program.readout.bias,
        scale=program.layer("readout").scale,
    )
