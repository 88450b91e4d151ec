"""The interface in 16-bit integers: what codec_i16.c equals bit for bit.

Observations are integers with a power of two each, chosen from the normaliser's range; actions are
Q15, or an index; tanh is a table with straight lines between its entries.
"""

from dataclasses import dataclass, field
from math import ceil, floor, log2

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.plan import Plan, Tap, diagonal_of
from spikedeploy.runtime.codec.codec import Codec, Normaliser
from spikedeploy.runtime.codec.delta import LARGEST as X_LARGEST
from spikedeploy.runtime.codec.delta import PARTS, Code, DeltaEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError, ObservationError

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


LARGEST = 2**15 - 1
_EXPONENTS = 126  # of either sign: what an int8_t of C holds


@dataclass(frozen=True, eq=False)
class Int16Observations:
    """Fixed-point numbers that stand for observations.

        o = rint(clip(value 2**exponent, low, high))

    exponent: (obs,) bits behind the binary point; may be negative.
    low, high: (obs,) the clip of the normaliser in these units, within int16.
    """

    exponent: Integers
    low: Integers
    high: Integers

    @classmethod
    def from_normaliser(cls, normaliser: Normaliser) -> "Int16Observations":
        """The finest powers of two at which mean +- clip standard deviations fit in 16 bits."""
        mean, std = normaliser.mean.astype(np.float64), normaliser.std.astype(np.float64)
        reach = np.abs(mean) + normaliser.clip * std
        with np.errstate(all="ignore"):
            exponent = np.floor(np.log2(LARGEST / reach))
        bad = ~(np.abs(exponent) <= _EXPONENTS)
        if bad.any():
            k = int(np.flatnonzero(bad)[0])
            raise ConfigError(
                f"--to c: observation {k} reaches {reach[k]:.3g}, which no int16 with an exponent "
                f"from -{_EXPONENTS} to {_EXPONENTS} stands for. Train with a finite normaliser "
                "clip and observations in ordinary units."
            )
        scale = 2.0**exponent
        low = np.rint((mean - normaliser.clip * std) * scale)
        high = np.rint((mean + normaliser.clip * std) * scale)
        return cls(exponent.astype(np.int64), low.astype(np.int64), high.astype(np.int64))

    def quantise(self, observation: NDArray[np.floating]) -> Integers:
        """Integers (..., obs) of observations in their own units."""
        if not np.isfinite(observation).all():
            raise ObservationError("the observation holds a number that is not finite")
        scaled = np.asarray(observation, np.float64) * 2.0**self.exponent
        return np.asarray(np.rint(np.clip(scaled, self.low, self.high)), np.int64)


ONE = 2**15 - 1  # the action 1.0 in Q15
PER_UNIT = 5  # bits: 32 entries for each unit of the score
BETWEEN = 10  # bits of the place between two entries
_LAST = 5.5  # tanh is 1 within half a unit of Q15 from here on

TABLE = np.rint(ONE * np.tanh(np.arange(ceil(_LAST * 2**PER_UNIT) + 1) / 2**PER_UNIT)).astype(
    np.int64
)
LEAST_FRACTION = PER_UNIT + BETWEEN


def tanh_q15(score: Integers, fraction: int) -> Integers:
    """Q15 of tanh(score 2**-fraction), fraction >= LEAST_FRACTION; within 5 units of the real one.

    z = |score|,  i = z >> (fraction - 5),  f = ten bits behind i
    y = T[i] + ((T[i + 1] - T[i]) f + 512 >> 10),  and 32767 where the table ends
    """
    size = np.abs(score)
    place = size >> (fraction - PER_UNIT)
    inside = np.minimum(place, len(TABLE) - 2)
    between = (size >> (fraction - LEAST_FRACTION)) & (2**BETWEEN - 1)
    step = TABLE[inside + 1] - TABLE[inside]
    line = TABLE[inside] + ((step * between + 2 ** (BETWEEN - 1)) >> BETWEEN)
    found: Integers = np.sign(score) * np.where(place < len(TABLE) - 1, line, ONE)
    return found


def linear_q15(score: Integers, fraction: int) -> Integers:
    """Q15 of the score itself, within [-1, 1]."""
    found: Integers = np.clip(score >> (fraction - 15), -ONE, ONE)
    return found


def action_as_floats(action: Integers, chooses: bool) -> NDArray[np.float64]:
    """Actions (..., act) of Q15 in [-1, 1]; an index, where one is chosen, stays one."""
    return action.astype(np.float64) if chooses else action / 2.0**15


_INT32 = 2**31 - 1
_INT16 = 2**15
_WEIGHT_BITS = 12  # of the largest weight of a readout
_GAIN_ERROR = 0.25  # [1/256 steps] that rounding of a gain may move an observation


