"""Teacher: a policy to imitate, whatever it was read from."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

FloatArray = NDArray[np.float64]
_CERTAIN = 20.0  # logit of a choice whose alternatives have 0: its softmax is 1 within 1e-8


@dataclass(frozen=True)
class Teacher:
    """A policy to imitate; also a controller of one robot.

    act_all: actions (B, act) in [-1, 1] for observations (B, obs), or logits of discrete ones
    observations, actions: their numbers
    env: short name or id of its environment, empty if unknown
    """

    act_all: Callable[[FloatArray], FloatArray]
    observations: int
    actions: int
    env: str = ""

    def reset(self, seed: int) -> None:
        """Do nothing: teachers have no state."""

    def act(self, observation: FloatArray) -> FloatArray:
        """Return the action (act,) for one observation (obs,)."""
        action: FloatArray = self.act_all(observation[None])[0]
        return action


def certain(choice: NDArray[np.int64], count: int) -> FloatArray:
    """Return the logits (B, n) of a teacher that says its choices (B,) alone."""
    logits: FloatArray = _CERTAIN * np.eye(count)[choice]
    return logits


def surprise(mean: Tensor, label: Tensor, sharpness: float) -> Tensor:
    """Return the cross entropy (...) of a student's logits (..., n) with its teacher's.

    sharpness: factor of the teacher's logits
    """
    # H = -sum_k softmax(sharpness label)_k log softmax(mean)_k
    target = torch.softmax(sharpness * label, -1)
    return -(target * functional.log_softmax(mean, -1)).sum(-1)
