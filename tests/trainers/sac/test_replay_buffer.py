import numpy as np
import pytest

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.sac.learner import ReplayBuffer


def fill(buffer, numbers):
    for number in numbers:
        buffer.add(
            np.full((1, 3), number), np.full((1, 2), -number), np.array([10.0 * number]),
            np.array([number % 2 == 0]), np.full((1, 3), number + 0.5),
        )  # fmt: skip


def held(buffer):
    return sorted(buffer.rows[: buffer.size, 0])


def test_a_sample_keeps_transitions_together():
    buffer = ReplayBuffer(100, 3, 2)
    fill(buffer, range(1, 21))
    batch = buffer.sample(64, np.random.default_rng(0))
    number = batch.observation[:, 0]
    assert len(number.unique()) > 10
    assert (batch.action == -number[:, None]).all()
    assert (batch.reward == 10 * number).all()
    assert (batch.terminated == (number % 2 == 0)).all()
    assert (batch.following == number[:, None] + 0.5).all()


def test_the_oldest_transitions_are_overwritten_first():
    buffer = ReplayBuffer(4, 3, 2)
    fill(buffer, range(6))
    assert held(buffer) == [2, 3, 4, 5]


def test_a_batch_may_wrap_around_the_end():
    buffer = ReplayBuffer(4, 1, 1)
    column = np.arange(6.0)[:, None]
    for part in (column[:3], column[3:]):
        buffer.add(part, part, part[:, 0], part[:, 0] > 9, part)
    assert held(buffer) == [2, 3, 4, 5]


@pytest.mark.parametrize("count", [3, 4, 6, 7])
def test_what_is_saved_comes_back_in_its_places(count, tmp_path):
    buffer, copy = ReplayBuffer(4, 3, 2), ReplayBuffer(4, 3, 2)
    fill(buffer, range(count))
    path = tmp_path / "replay.safetensors"
    copy.load(path, buffer.save(path))
    for each in (9, 10):
        assert np.array_equal(copy.rows, buffer.rows)
        assert (copy.size, copy.next) == (buffer.size, buffer.next)
        fill(buffer, [each])
        fill(copy, [each])


def test_what_is_saved_comes_back_oldest_first_in_a_ring_of_another_size(tmp_path):
    buffer = ReplayBuffer(4, 3, 2)
    fill(buffer, range(6))
    path = tmp_path / "replay.safetensors"
    checksum = buffer.save(path)
    for capacity, expected in ((3, [3, 4, 5]), (6, [2, 3, 4, 5])):
        copy = ReplayBuffer(capacity, 3, 2)
        copy.load(path, checksum)
        assert held(copy) == expected
    fill(copy, [6])
    assert held(copy) == [2, 3, 4, 5, 6]


@pytest.mark.parametrize("part", [0.0, 0.5])
def test_a_replay_that_is_cut_off_is_named_with_what_can_be_saved(part, tmp_path):
    buffer, path = ReplayBuffer(4, 3, 2), tmp_path / "replay.safetensors"
    fill(buffer, range(4))
    checksum = buffer.save(path)
    path.write_bytes(path.read_bytes()[: int(part * path.stat().st_size)])
    with pytest.raises(
        ConfigError, match=r"replay\.safetensors is damaged.*its policies are whole"
    ):
        ReplayBuffer(4, 3, 2).load(path, checksum)


def test_only_the_filled_part_is_written(tmp_path):
    buffer = ReplayBuffer(10_000, 3, 2)
    fill(buffer, range(5))
    buffer.save(tmp_path / "replay.safetensors")
    assert (tmp_path / "replay.safetensors").stat().st_size < 1_000


def test_a_replay_of_another_task_is_refused(tmp_path):
    buffer = ReplayBuffer(4, 3, 2)
    fill(buffer, range(2))
    path = tmp_path / "replay.safetensors"
    checksum = buffer.save(path)
    with pytest.raises(ConfigError, match=r"\(2, 10\), and this task has 12 numbers"):
        ReplayBuffer(4, 4, 2).load(path, checksum)


def test_a_missing_replay_is_named(tmp_path):
    with pytest.raises(ConfigError, match="is missing"):
        ReplayBuffer(4, 3, 2).load(tmp_path / "replay.safetensors", "")
