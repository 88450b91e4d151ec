import numpy as np
import pytest
import torch

from spikedeploy.runtime.artifact.artifact import load, save
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.policies import DeltaSnnPolicy, build
from spikedeploy.trainers.policies.delta_policy import (
    channel_weights,
    delta_artifact,
    delta_codec,
    live_neurons,
)
from spikedeploy.trainers.policies.policy import PrunedWeight, SynapseGroup
from spikedeploy.trainers.sparse.delta_encoder import (
    binary_columns,
    choose_steps,
)
from spikedeploy.trainers.sparse.pruning import clear_idle, operations, prune
from spikedeploy.trainers.sparse.rounding import check_rounding, round_for_chip, rounding_offsets
from spikedeploy.trainers.sparse.student import DeltaStudent, imitation, student
from spikedeploy.trainers.sparse.walks import Walk, WalkPool
from tests.delta_policies import (
    delta_policy,
    followed,
    pruned_mlp,
    walk,
    with_config,
)
from tests.trainers.sparse.toy import settings

WHOLE = {"window": 42, "burn_in": 2, "first_windows": 1.0, "batch": 3}


def walks(label=None, count=1):
    pool = WalkPool()
    for seed in range(count):
        observation = walk(40, seed=seed).astype(np.float32)
        wanted = np.tanh(observation[:, :2]) if label is None else label
        pool.add([Walk(observation, wanted.astype(np.float32))])
    return pool


@pytest.mark.parametrize("shape", [{}, {"code": "unary"}, {"hidden": 0}, {"skip": False}])
def test_a_whole_walk_is_followed_as_by_single_steps(shape):
    policy, pool = delta_policy(**shape), walks()
    mean, _, spikes = followed(policy, pool.walks[0].observation)
    pool.walks[0] = Walk(pool.walks[0].observation, np.tanh(mean).astype(np.float32))
    found = student(policy, settings(**WHOLE))
    found.prepare(pool)
    error, hidden = found.loss(pool, np.random.default_rng(0))
    assert float(error) < 1e-10  # the label is what it does
    expected = (spikes.mean(0) * policy.out.fan_out.numpy()).sum()
    assert float(hidden) == pytest.approx(expected, rel=1e-5)


def test_rounded_weights_are_what_the_loss_sees_and_gradients_pass_through():
    policy, pool = delta_policy(hidden=0), walks()
    policy.requires_grad_(True)
    found = student(policy, settings(**WHOLE))
    found.prepare(pool)
    plain, _ = found.loss(pool, np.random.default_rng(0))
    found.offsets = {"past": torch.full_like(policy.past.weight, 0.1)}
    moved, _ = found.loss(pool, np.random.default_rng(0))
    assert float(plain.detach()) != float(moved.detach())
    moved.backward()
    assert policy.past.weight.grad.abs().sum() > 0


@pytest.mark.parametrize("on", ["loihi1", "loihi2"])
def test_each_forward_pass_rounds_weights_as_the_chip_will(on):
    """Between two roundings by the chip weights move further than one step of its own."""
    policy, target = delta_policy(left=1.0), chip(on)
    found = student(policy, settings())
    found.round(target)
    with torch.no_grad():
        for matrix in policy.groups.values():
            largest = matrix.weight.abs() == matrix.weight.abs().max()  # sets the scale
            matrix.weight.add_(0.05 * torch.randn_like(matrix.weight).where(~largest, 0.0))
    offsets, quanta = rounding_offsets(policy, target)
    weights = found.weights()
    for name, quantum in quanta.items():
        held, now = getattr(weights, name), policy.groups[name]()
        torch.testing.assert_close(quantum, found.quanta[name])
        assert (held - now).abs().max() <= 0.51 * quantum.max()
        torch.testing.assert_close(held, now + offsets[name], atol=1e-5, rtol=0)
        torch.testing.assert_close(held, held.div(quantum).round() * quantum, atol=1e-5, rtol=0)
    assert torch.equal(found.acting().groups["out"](), weights.out)
    again = student(delta_policy(left=1.0), settings())
    again.load(found.tensors())
    assert again.quanta.keys() == quanta.keys()


def test_discrete_actions_are_imitated_by_their_logits():
    policy = delta_policy(head="discrete")
    label = torch.tensor([[2.0, 0.0]])
    losses = [
        float(imitation(torch.tensor([mean]), label, policy, 2.0)) for mean in ([4.0, 0], [0.0, 4])
    ]
    share = 1 / (1 + np.exp(-4.0))
    # the cross-entropy with softmax(2 x logits) is lowest where both are equal
    assert losses[0] == pytest.approx(-share * np.log(share) - (1 - share) * np.log(1 - share))
    assert losses[1] > losses[0] + 3


