import numpy as np
import pytest

from spikedeploy.runtime.codec.rate import Xorshift, advance, first_states, step


def marsaglia(x):
    """One step in whole numbers, cut to 32 bits as a register is."""
    x ^= x << 13 & 0xFFFFFFFF
    x ^= x >> 17
    return x ^ (x << 5 & 0xFFFFFFFF)


def test_the_first_numbers_are_those_that_are_published():
    # xorshift32 from 2463534242 (Marsaglia 2003, p. 4) begins with 723471715
    assert marsaglia(2463534242) == 723471715
    assert step(np.array([2463534242], np.uint32)).tolist() == [723471715]


def test_looking_ahead_gives_the_bits_of_going_step_by_step():
    x = np.random.default_rng(0).integers(1, 2**32, (3, 50), dtype=np.uint32)
    found = advance(x, 40)
    for t in range(40):
        x = step(x)
        np.testing.assert_array_equal(found[t], x)


def mixed(x):
    """MurmurHash3's finaliser in whole numbers, cut to 32 bits."""
    x = (x ^ x >> 16) * 0x85EBCA6B & 0xFFFFFFFF
    x = (x ^ x >> 13) * 0xC2B2AE35 & 0xFFFFFFFF
    return x ^ x >> 16


def test_a_seed_gives_these_bytes_and_always_will():
    drawn = Xorshift(10_000, 3).draw(2, 4)
    assert drawn[0].tolist() == [[127, 206, 221], [234, 225, 94], [229, 67, 107], [34, 133, 130]]
    for robot, neuron in np.ndindex(2, 3):
        begun = mixed(mixed(10_000 + 0x9E3779B9 & 0xFFFFFFFF))
        x = mixed(begun + 3 * robot + neuron & 0xFFFFFFFF)
        for t in range(4):
            x = marsaglia(x)
            assert drawn[robot, t, neuron] == x >> 24


def test_a_robot_draws_the_same_bytes_whoever_stands_beside_it():
    alone, beside = Xorshift(3, 4), Xorshift(3, 4)
    first = alone.draw(1, 6)
    np.testing.assert_array_equal(beside.draw(9, 6)[:1], first)
    np.testing.assert_array_equal(beside.draw(1, 6), alone.draw(1, 6))


def test_a_robot_that_comes_later_begins_at_its_own_beginning():
    late, early = Xorshift(3, 4), Xorshift(3, 4)
    late.draw(1, 6)
    np.testing.assert_array_equal(late.draw(3, 6)[1:], early.draw(3, 6)[1:])


@pytest.mark.parametrize("seed", [0, 1, 10_000, 2**32, 2**63])
def test_all_neurons_of_all_robots_begin_differently_and_never_at_zero(seed):
    states = first_states(seed, 28, np.arange(500))
    assert len(np.unique(states)) == states.size
    assert states.min() > 0


def test_bytes_are_even_and_know_nothing_of_their_neighbours():
    drawn = Xorshift(1, 64).draw(4, 2000).astype(float)
    counts = np.bincount(drawn.astype(int).ravel(), minlength=256)
    # chi^2 of 255 degrees of freedom: mean 255, deviation 22.6
    expected = drawn.size / 256
    assert abs(((counts - expected) ** 2 / expected).sum() - 255) < 5 * 22.6
    beside, later = drawn[:, :, 1:], drawn[:, 1:]
    limit = 5 / drawn.size**0.5
    assert abs(np.corrcoef(drawn[:, :, :-1].ravel(), beside.ravel())[0, 1]) < limit
    assert abs(np.corrcoef(drawn[:, :-1].ravel(), later.ravel())[0, 1]) < limit
