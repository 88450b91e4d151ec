"""Encoder: the interface of the codes that make spikes of normalised observations."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.metadata import Stored

# what an encoder carries from one inference of an episode to the next, for every robot of a batch;
# made by its `start`, read by its `encode` alone; copied by copy.deepcopy and pickle
EncoderState: TypeAlias = Any


@dataclass(frozen=True, eq=False)
class Encoder(Stored, ABC):
    """Normalised observations to spikes; a file stores its kind and its fields."""

    kind: ClassVar[str]

    @property
    @abstractmethod
    def observed(self) -> int:
        """Numbers of an observation: obs."""

    @property
    @abstractmethod
    def width(self) -> int:
        """Neurons: M."""

    @property
    def random(self) -> bool:
        """True if the spikes depend on random numbers."""
        return False

    @property
    def remembers(self) -> bool:
        """True if the spikes depend on more than the observation: those before, or a seed."""
        return self.random

    def start(self, seed: int) -> EncoderState:
        """The state at the beginning of an episode; what is random in it comes from the seed."""
        return None

    @abstractmethod
    def encode(
        self, x: NDArray[np.floating], timesteps: int, state: EncoderState = None
    ) -> NDArray[np.uint8]:
        """Spikes (B, T, M) of the normalised observations x (B, obs).

        state: of the episode, which is moved on; None for one that starts here with seed 0.
        """
