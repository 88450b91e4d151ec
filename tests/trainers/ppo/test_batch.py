import pytest
import torch

from spikedeploy.trainers.ppo import RolloutBatch, Transition, advantages, stacked

GAMMA, TRACE = 0.9, 0.5


def column(*values, kind=torch.float32):
    return torch.tensor(values, dtype=kind)[:, None]


def test_advantages_equal_a_trace_worked_out_by_hand():
    # V = 1, 2, 3 before and 2, 3, 4 after three steps that pay 1, 0, 2
    # delta = 1 + .9 * 2 - 1 = 1.8 ; 0 + .9 * 3 - 2 = .7 ; 2 + .9 * 4 - 3 = 2.6
    # A2 = 2.6 ; A1 = .7 + .45 * 2.6 = 1.87 ; A0 = 1.8 + .45 * 1.87 = 2.6415
    never = column(False, False, False, kind=torch.bool)
    found = advantages(
        column(1, 0, 2), column(1, 2, 3), column(2, 3, 4), never, never, GAMMA, TRACE
    )
    assert found.flatten().tolist() == pytest.approx([2.6415, 1.87, 2.6])


def test_a_terminal_state_ends_the_return_and_truncation_does_not():
    reward, value, following = column(0, 0), column(5, 5), column(7, 7)
    ended = column(True, False, kind=torch.bool)
    for terminated, expected in ((True, 0 - 5), (False, 0.9 * 7 - 5)):
        flags = column(terminated, False, kind=torch.bool)
        found = advantages(reward, value, following, flags, ended, GAMMA, TRACE)
        assert found[0].item() == pytest.approx(expected)


def test_advantages_do_not_depend_on_the_next_episode():
    ended, never = column(True, False, kind=torch.bool), column(False, False, kind=torch.bool)
    kinds = []
    for later in (0.0, 1000.0):
        args = column(0.0, later), column(5, 5), column(7, 7), never, ended
        kinds.append(advantages(*args, GAMMA, TRACE)[0].item())
    assert kinds[0] == kinds[1]


def test_minibatches_hold_every_step_once():
    numbers = torch.arange(70.0)
    batch = RolloutBatch(*[numbers] * 6)
    parts = list(batch.minibatches(32))
    assert [len(part) for part in parts] == [35, 35]
    assert sorted(torch.cat([part.advantage for part in parts]).tolist()) == numbers.tolist()
    assert all(torch.equal(part.advantage, part.target) for part in parts)


def test_transitions_stack_with_time_in_front():
    transition = Transition(*[torch.zeros(3, 2)] * 8)
    assert stacked([transition] * 5).observation.shape == (5, 3, 2)