@dataclass(frozen=True, eq=False)
class Int16Delta:
    """The delta code of int16 observations o in a timestep; per observation that is read (K,).

        X = clip((gain o + offset) >> shift, -x_max, x_max)         in 1/256 steps
        e = X - 256 q,  n = sign(e) min((|e| + 128) >> 8, most) where |e| > threshold, else 0
        q = q + n

    observed: which of the obs observations.
    size: obs.
    """

    observed: Integers
    gain: Integers
    offset: Integers
    shift: Integers
    x_max: Integers
    size: int
    most: int
    code: Code
    threshold: int

    @property
    def levels_max(self) -> int:
        """Largest magnitude of a level q."""
        return int(self.x_max.max()) // PARTS + 1

    @property
    def bound(self) -> Integers:
        """(K,) sums of gain o and what is added to it from which an event is sent."""
        return np.asarray((2 * self.threshold + 1) << self.shift)

    def events(self, o: Integers, level: Integers) -> Integers:
        """Signed numbers of events (K,) of observations (obs,) at levels (K,)."""
        parts = (self.gain * o[self.observed] + self.offset) >> self.shift
        apart = np.clip(parts, -self.x_max, self.x_max) - PARTS * level
        far = np.abs(apart)
        events = np.sign(apart) * np.minimum((far + PARTS // 2) >> 8, self.most)
        return np.where(far > self.threshold, events, 0)

    def raster(self, events: Integers) -> NDArray[np.uint8]:
        """Input spikes (M,) of signed numbers of events (K,), numbered as DeltaEncoder has it."""
        spikes = np.zeros((self.size, 2, self.most), np.uint8)
        for k in np.flatnonzero(events):
            n = abs(int(events[k]))
            first = 0 if self.code == "unary" else n - 1
            spikes[self.observed[k], int(events[k] < 0), first:n] = 1
        return spikes.ravel()


@dataclass(frozen=True, eq=False)
class Int16Term:
    """Contribution of a layer to the scores: (value >> drop) weight.

    drop: bits.
    weight: (N, scores).
    """

    tap: Tap
    drop: int
    weight: Integers


@dataclass(frozen=True, eq=False)
class Int16Codec:
    """Observations and actions of a policy in 16-bit integers.

    observations: what the integers that come in stand for.
    delta: the encoder.
    bias: (scores,) in 2**-fraction.
    terms: what layers add to it.
    fraction: bits of a score behind the point.
    squash, timesteps: as the codec has them; scores are those of the last timestep.
    """

    observations: Int16Observations
    delta: Int16Delta
    bias: Integers
    terms: tuple[Int16Term, ...]
    fraction: int
    squash: str
    timesteps: int

    @property
    def chooses(self) -> bool:
        """True if an action is the index of the largest score."""
        return self.squash == "argmax"

    @property
    def actions(self) -> int:
        """Numbers of an action."""
        return 1 if self.chooses else len(self.bias)

    @property
    def diagonal(self) -> Integers | None:
        """(scores,) weights where each score is a bias and one membrane as it is now; else None."""
        term = self.terms[0]
        if self.chooses or len(self.terms) != 1 or not term.tap.silent or term.tap.lag:
            return None
        return diagonal_of(term.weight)

    def act(self, score: Integers) -> Integers:
        """The action (act,) of scores."""
        if self.chooses:
            return np.array([score.argmax()])
        squash = tanh_q15 if self.squash == "tanh" else linear_q15
        return squash(score, self.fraction)


@dataclass
class Int16Player:
    """A policy that runs in integers: the specification of NAME_act_i16.

    states: membranes (N,) of each layer after the last control step.
    """

    program: Program
    codec: Int16Codec
    states: dict[str, Integers] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget every state."""
        self._machine = Machine(self.program, 1, "none", trace=True, backend="interpreter")
        self._level = np.zeros(len(self.codec.delta.observed), np.int64)
        self._late = [
            np.zeros((term.tap.lag + 1, term.tap.size), np.int64) for term in self.codec.terms
        ]

    def act(self, o: Integers) -> Integers:
        """The action (act,) of int16 observations (obs,)."""
        for _ in range(self.codec.timesteps):
            score = self._score(o)
        return self.codec.act(score)

    def _score(self, o: Integers) -> Integers:
        """The scores after a timestep."""
        delta, score = self.codec.delta, np.array(self.codec.bias)
        events = delta.events(o, self._level)
        self._level += events
        self._machine.infer(delta.raster(events)[None, None])
        found = self._machine.recordings
        self.states = {name: each.membrane[0, 0].astype(np.int64) for name, each in found.items()}
        for term, late in zip(self.codec.terms, self._late, strict=True):
            recorded = found[term.tap.layer]
            late[1:] = late[:-1].copy()
            late[0] = (recorded.membrane if term.tap.silent else recorded.spikes)[0, 0]
            score += (late[-1] >> term.drop) @ term.weight
        return score


def int16_codec(plan: Plan) -> Int16Codec | str:
    """Return the codec of a plan in 16-bit integers, or the reason why there is none."""
    codec = plan.codec
    if codec is None or not isinstance(codec.encoder, DeltaEncoder):
        return "it is written for delta codes"
    if plan.program.convention.state != "kept":
        return "it is written for policies that keep their states"
    if codec.timesteps > 1 and codec.score != "last":
        return "it is written for actions of the last timestep, not of the mean of several"
    if plan.kind != "int32_t":
        return "the states of the network need more than 32 bits"
    if any(tap.times_max > 1 for tap in plan.taps if not tap.silent):
        return "a neuron that the output reads can spike several times in a timestep"
    try:
        observations = Int16Observations.from_normaliser(codec.normaliser)
    except ConfigError as error:
        return str(error).removeprefix("--to c: ")
    delta = _delta(plan, codec, codec.encoder, observations)
    return delta if isinstance(delta, str) else _fix_scores(plan, codec, observations, delta)


def _delta(
    plan: Plan, codec: Codec, encoder: DeltaEncoder, observations: Int16Observations
) -> Int16Delta | str:
    read = np.isfinite(encoder.step) & _read(plan, encoder)
    if not read.any():
        return "no synapse reads an observation"
    mean, std = (v[read].astype(np.float64) for v in (codec.normaliser.mean, codec.normaliser.std))
    step, scale = encoder.step[read].astype(np.float64), 2.0 ** observations.exponent[read]
    gain = PARTS / (std * step * scale)  # parts of a step in a unit of o
    x_max = np.rint(np.minimum(codec.normaliser.clip / step * PARTS, X_LARGEST))
    levels = 2 * encoder.threshold + PARTS * (x_max // PARTS + 2 + encoder.most)
    # gain o, offset and levels have to fit in 31 bits, rounding of the gain included
    reach = _INT16 * gain + np.abs(mean) * scale * gain + levels + 1
    own = np.floor(np.log2((_INT32 - 2 * _INT16) / reach)).astype(np.int64)
    enough = int(np.ceil(np.log2(x_max / (2 * _GAIN_ERROR) / gain)).max())
    shift = np.minimum(own, max(enough, 0))
    if (shift < 0).any():
        k = int(np.flatnonzero(read)[np.argmin(shift)])
        return f"a step of observation {k} is finer than 32 bits can tell"
    fixed = np.rint(gain * 2.0**shift)
    offset = np.rint(2.0**shift / 2 - mean * scale * fixed)
    return Int16Delta(
        observed=np.flatnonzero(read),
        gain=fixed.astype(np.int64),
        offset=offset.astype(np.int64),
        shift=shift,
        x_max=x_max.astype(np.int64),
        size=encoder.observed,
        most=encoder.most,
        code=encoder.code,
        threshold=encoder.threshold,
    )


def _read(plan: Plan, encoder: DeltaEncoder) -> NDArray[np.bool_]:
    """Mask (obs,) of the observations whose channels some synapse, or the output, reads."""
    program = plan.program
    read = np.zeros(program.width, np.bool_)
    for layer in program.layers:
        for synapses in layer.synapses:
            if synapses.source == program.input:
                read |= synapses.fan_out > 0
    return np.asarray(read.reshape(encoder.observed, -1).any(axis=1))


def _fix_scores(
    plan: Plan, codec: Codec, observations: Int16Observations, delta: Int16Delta
) -> Int16Codec | str:
    """The decoder: weights of scores in a common unit, as fine as 32 bits let them be."""
    reach, weights = np.zeros(len(plan.bias)), []
    for tap in plan.taps:
        weight = np.zeros((tap.size, len(plan.bias)))
        weight[:, tap.first : tap.first + tap.weight.shape[1]] = tap.weight
        weights.append(weight)
        most = plan.magnitudes[tap.layer].states if tap.silent else tap.times_max
        reach = reach + most * np.abs(weight).sum(axis=0)
    largest = max(float((np.abs(plan.bias) + reach).max()), 2.0**-14)
    fraction = floor(30 - log2(largest))  # one of 31 bits stays free
    if not LEAST_FRACTION <= fraction < 60:
        return "the scores of its actions need more than 32 bits"
    total, terms = np.rint(plan.bias * 2.0**fraction), []
    for tap, weight in zip(plan.taps, weights, strict=True):
        finest = np.abs(weight).max(initial=0) or 1.0
        drop = max(0, int(_WEIGHT_BITS - fraction - np.ceil(np.log2(finest)))) * tap.silent
        fixed = np.rint(weight * 2.0 ** (fraction + drop)).astype(np.int64)
        # bits that are dropped are half a unit in the mean
        total += fixed.sum(axis=0) // 2 if drop else 0
        terms.append(Int16Term(tap, drop, fixed))
    fixed_bias, timesteps = total.astype(np.int64), codec.timesteps
    return Int16Codec(
        observations, delta, fixed_bias, tuple(terms), fraction, codec.squash, timesteps
    )
