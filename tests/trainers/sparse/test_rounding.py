import numpy as np
import pytest
import torch

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.policies.delta import delta_artifact, live_neurons
from spikedeploy.trainers.sparse.student import check_rounding, deployed, rounding_offsets
from tests.delta_policies import delta_policy


def mantissas(policy, target):
    """Weights of the compiled program, by layer and source."""
    program = compile_program(delta_artifact(policy), chip(target), limits=False)
    return {(a.name, s.source): s.weight for a in program.layers for s in a.synapses}


@pytest.mark.parametrize("target", ["loihi1", "loihi2"])
@pytest.mark.parametrize("shape", [{}, {"hidden": 0}, {"skip": False}])
def test_offsets_make_the_weights_those_of_the_chip(target, shape):
    # all channels of a unary code weigh the same
    policy = delta_policy(code="unary", **shape)
    offsets, live = rounding_offsets(policy, chip(target)), live_neurons(policy)
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


def test_what_was_taken_out_stays_out():
    policy = delta_policy(left=0.4)
    for name, added in rounding_offsets(policy, chip("loihi1")).items():
        if name in ("into", "out", "past"):
            assert not added[getattr(policy, name).mask == 0].any()


@pytest.mark.parametrize("shape", [{}, {"hidden": 0}, {"integrated": True}])
def test_channels_of_a_deployed_policy_weigh_exact_multiples_of_one_event(shape):
    # so that three events up and one event down three times cancel
    policy = deployed(delta_policy(code="one-hot", left=1.0, **shape), chip("loihi1"), True)
    for (_, source), mantissa in mantissas(policy, "loihi1").items():
        if source == "input":
            channels = mantissa.reshape(5, 2, 3, -1)
            for k in (1, 2, 3):
                np.testing.assert_array_equal(channels[:, 0, k - 1], k * channels[:, 0, 0])
                np.testing.assert_array_equal(channels[:, 1, k - 1], -k * channels[:, 0, 0])


def test_a_deployed_policy_is_what_the_chip_holds():
    once = deployed(delta_policy(code="one-hot", left=1.0), chip("loihi1"), True)
    for name, added in rounding_offsets(once, chip("loihi1")).items():
        held = getattr(once.weights(), name)
        np.testing.assert_allclose(added, 0.0, atol=1e-6 * held.abs().max())


def test_decays_of_a_deployed_policy_are_numbers_of_the_chips_registers():
    policy = delta_policy(left=1.0)
    once = deployed(policy, chip("loihi1"), True).weights()
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
    assert deployed(policy, chip("loihi1"), True).past.mask[0, 0] == 0
    assert deployed(policy, chip("loihi1"), False) is policy


@pytest.mark.parametrize("target", ["ideal", "xylo-a3"])
def test_chips_whose_weights_cannot_be_rounded_alone_are_refused(target):
    check_rounding(chip("loihi1"))
    with pytest.raises(ConfigError, match=f"{target}.*rounding=false"):
        check_rounding(chip(target))


def test_the_policy_is_left_as_it_was():
    policy = delta_policy()
    before = {name: tensor.clone() for name, tensor in policy.state_dict().items()}
    rounding_offsets(policy, chip("loihi1"))
    for name, tensor in policy.state_dict().items():
        assert torch.equal(tensor, before[name])
        assert tensor.dtype == torch.float32