def test_two_values_are_found_in_all_of_a_column():
    columns = np.zeros((30_000, 6), np.float32)
    columns[::2, 0] = 1.0  # binary
    columns[::2, 1], columns[7, 1] = 1.0, 0.5  # a third value, which a sample may lack
    columns[0, 2] = 1.0  # once: an outlier
    columns[::2, 3] = 1e-3  # one value with noise
    columns[:, 4] = np.linspace(0, 1, len(columns))
    assert binary_columns(columns).tolist() == [True] + 5 * [False]


def test_operations_of_a_float_student_are_its_effective_macs():
    policy, pool = pruned_mlp(), walks(count=3)
    for each in pool.walks:  # a contact, on a third of the time
        each.observation[:, 0] = np.arange(len(each.observation)) % 3 == 0
    found = student(policy, settings(batch=100, window=12, burn_in=2))
    found.prepare(pool)
    rng = np.random.default_rng(0)
    for _ in range(300):
        found.loss(pool, rng)
    seen, _ = pool.states(rng, 5000, 0.0, 1)
    _, inputs = policy.activations(seen)
    fan_outs = [layer.fan_out for layer in policy.layers]
    macs = sum((x != 0).float().mean(0) @ f for x, f in zip(inputs, fan_outs, strict=True))
    expected = float(macs + (inputs[0] != 0).float().mean(0) @ policy.past.fan_out)
    assert operations(found.synapses()) == pytest.approx(expected, rel=0.02)
    assert expected < float(macs + policy.past.mask.sum())


def group(weight, rate):
    return SynapseGroup(PrunedWeight(torch.tensor(weight)), torch.tensor(rate))


def squares(*groups, value=1.0):
    return {each.matrix: torch.full_like(each.matrix.weight, value) for each in groups}


def test_the_cheapest_synapse_goes_first():
    # w^2 / rate: 4/2 and 1/1 onto neuron 0, 9/2 and 0.25/1 onto neuron 1; together 6 operations
    one = group([[2.0, 1.0], [3.0, 0.5]], [2.0, 1.0])
    order = []
    for target in (5.0, 4.0, 2.0):
        assert prune([one], squares(one), target) == 1
        order.append(one.matrix.mask.tolist())
    assert order == [
        [[1, 1], [1, 0]],  # worth 0.25
        [[1, 0], [1, 0]],  # 1
        [[0, 0], [1, 0]],  # 2
    ]


def test_all_kinds_of_synapses_are_ranked_together_and_by_their_curvature():
    one, other = group([[1.0, 1.0]], [1.0, 1.0]), group([[0.9]], [1.0])
    found = {one.matrix: torch.tensor([[1.0, 0.01]]), other.matrix: torch.tensor([[0.25]])}
    # sqrt(v): worth 1 and 0.1, and 0.81 x 0.5
    prune([one, other], found, 2.0)
    assert (one.matrix.mask.tolist(), other.matrix.mask.tolist()) == ([[1, 0]], [[1]])
    prune([one, other], found, 1.0)
    assert (one.matrix.mask.tolist(), other.matrix.mask.tolist()) == ([[1, 0]], [[0]])


def test_pruning_reaches_its_goal_and_takes_out_no_more():
    torch.manual_seed(0)
    groups = [group(torch.randn(20, 30).tolist(), torch.rand(30).tolist()) for _ in range(2)]
    dense = operations(groups)
    for goal in (0.5 * dense, 0.1 * dense, 1.0):
        prune(groups, squares(*groups), goal)
        assert goal - 1 <= operations(groups) <= goal
    assert prune(groups, squares(*groups), dense) == 0
    prune(groups, squares(*groups), 0.0)
    assert operations(groups) == 0
    assert prune(groups, squares(*groups), -1.0) == 0


@pytest.mark.parametrize("code", ["one-hot", "unary"])
@pytest.mark.parametrize("shape", [{}, {"hidden": 0}, {"skip": False}])
def test_operations_are_those_that_a_chip_counts(code, shape, tmp_path):
    policy = delta_policy(code=code, **shape).double()
    policy.into.mask[~live_neurons(policy)] = 0.0  # as pruning does
    observation = walk(200)
    _, events, hidden = followed(policy, observation)
    spikes = np.abs(events) if code == "unary" else events != 0
    student = DeltaStudent(policy, settings("stroll-sparse"))
    student.rates = [torch.from_numpy(each.mean(0)).float() for each in (spikes, hidden)]
    save(delta_artifact(policy), tmp_path / "policy.nir")
    artifact = load(tmp_path / "policy.nir")
    controller = SpikingController(artifact, chip("ideal"))
    for row in observation:
        controller.act(row)
    counted = controller.ledger.per_inference("sop")
    assert counted == pytest.approx(operations(student.synapses()), rel=1e-5)
    assert counted > 1


