"""Teachers as somebody else would write them, for the environments of tests/own_env.py."""

import sys

import numpy as np

NUMBER = 3


def reach(observation):
    """The best action of Reach, in its own shape and units."""
    assert observation.shape == (2, 2)
    assert observation.dtype == np.float32
    left, right = observation[0, 0], observation[1, 0] + 3.0
    return np.array([[-0.3 + 0.4 * left], [5.0 + 4.0 * right]])


def reach_scaled(observation):
    """The same in [-1, 1]."""
    return [2.0 * observation[0, 0] - 1.0, 2.0 * (observation[1, 0] + 3.0) - 1.0]


def reach_all(observations):
    """The same for a batch (B, 2, 2)."""
    return np.stack([reach(each) for each in observations])


reach_all.vectorised = True


def level(observation):
    """The right choice of Levels, counted as it does."""
    assert isinstance(observation, int)
    return observation - 6


def level_logits(observation):
    """A number for each choice of Levels."""
    return np.eye(4)[observation - 5]


def too_many(observation):
    """More than any environment takes."""
    return np.zeros(7)


def no_choice(observation):
    """A choice that Levels does not have."""
    return 3


def between(observation):
    """Between two choices."""
    return 0.5


def nothing(observation):
    """Forgot to return."""


def empty(observation):
    """A list without numbers."""
    return []


def lost(observation):
    """No number."""
    return [np.nan, 0.0]


def masked(observation):
    """A teacher that masks an action."""
    return np.ma.array(np.zeros((2, 1)), mask=[[True], [False]])


def leaves(observation):
    """A teacher that ends the process."""
    sys.exit()


def remembers(observation):
    """A teacher that keeps something of an episode."""
    return np.zeros((2, 1))


remembers.reset = lambda: None
