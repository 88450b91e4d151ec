"""Encoder: the interface of the codes that make spikes of normalised observations."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.metadata import Record, StoredRecord, Tree

# what an encoder carries from one inference of an episode to the next, for every robot of a batch;
# made by its `start`, read by its `encode` alone; copied by copy and pickle
EncoderState: TypeAlias = Any


# by the name of their kind
ENCODERS: "dict[str, type[Encoder]]" = {}


@dataclass(frozen=True, eq=False)
class Encoder(StoredRecord, ABC):
    """Normalised observations to spikes; a file stores its kind and its fields.

    kind: in files, and in ENCODERS, where each class enters itself.
    """

    kind: ClassVar[str]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.label = f"{cls.kind} encoder"
        ENCODERS[cls.kind] = cls

    def to_record(self) -> Tree:
        """The kind and the fields as the file stores them."""
        return {"kind": self.kind, **super().to_record()}

    @classmethod
    def from_record(cls, record: Record) -> "Encoder":
        """The encoder stored in a file, of any kind; ArtifactError where it is none."""
        kind = record.text("kind")
        if kind not in ENCODERS:
            raise ArtifactError(
                f"metadata {record.where}.kind is {kind!r}; known encoders are "
                f"{', '.join(ENCODERS)}. If a newer spikedeploy wrote the file, update; "
                "otherwise export the policy again."
            )
        stored = {name: value for name, value in record.fields.items() if name != "kind"}
        read = super(Encoder, ENCODERS[kind]).from_record
        return read(Record(stored, record.where))

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
