"""The codec: observations to spikes, network output to actions; NumPy float64 is the reference.

It holds the normaliser and the squashing too, so that a `.nir` file is all that a robot needs.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.ma  # here, as np.unique would import it while a policy is loaded
from numpy.typing import ArrayLike, NDArray

from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.encoder import ENCODERS, Encoder, EncoderState
from spikedeploy.runtime.codec.events import EventEncoder
from spikedeploy.runtime.codec.population import PopulationEncoder
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.errors import ObservationError
from spikedeploy.runtime.metadata import OPTIONAL, StoredRecord

__all__ = [
    "ENCODERS",
    "Codec",
    "DeltaEncoder",
    "Encoder",
    "EncoderState",
    "EventEncoder",
    "Normaliser",
    "PopulationEncoder",
    "RateEncoder",
]

Squash = Literal["tanh", "none", "argmax"]
Score = Literal["mean", "last"]

# what to do about a file without one
GIVE_CODEC = (
    "Give it one: `spikedeploy run FILE --from TOOL --codec FILE.json --env ENV` (or --dt in place "
    "of --from) writes FILE.policy.nir; docs/own-network.md, As a policy, has such a JSON file"
)

_MOST_TIMESTEPS = 2**16  # of an inference: a spike train is held whole


@dataclass(frozen=True, eq=False)
class Normaliser(StoredRecord):
    """Observation to zero mean and unit standard deviation, clipped.

    mean: (obs,) in the observation's units.
    std: (obs,) likewise.
    clip: largest magnitude of a normalised observation [standard deviations].
    """

    label: ClassVar[str] = "normaliser"

    mean: NDArray[np.floating]
    std: NDArray[np.floating]
    clip: float

    def __post_init__(self) -> None:
        if self.mean.ndim != 1 or self.mean.shape != self.std.shape:
            found = f"{self.mean.shape} and {self.std.shape}"
            raise self.wrong(f"mean and std must both have shape (obs,), found {found}")
        if not (np.isfinite(self.mean).all() and (self.std > 0).all() and self.clip > 0):
            found = f"{self.mean.max()}, {self.std.min()} and {self.clip}"
            raise self.wrong(f"mean must be finite, std and clip above 0, found {found}")

    def __call__(self, obs: NDArray[np.floating]) -> NDArray[np.floating]:
        """Normalised observations (B, obs)."""
        # x = clip((obs - mean) / std, -clip, clip)
        x = obs - self.mean
        x /= self.std
        # np.clip takes three times as long at batch 1
        np.minimum(x, self.clip, out=x)
        np.maximum(x, -self.clip, out=x)
        return x


@dataclass(frozen=True, eq=False)
class Codec(StoredRecord):
    """Everything between a robot's numbers and the network's spikes.

    normaliser: of the observation.
    encoder: of the normalised observation; one of ENCODERS.
    timesteps: T, network updates per inference.
    squash: from scores to the action: "tanh", "none", or "argmax", the index of the largest, the
        lowest of equals.
    score: what of the readout over the timesteps is the score: its "mean", or its "last" value.
    """

    label: ClassVar[str] = "codec"

    normaliser: Normaliser
    encoder: Encoder
    timesteps: int
    squash: Squash = "tanh"
    score: Score = field(default="mean", metadata=OPTIONAL)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.normaliser.mean.size != self.encoder.observed:
            raise self.wrong(
                f"the normaliser takes {self.normaliser.mean.size} numbers and the encoder "
                f"{self.encoder.observed}; they must agree"
            )
        if not 1 <= self.timesteps <= _MOST_TIMESTEPS:
            raise self.wrong(f"timesteps must be 1 to {_MOST_TIMESTEPS:,}, found {self.timesteps}")

    @property
    def chooses(self) -> bool:
        """True if an action is one of several choices, not a vector of numbers."""
        return self.squash == "argmax"

    def encode(self, obs: ArrayLike, state: EncoderState = None) -> NDArray[np.uint8]:
        """Spikes (B, T, M) of the observations (B, obs) of B robots, which must be finite.

        state: of the episode, from the encoder's `start`, which is moved on; None for one that
            starts here with seed 0.
        """
        # 1e308 is finite, and becomes infinity in a narrow type or on division; the clip ends it
        with np.errstate(over="ignore"):
            observed = observed_numbers(obs).astype(self.normaliser.mean.dtype, copy=False)
            self._check_observation(observed)
            normalised = self.normaliser(observed)
        return self.encoder.encode(normalised, self.timesteps, state)

    def encode_episode(self, obs: ArrayLike, seed: int = 0) -> NDArray[np.uint8]:
        """Spikes (S, T, M) of the successive observations (S, obs) of one robot.

        The episode starts here, which matters to a code with a memory.
        """
        state = self.encoder.start(seed)
        return np.concatenate([self.encode(row[None], state) for row in observed_numbers(obs)])

    def decode(self, output: NDArray[np.floating]) -> NDArray[Any]:
        """Actions (B, act), or (B,) of "argmax", from the readout's output (B, T, act)."""
        scores = self.scores(output)
        if self.chooses:
            return np.asarray(scores.argmax(axis=1))
        return np.tanh(scores) if self.squash == "tanh" else scores

    def scores(self, output: NDArray[np.floating]) -> NDArray[np.floating]:
        """Scores (B, act) of the readout's output (B, T, act)."""
        if output.ndim != 3 or output.shape[1] != self.timesteps:
            raise ObservationError(
                f"decode: the output has shape {output.shape}; the codec needs "
                f"(B, {self.timesteps}, act), one row per timestep of an inference."
            )
        if self.score == "last":
            return output[:, -1]
        # score = 1/T sum_t output[t]
        mean: NDArray[np.floating] = np.add.reduce(output, axis=1) / self.timesteps
        return mean

    def _check_observation(self, obs: NDArray[np.floating]) -> None:
        size = self.encoder.observed
        if obs.ndim != 2 or obs.shape[1] != size or not len(obs):
            raise ObservationError(
                f"the observation has shape {obs.shape}; the codec needs (B, {size}). "
                "Is this policy meant for this environment?"
            )
        if not np.isfinite(obs).all():
            row, column = np.argwhere(~np.isfinite(obs))[0]
            raise ObservationError(
                f"the observation holds {obs[row, column]} at index {column} of row {row}; all "
                "must be finite. Check the sensor or simulation that it comes from."
            )


def observed_numbers(obs: ArrayLike) -> NDArray[Any]:
    """An observation as an array of real numbers; ObservationError where it is anything else.

    Lossy conversions are refused: complex numbers, dates, records, masked values.
    """
    if isinstance(obs, np.ma.MaskedArray) and np.ma.getmaskarray(obs).any():
        raise ObservationError(
            "the observation has masked values, which nothing says what to do with. Fill them."
        )
    try:
        found = np.asarray(obs)
        if found.dtype.kind == "O":  # huge whole numbers
            found = found.astype(np.float64)
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise ObservationError(
            f"the observation is no array of numbers: {str(error)[:80]}. Give (obs,) numbers."
        ) from error
    if found.dtype.kind not in "biuf":
        raise ObservationError(
            f"the observation holds {str(found.dtype)[:40]}, and not real numbers. Give (obs,) "
            "numbers."
        )
    return found