def mantissas(policy, target):
    """Weights of the compiled program, by layer and source."""
    program = compile_program(delta_artifact(policy), chip(target), limits=False)
    return {(a.name, s.source): s.weight for a in program.layers for s in a.synapses}


@pytest.mark.parametrize("target", ["loihi1", "loihi2"])
@pytest.mark.parametrize("shape", [{}, {"hidden": 0}, {"skip": False}])
def test_offsets_make_the_weights_those_of_the_chip(target, shape):
    # all channels of a unary code weigh the same
    policy = delta_policy(code="unary", **shape)
    (offsets, _), live = rounding_offsets(policy, chip(target)), live_neurons(policy)
    step = policy.step.numpy()
    rows = {
        ("lif1", "input"): ("into", lambda w: w[live] * step),
        ("readout", "lif1"): ("out", lambda w: w[:, live]),
        ("readout", "input"): ("past", lambda w: w * step),
    }
    units = {}
    for key, mantissa in mantissas(policy, target).items():
        name, as_on_chip = rows[key]
        mantissa = mantissa[:: 6 if key[1] == "input" else 1].T
        exact = as_on_chip(getattr(policy, name)().numpy())
        rounded = as_on_chip((getattr(policy, name)() + offsets[name]).numpy())
        some = mantissa != 0
        unit = units.setdefault(key[0], float(np.median(rounded[some] / mantissa[some])))
        np.testing.assert_allclose(rounded, mantissa * unit, atol=1e-5)
        grid = unit * np.gcd.reduce(mantissa.astype(int).ravel())
        assert np.abs(rounded - exact).max() <= 0.51 * grid
        assert offsets[name].any()
    assert units.keys() == ({"lif1", "readout"} if policy.hidden else {"readout"})


@pytest.mark.parametrize("shape", [{}, {"hidden": 0}, {"integrated": True}])
def test_channels_of_a_deployed_policy_weigh_exact_multiples_of_one_event(shape):
    # so that three events up and one event down three times cancel
    policy = round_for_chip(delta_policy(code="one-hot", left=1.0, **shape), chip("loihi1"))
    for (_, source), mantissa in mantissas(policy, "loihi1").items():
        if source == "input":
            channels = mantissa.reshape(5, 2, 3, -1)
            for k in (1, 2, 3):
                np.testing.assert_array_equal(channels[:, 0, k - 1], k * channels[:, 0, 0])
                np.testing.assert_array_equal(channels[:, 1, k - 1], -k * channels[:, 0, 0])


def test_unused_channels_of_two_valued_observations_do_not_set_the_scale():
    """A contact of weight 1, and an observation whose events weigh 0.1."""

    def error(**options):
        policy = DeltaSnnPolicy(2, 1, **with_config(hidden=1, most=3, **options))
        policy.step.fill_(1.0)
        with torch.no_grad():
            policy.into.weight.copy_(torch.tensor([[1.0, 0.1033]]))
        offsets, quanta = rounding_offsets(policy, chip("loihi1"))
        return policy, float(offsets["into"][0, 1].abs()), float(quanta["into"].max())

    for code in ("one-hot", "unary"):
        plain, rough, coarse = error(code=code)
        policy, fine, finer = error(code=code, two_valued=[0])
        codec = delta_codec(policy)
        seen = np.array([[0.0, 0.0], [1.0, 0.9], [0.0, -2.9], [1.0, 0.1]])
        raster = codec.encode_episode(seen).reshape(4, -1)
        both = [channel_weights(p, p.into().detach().numpy()) @ raster.T for p in (plain, policy)]
        np.testing.assert_allclose(*both)  # nothing that is sent changes
        if code == "one-hot":
            assert finer == pytest.approx(coarse / 3)
            assert fine < rough
    assert build(policy.spec()).two_valued == (0,)


@pytest.mark.parametrize("left", [1, 2])
def test_quanta_are_the_chips_however_few_weights_are_left(left):
    policy, target = delta_policy(hidden=4, left=1.0), chip("loihi1")
    _, whole = rounding_offsets(policy, target)
    largest = policy.out.weight.abs().flatten().argsort(descending=True)
    policy.out.mask.flatten()[largest[left:]] = 0.0
    _, quanta = rounding_offsets(policy, target)
    held = quanta["out"] > 0
    assert int(held.sum()) == left
    # the scale of the readout's layer may change with what is left, by no more than its largest
    assert quanta["out"][held].max() <= 1.01 * whole["out"].max()


def test_a_deployed_policy_is_what_the_chip_holds():
    once = round_for_chip(delta_policy(code="one-hot", left=1.0), chip("loihi1"))
    for name, added in rounding_offsets(once, chip("loihi1"))[0].items():
        held = getattr(once.weights(), name)
        np.testing.assert_allclose(added, 0.0, atol=1e-6 * held.abs().max())


