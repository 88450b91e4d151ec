"""Draws one of several actions, the likelier the higher its score."""

import numpy as np
from numpy.typing import NDArray

from runtime.errors import ConfigError

STREAM = 2  # keeps the draws apart from those of an environment with the same seed


class Sampler:
    """Draws from the softmax of scores; the seed of the episode decides every draw.

    chooses: whether the policy chooses one of several actions, which is all that can be drawn.
    """

    def __init__(self, chooses: bool) -> None:
        if not chooses:
            raise ConfigError(
                "this policy puts out numbers, and how widely to draw around them was not "
                "exported; only one of several actions can be sampled. Leave sampling out."
            )
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Start the draws of this seed."""
        self._rng = np.random.default_rng([seed, STREAM])

    def __call__(self, scores: NDArray[np.floating]) -> NDArray[np.int64]:
        """Indices (B,) of actions drawn for the scores (B, act)."""
        # p = softmax(scores), unnormalised and summed up
        below = np.exp(scores - scores.max(axis=1, keepdims=True)).cumsum(axis=1)
        thrown = self._rng.random((len(scores), 1)) * below[:, -1:]
        return np.asarray((below[:, :-1] <= thrown).sum(axis=1))
