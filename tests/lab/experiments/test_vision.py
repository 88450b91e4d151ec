"""What policies that see by events do is counted as loops over their weights count it."""

import math

import numpy as np
import pytest
import torch

from lab.experiments.vision import (
    CountedChipController,
    CountedFloatController,
    Execution,
    drive,
    touched,
)
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.policies import FloatVisionPolicy, SpikingVisionPolicy

SHAPE = (2, 6, 8)
KARTS, STEPS = 3, 7


def float_policy(**changes):
    torch.manual_seed(0)
    settings = {"channels": [3], "kernels": [3], "strides": [2], "hidden": [5], "gru": 4}
    policy = FloatVisionPolicy(math.prod(SHAPE), 7, SHAPE, **{**settings, **changes})
    for bias in policy.biases.values():
        torch.nn.init.normal_(bias, std=0.2)
    return policy.requires_grad_(False)


def spiking_policy(neuron="lif"):
    torch.manual_seed(1)
    policy = SpikingVisionPolicy(
        math.prod(SHAPE), 7, SHAPE, 2 if neuron == "lif" else 1, [2], [3], [2], 6,
        0, neuron == "lif", neuron == "lif", neuron, "pipelined" if neuron == "lif" else "gated",
    ).requires_grad_(False)  # fmt: skip
    for matrix in policy.synapses.values():
        matrix.weight *= 2
    return policy


def recording(mean=0.15, steps=STEPS):
    """Counts (S, B, obs)."""
    counts = np.random.default_rng(0).poisson(mean, (steps, KARTS, math.prod(SHAPE)))
    return counts.astype(np.uint8)


def rounded(matrix):
    """Weights of 8 bits, one scale a matrix."""
    weight = matrix().numpy()
    scale = np.float32(np.abs(weight).max()) / np.float32(127)
    return np.round(weight / scale) * scale


def dense(policy, name):
    """The matrix (N, M) of the synapses, of a convolution by a loop over its windows."""
    matrix = policy.matrix(name)
    weight = rounded(matrix)
    if weight.ndim == 2:
        return weight
    (channels, rows, columns), (features, y, x) = matrix.source, matrix.target
    found = np.zeros((features, y, x, channels, rows, columns), np.float32)
    for o, oy, ox, c, ky, kx in np.ndindex(*found.shape[:3], channels, *weight.shape[2:]):
        iy, ix = (at * matrix.stride + k - matrix.padding for at, k in ((oy, ky), (ox, kx)))
        if 0 <= iy < rows and 0 <= ix < columns:
            found[o, oy, ox, c, iy, ix] = weight[o, c, ky, kx]
    return found.reshape(features * y * x, -1)