def test_decays_of_a_deployed_policy_are_numbers_of_the_chips_registers():
    policy = delta_policy(left=1.0)
    once = round_for_chip(policy, chip("loihi1")).weights()
    for exact, held in ((policy.beta, once.beta), (policy.gamma, once.gamma)):
        registers = held.double() * 4096
        np.testing.assert_allclose(registers, registers.round(), atol=1e-2)
        assert (exact - held).abs().max() < 1 / 4096
        assert not torch.equal(exact, held)


def test_weights_that_round_to_zero_are_taken_out():
    policy = delta_policy(code="one-hot", left=1.0)
    with torch.no_grad():
        policy.past.weight[0, 0] = 1e-6
    assert policy.past.mask[0, 0] == 1
    assert round_for_chip(policy, chip("loihi1")).past.mask[0, 0] == 0
    unrounded = student(policy, settings(rounding=False))
    assert unrounded.deployed(chip("loihi1")) is policy


@pytest.mark.parametrize("target", ["ideal", "xylo-a3"])
def test_chips_whose_weights_cannot_be_rounded_alone_are_refused(target):
    check_rounding(chip("loihi1"))
    with pytest.raises(ConfigError, match=f"{target}.*rounding=false"):
        check_rounding(chip(target))


def linear(weights, moves):
    """A linear policy with these weights, and a pool whose observations move so far a step."""
    policy = delta_policy(obs=len(moves), act=1, hidden=0, left=1.0)
    policy.normalizer.mean.zero_()
    policy.normalizer.std.fill_(1.0)
    policy.past.weight.copy_(torch.tensor([weights]))
    policy.action_bias.zero_()
    policy.step.fill_(0.5)
    rng = np.random.default_rng(0)
    signs = rng.choice([-1.0, 1.0], (400, len(moves)))
    rows = np.zeros_like(signs)
    for t in range(1, len(rows)):
        rows[t] = 0.95 * rows[t - 1] + signs[t] * moves
    pool = WalkPool()
    pool.add([Walk(rows.astype(np.float32), np.zeros((400, 1), np.float32))])
    student = DeltaStudent(policy, settings())
    student.prepare(pool)
    return policy, pool


def tuned(weights, moves, binary=None, **changes):
    policy, pool = linear(weights, moves)
    which = np.zeros(len(moves), bool) if binary is None else np.array(binary)
    return choose_steps(policy, pool, which, settings(**changes))


def test_steps_are_cube_roots_of_cost_over_sensitivity():
    found = tuned([0.01, 0.08, 0.01], [0.1, 0.1, 0.8])
    # H ~ w^2: 64 times; E|dx|: 8 times as much
    np.testing.assert_allclose(found[1] / found[0], 64 ** (-1 / 3), rtol=0.05)
    np.testing.assert_allclose(found[2] / found[0], 8 ** (1 / 3), rtol=0.05)
    np.testing.assert_allclose(np.prod(found) ** (1 / 3), 0.5, rtol=1e-6)


def test_binary_and_unread_observations_keep_their_steps():
    found = tuned([0.1, 0.1, 0.0], [0.1, 0.1, 0.1], binary=[False, True, False])
    np.testing.assert_allclose(found, [0.5, 0.5, 0.5])
    found = tuned([0.1, 0.1, 0.0], [0.1, 0.1, 0.1], binary=[False, True, False], step=0.8)
    np.testing.assert_allclose(found, [0.8, 0.5, 0.5])


def test_steps_stay_within_limits():
    found = tuned([1e-6, 0.1], [1.0, 1e-3])
    assert found[0] == 4.0
    assert found[1] == 0.1


def test_observations_with_two_values_are_binary():
    seen = np.random.default_rng(0).normal(size=(50, 4))
    seen[:, 1] = seen[:, 1] > 0
    seen[:, 2] = 3.0
    seen[:, 3] = np.sign(seen[:, 3])
    assert binary_columns(seen).tolist() == [False, True, False, True]


def test_values_that_the_sample_lacks_count(monkeypatch):
    monkeypatch.setattr("spikedeploy.trainers.sparse.delta_encoder._SAMPLE", 10)
    seen = (np.arange(40.0) % 3 == 0)[:, None].astype(float)  # every fourth is looked at
    assert binary_columns(seen).tolist() == [True]
    seen[1] = 0.5
    assert binary_columns(seen).tolist() == [False]


def test_synapses_onto_a_neuron_that_nobody_reads_go():
    into, out = group([[1.0, 1.0], [0.2, 0.1]], [1.0, 1.0]), group([[1.0, 0.1]], [0.5, 0.5])
    out.matrix.mask[0, 1] = 0.0
    clear_idle(into, out)
    assert into.matrix.mask.tolist() == [[1, 1], [0, 0]]
