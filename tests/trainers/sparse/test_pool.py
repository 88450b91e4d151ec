import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save_file

from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.sparse.pool import Walk, WalkPool, load_walks, save_walks
from tests.delta_policies import walk

DECAY = 0.9
ENCODER = DeltaEncoder(np.array([0.3, 0.5, np.inf]), most=2)


def numbered(steps, first, crashed=False):
    """A walk whose labels count from `first`."""
    label = np.arange(first, first + steps, dtype=np.float32)[:, None]
    return Walk(walk(steps, 3, seed=first).astype(np.float32), label, crashed)


@pytest.fixture
def pool():
    found = WalkPool()
    found.add([numbered(40, 0), numbered(25, 100, crashed=True), numbered(6, 200)])
    found.encode([each.observation.astype(float) for each in found.walks], ENCODER, DECAY)
    return found


def sampled(pool, count=400, window=10, burn_in=4, first=0.0, crash=0.0, crash_steps=5):
    rng = np.random.default_rng(0)
    return pool.sample(rng, count, window, burn_in, first, crash, crash_steps)


def by_steps(observation):
    """Moves and held currents (S, obs) of one walk, step by step."""
    levels, held = ENCODER.start(0), np.zeros(3)
    moves, holds = [], []
    for row in observation:
        events = ENCODER.events(row[None].astype(float), 1, levels)[0, 0]
        assert not events[2]  # its step is infinite
        moves.append(events * [0.3, 0.5, 0.0])
        held = DECAY * held + moves[-1]
        holds.append(held)
    return np.array(moves), np.array(holds)


def test_windows_hold_what_an_encoder_sends_from_the_walks_beginning(pool):
    moves, holds = (dict(enumerate(each)) for each in zip(*map(by_steps, (
        each.observation for each in pool.walks
    )), strict=True))  # fmt: skip
    found = sampled(pool)
    checked = 0
    for k in range(len(found.label)):
        label = found.label[k, 4:, 0].numpy().astype(int)
        which, start = label[0] // 100, label[0] % 100
        if which == 2 or start + 6 > len(pool.walks[which].label):
            continue
        steps = np.arange(start - 4, start + 6)
        inside = steps >= 0
        checked += 1
        np.testing.assert_array_equal(label, 100 * which + steps[4:])
        for got, want in ((found.moved, moves), (found.seen, holds)):
            np.testing.assert_allclose(
                got[k].numpy()[inside], want[which][steps[inside]], atol=1e-6
            )
            assert not got[k].numpy()[~inside].any()
    assert checked > 200


def test_a_window_that_begins_before_its_walk_starts_with_the_episode(pool):
    found = sampled(pool, first=0.3)
    first = found.label[:, 4, 0].numpy().astype(int) % 100
    assert torch.equal(found.begins, torch.from_numpy(first == 0))
    assert 0.3 < found.begins.float().mean() < 0.8
    assert not found.moved[found.begins][:, :4].any()


def test_windows_lie_before_crashes(pool):
    found = sampled(pool, crash=1.0)
    last = found.label[:, -1, 0].numpy().astype(int)
    # the walk of 25 steps: windows end in its last five steps
    assert set(last) == set(range(120, 125))


def test_without_crashes_windows_come_from_everywhere():
    pool = WalkPool()
    pool.add([numbered(30, 0)])
    pool.encode([pool.walks[0].observation.astype(float)], ENCODER, DECAY)
    assert len(set(sampled(pool, crash=1.0).label[:, -1, 0].tolist())) > 15


def test_behind_a_walks_end_its_last_label_stays(pool):
    found = sampled(pool, window=20)
    short = found.label[:, -1, 0] == 205
    assert short.any()
    assert found.label[short][:, 4:, 0].max() == 205
    assert found.begins[short].all()


def test_rates_are_means_over_the_steps_of_walks(pool):
    events = [np.count_nonzero(by_steps(each.observation)[0], axis=0) for each in pool.walks]
    assert pool.steps == 71
    # unary: as many spikes as events
    sizes = [np.abs(by_steps(each.observation)[0])[:, :2] / ENCODER.step[:2] for each in pool.walks]
    expected = np.append(sum(s.sum(0) for s in sizes) / 71, 0.0)
    np.testing.assert_allclose(pool.event_rate.numpy(), expected, rtol=1e-5)
    moves = [np.abs(np.diff(each.observation.astype(float), axis=0)).sum(0) for each in pool.walks]
    np.testing.assert_allclose(pool.mean_move, sum(moves) / 71, rtol=1e-6)
    one_hot = DeltaEncoder(ENCODER.step, 2, "one-hot")
    pool.encode([each.observation.astype(float) for each in pool.walks], one_hot, DECAY)
    np.testing.assert_allclose(pool.event_rate.numpy(), sum(events) / 71, rtol=1e-5)


def test_walks_that_are_added_wait_for_the_next_encoding(pool):
    pool.add([numbered(50, 300)])
    assert sampled(pool).label.max() < 300
    pool.encode([each.observation.astype(float) for each in pool.walks], ENCODER, DECAY)
    assert sampled(pool).label.max() >= 300
    assert len(pool) == 4


def test_states_are_drawn_with_their_labels_and_near_crashes(pool):
    rng = np.random.default_rng(0)
    observation, label = pool.states(rng, 300, 0.0, 5)
    for seen, wanted in zip(observation.numpy(), label[:, 0].numpy().astype(int), strict=True):
        np.testing.assert_array_equal(seen, pool.walks[wanted // 100].observation[wanted % 100])
    _, near = pool.states(rng, 300, 1.0, 5)
    assert set(near[:, 0].tolist()) == {120, 121, 122, 123, 124}


def test_walks_are_read_as_they_were_written(pool, tmp_path):
    path = tmp_path / "pool" / "000.safetensors"
    save_walks(pool.walks, path)
    for one, other in zip(pool.walks, load_walks(path, (3, 1)), strict=True):
        np.testing.assert_array_equal(one.observation, other.observation)
        np.testing.assert_array_equal(one.label, other.label)
        assert (one.crashed, type(other.crashed)) == (other.crashed, bool)


@pytest.mark.parametrize("damage", ["cut", "part", "short", "none"])
def test_a_damaged_file_is_refused_in_one_sentence(damage, pool, tmp_path):
    path = tmp_path / "000.safetensors"
    save_walks(pool.walks, path)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:100])
    elif damage == "none":
        path.unlink()
    else:
        arrays = load_file(path)
        if damage == "part":
            del arrays["label"]
        else:
            arrays["crashed"] = arrays["crashed"][:1]
        save_file(arrays, path)
    with pytest.raises(
        ConfigError, match=r"000\.safetensors holds no walks .* train again"
    ) as error:
        load_walks(path, (3, 1))
    assert "\n" not in str(error.value)