class PlainNetwork:
    """The float network of one kart, weight by weight."""

    def __init__(self, policy, delta=None):
        self.weights = {name: dense(policy, name) for name in policy.synapses}
        self.biases = {
            name: np.repeat(policy.biases[name].numpy(), len(w) // len(policy.biases[name]))
            for name, w in self.weights.items()
        }
        self.delta, self.sent = delta, {n: np.zeros(w.shape[1]) for n, w in self.weights.items()}
        self.h, self.macs, self.changed, self.compared = np.zeros(policy.gru), 0, 0, 0

    def through(self, name, x):
        is_sent = x != 0
        is_changed = x != self.sent[name]
        if self.delta is not None and name != "conv1":
            is_changed = is_sent = np.abs(x - self.sent[name]) > self.delta
            x = self.sent[name] = np.where(is_sent, x, self.sent[name])
        if name == "conv1":
            self.changed += np.count_nonzero(self.weights[name][:, is_changed])
            self.sent[name] = x
        if self.delta is not None:
            self.compared += np.count_nonzero(self.weights[name][:, is_changed].any(1))
        for weight in self.weights[name]:
            for w, sent in zip(weight, is_sent, strict=True):
                self.macs += int(w != 0 and sent)
        return self.weights[name] @ x + self.biases[name]

    def act(self, counts):
        x = np.minimum(counts.astype(float), 4.0)
        for name in ("conv1", "fc1"):
            x = np.maximum(self.through(name, x), 0)
        a, b = (np.split(self.through(n, v), 3) for n, v in (("gru", x), ("back", self.h)))
        r, z = (1 / (1 + np.exp(-a[k] - b[k])) for k in (0, 1))
        self.h = z * self.h + (1 - z) * np.tanh(a[2] + r * b[2])
        return self.through("out", self.h).argmax()


@pytest.mark.parametrize("delta", [None, 0.0, 0.2])
@pytest.mark.parametrize("is_pruned", [False, True])
def test_a_float_network_counts_each_weight_that_meets_what_is_sent(delta, is_pruned):
    policy = float_policy()
    if is_pruned:
        for name in policy.synapses:
            policy.matrix(name).mask.bernoulli_(0.5)
    controller = CountedFloatController(policy, KARTS, Execution(delta=delta))
    plain = [PlainNetwork(policy, delta) for _ in range(KARTS)]
    for counts in recording():
        expected = [each.act(seen) for each, seen in zip(plain, counts, strict=True)]
        assert controller.act(counts).tolist() == expected
    # what is exactly as before in float32 may differ in the last places in float64
    rel = 0.01 if delta == 0 else 0
    for name, found in (("macs", "macs"), ("changed_macs", "changed"), ("compared", "compared")):
        expected = [getattr(each, found) for each in plain]
        assert controller.totals[name].tolist() == pytest.approx(expected, rel=rel)
    for name in ("dense_macs", "first_dense_macs"):  # of the one convolution that there is
        assert controller.totals[name].tolist() == [STEPS * 3 * 3 * 4 * 18] * KARTS
    weights = {n: np.count_nonzero(rounded(w)) for n, w in policy.synapses.items()}
    behind = [n for n in weights if n != "conv1"]
    for name, some in (("behind_weights", behind), ("memory_weights", ["back", "out"])):
        assert controller.totals[name].tolist() == [STEPS * sum(weights[n] for n in some)] * KARTS


def test_a_network_that_skips_nothing_else_is_the_policy():
    policy = float_policy()
    for name in policy.synapses:  # weights that 8 bits hold
        policy.matrix(name).weight.copy_(torch.from_numpy(rounded(policy.matrix(name))))
    controller, state = CountedFloatController(policy, KARTS, Execution()), policy.rest(KARTS)
    for counts in recording():
        mean, _ = policy.advance(torch.from_numpy(counts).float(), state)
        assert controller.act(counts).tolist() == mean.argmax(1).tolist()
        np.testing.assert_allclose(controller._memory, state[1], atol=1e-6)


def test_a_delta_network_with_a_threshold_of_0_is_the_network():
    policy = float_policy()
    exact, delta = (
        CountedFloatController(policy, KARTS, Execution(delta=each)) for each in (None, 0.0)
    )
    for counts in recording():
        assert exact.act(counts).tolist() == delta.act(counts).tolist()
        assert torch.equal(exact._memory, delta._memory)


def test_a_triggered_network_runs_where_enough_events_came_and_sees_all_of_them():
    policy, seen = float_policy(), recording(0.03, 30)
    controller = CountedFloatController(policy, KARTS, Execution(trigger=4))
    since, runs = np.zeros(seen.shape[1:], np.int64), np.zeros(KARTS)
    frames, before, waits = [], controller.act(np.zeros_like(seen[0])), np.zeros(KARTS)
    for counts in seen:
        actions = controller.act(counts)
        since += counts
        ran = since.sum(1) >= 4
        assert (actions[~ran] == before[~ran]).all()
        frames += [since[0].copy()] * int(ran[0])
        since[ran], before = 0, actions
        waits += since.sum(1)
        runs += ran
    assert controller.totals["runs"].tolist() == runs.tolist()
    assert controller.totals["waits"].tolist() == waits.tolist()
    assert 0 < runs.sum() < KARTS * len(seen)
    # what the first kart saw, as counts in every control step
    other = CountedFloatController(policy, 1, Execution())
    for frame in frames:
        last = other.act(frame[None].astype(np.uint8))
    assert last == before[:1]


def test_at_a_higher_rate_a_float_network_sees_the_events_of_as_long_as_in_training():
    policy, seen = float_policy(gru=0), recording(0.1, 12)
    fast, slow = (
        CountedFloatController(policy, KARTS, Execution(), 4),
        CountedFloatController(policy, KARTS, Execution()),
    )
    for number, counts in enumerate(seen, start=1):
        actions = fast.act(counts)
        if number % 4 == 0:
            window = seen[number - 4 : number].sum(0).astype(np.uint8)
            assert actions.tolist() == slow.act(window).tolist()


@pytest.mark.parametrize(
    ("place", "neuron"),
    [("loihi1", "lif"), ("int", "lif"), ("speck2f", "if"), ("speck2f:queue=on", "if")],
)
def test_a_chip_touches_the_neurons_that_a_loop_finds_and_counts_the_operations(place, neuron):
    controller = CountedChipController(spiking_policy(neuron), KARTS, place)
    program = controller.program
    found, sops = np.zeros(KARTS), np.zeros(KARTS)
    for counts in recording(0.3):
        controller.act(counts)
        rows = {n: r.spikes[:, 0] for n, r in controller._controller.network.recordings.items()}
        rows[program.input] = controller._controller.encoded[:, 0]
        for layer in program.layers:
            reached = np.zeros((KARTS, layer.size), bool)
            for s in layer.synapses:
                weight = s.weight if s.window is None else s.window.dense(s.weight)
                for kart, axon in np.argwhere(rows[s.source]):
                    reached[kart] |= weight[axon] != 0
                    sops[kart] += rows[s.source][kart, axon] * np.count_nonzero(weight[axon])
            found += reached.sum(1)
    assert controller.totals["touched"].tolist() == found.tolist()
    assert found.sum() > 0
    # of the last control step some are still under way, where layers hand on late
    late = place in ("loihi1", "int")
    assert (controller.totals["sop"] <= sops).all()
    assert late or controller.totals["sop"].tolist() == sops.tolist()


def test_at_a_higher_rate_biases_and_lasting_currents_make_as_many_spikes_a_second():
    torch.manual_seed(2)
    policy = SpikingVisionPolicy(
        math.prod(SHAPE), 7, SHAPE, 1, [2], [3], [2], 6, 3, False, False
    ).requires_grad_(False)
    policy.biases["conv1"] += 0.7
    policy.matrix("hidden").weight.abs_().mul_(0.1)  # seldom, so that none is lost in a reset
    sent = []
    for slower in (1, 4):
        controller = CountedChipController(policy, 1, "ideal", slower)
        for _ in range(400 * slower):
            controller.act(np.zeros((1, math.prod(SHAPE)), np.uint8))
        sent.append(controller.totals["spike_out"][0])
    assert sent[0] > 1000
    assert sent[1] == pytest.approx(sent[0], rel=0.3)


def test_touched_neurons_are_counted_once_a_layer():
    ones = np.ones((2, 3))
    reach = [[("a", None, ones), ("b", None, ones)], [("a", None, ones * [1, 0, 0])]]
    spikes = {"a": np.array([[1, 1], [0, 0]]), "b": np.array([[1, 0], [0, 2]])}
    assert touched(reach, spikes).tolist() == [4, 3]


def test_counts_of_an_episode_end_with_it():
    policy = FloatVisionPolicy(1024, 7, channels=[2], kernels=[3], strides=[2], hidden=[3], gru=3)
    row, ends = drive(
        {"forks": 1}, CountedFloatController(policy.requires_grad_(False), 3, Execution()), 3, 40
    )
    assert len(ends) == 3
    assert row["runs"] == 1
    assert row["gates"] == 3
    assert row["steps"] <= 3 * 40


@pytest.mark.parametrize(("gated", "gate"), [(1, 3), (4, 12)])
def test_a_gate_adds_up_the_events_of_a_sixtieth_of_a_second_at_any_rate_of_training(gated, gate):
    seen = recording(0.03, 12)
    controller = CountedFloatController(float_policy(), KARTS, Execution(gate=gate), 1, gated)
    opened, expected = [], []
    controller._run = lambda x, rows: opened.append(rows.tolist()) or np.zeros(len(rows))
    for number, counts in enumerate(seen, start=1):
        controller.act(counts)
        brought = seen[max(number - gated, 0) : number].sum((0, 2))
        expected.append(np.flatnonzero(brought >= gate).tolist())
    assert opened == [rows for rows in expected if rows]
    assert 0 < sum(map(len, opened)) < KARTS * len(seen)


def test_a_network_that_runs_in_every_second_step_holds_its_action_and_sees_what_came_since():
    policy, seen = float_policy(), recording(0.03, 12)
    controller = CountedFloatController(policy, KARTS, Execution(every=2))
    shown = []
    controller._run = lambda x, rows: shown.append(x.numpy().copy()) or np.arange(KARTS)
    actions = [controller.act(counts) for counts in seen]
    assert len(shown) == 6
    for k, sum_of in enumerate(shown[1:], start=1):
        np.testing.assert_array_equal(sum_of, seen[2 * k - 1] + seen[2 * k])
    assert all(action.tolist() == list(range(KARTS)) for action in actions)


def test_a_triggered_network_sees_the_events_of_as_long_as_in_training_at_least():
    policy, seen = float_policy(), recording(0.03, 12)
    controller = CountedFloatController(policy, KARTS, Execution(trigger=1), 4)
    shown = []
    controller._run = lambda x, rows: shown.append(x.numpy().copy()) or np.zeros(len(rows))
    waited = np.zeros(KARTS, int)
    for number, counts in enumerate(seen, start=1):
        controller.act(counts)
        waited += 1
        rows = np.flatnonzero(counts.any(1) | (waited > 99))
        expected = [seen[max(number - max(4, waited[k]), 0) : number, k].sum(0) for k in rows]
        if len(rows):
            np.testing.assert_array_equal(shown.pop(), np.array(expected))
        waited[rows] = 0
    assert not shown


def test_leaky_traces_are_refused():
    with pytest.raises(ConfigError, match="leaky traces"):
        CountedFloatController(float_policy(traces=[0.5]), 1, Execution())
