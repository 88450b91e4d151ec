"""The codec in 16-bit integers: the specification that codec_i16.c equals bit for bit.

Observations come in as `Int16Observations` has them, actions leave as Q15 or as an index. Between
them is the network of the program, unchanged. All of it is 32-bit integer arithmetic.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.int16_interface import Int16Observations
from spikedeploy.exporters.c.int16_tanh import (
    LEAST_FRACTION,
    linear_q15,
    score_fraction,
    tanh_q15,
)
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import LARGEST as X_LARGEST
from spikedeploy.runtime.codec.delta import PARTS, Code, DeltaEncoder
from spikedeploy.runtime.compiler.program import Program, ReadoutTerm
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import ConfigError

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

_INT32 = 2**31 - 1
_INT16 = 2**15
_WEIGHT_BITS = 12  # of the largest weight of a readout
_GAIN_ERROR = 0.25  # [1/256 steps] that rounding of a gain may move an observation


@dataclass(frozen=True, eq=False)
class Int16Delta:
    """The delta code of int16 observations o; per observation that some synapse reads (K,).

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
    """What a layer adds to the scores: (value >> drop) weight.

    layer: its name; of a silent one membranes count, of a spiking one spikes.
    silent: whether it is one without a threshold.
    lag: timesteps by which the value is late.
    drop: bits.
    weight: (N, scores).
    """

    layer: str
    silent: bool
    lag: int
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
    squash: as the codec has it.
    """

    observations: Int16Observations
    delta: Int16Delta
    bias: Integers
    terms: tuple[Int16Term, ...]
    fraction: int
    squash: str

    @property
    def chooses(self) -> bool:
        """Whether an action is the index of the largest score."""
        return self.squash == "argmax"

    @property
    def actions(self) -> int:
        """Numbers of an action."""
        return 1 if self.chooses else len(self.bias)

    def act(self, score: Integers) -> Integers:
        """The action (act,) of scores."""
        if self.chooses:
            return np.array([score.argmax()])
        squash = tanh_q15 if self.squash == "tanh" else linear_q15
        return squash(score, self.fraction)

    def floats(self, action: Integers) -> NDArray[np.float64]:
        """Actions (..., act) as the environment takes them; an index stays one."""
        return action.astype(np.float64) if self.chooses else action / 2.0**15


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
            np.zeros((term.lag + 1, len(term.weight)), np.int64) for term in self.codec.terms
        ]

    def act(self, o: Integers) -> Integers:
        """The action (act,) of int16 observations (obs,)."""
        delta, score = self.codec.delta, self.codec.bias.copy()
        events = delta.events(o, self._level)
        self._level += events
        self._machine.infer(delta.raster(events)[None, None])
        found = self._machine.recordings
        self.states = {name: each.membrane[0, 0].astype(np.int64) for name, each in found.items()}
        for term, late in zip(self.codec.terms, self._late, strict=True):
            recorded = found[term.layer]
            late[1:] = late[:-1].copy()
            late[0] = (recorded.membrane if term.silent else recorded.spikes)[0, 0]
            score += (late[-1] >> term.drop) @ term.weight
        return self.codec.act(score)


def int16_codec(plan: Plan) -> Int16Codec | str:
    """The codec of a plan in 16-bit integers, or why there is none."""
    codec = plan.codec
    if codec is None or not isinstance(codec.encoder, DeltaEncoder):
        return "it is written for delta codes"
    if codec.timesteps != 1 or plan.program.convention.state != "kept":
        return "it is written for inferences of one timestep that keep their states"
    if plan.kind != "int32_t":
        return "the states of the network need more than 32 bits"
    if any(plan.times_max[t.layer] > 1 for t in plan.terms if not _silent(plan, t)):
        return "a neuron that the output reads can spike several times in a timestep"
    try:
        observations = Int16Observations.of(codec.normaliser)
    except ConfigError as error:
        return str(error).removeprefix("--to c: ")
    delta = _delta(plan, codec, codec.encoder, observations)
    return delta if isinstance(delta, str) else _scored(plan, codec, observations, delta)


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
    """Whether (obs,) some synapse, or the output, reads the channels of an observation."""
    program = plan.program
    read = np.zeros(program.width, np.bool_)
    for layer in program.layers:
        for synapses in layer.synapses:
            if synapses.source == program.input:
                read |= (synapses.weight != 0).any(axis=1)
    return np.asarray(read.reshape(encoder.observed, -1).any(axis=1))


def _scored(
    plan: Plan, codec: Codec, observations: Int16Observations, delta: Int16Delta
) -> Int16Codec | str:
    """The decoder: weights of scores in a common unit, as fine as 32 bits let them be."""
    bias, weights = scores(plan)
    bounds = [
        plan.states_max(term.layer) if _silent(plan, term) else plan.times_max[term.layer]
        for term in plan.terms
    ]
    parts = zip(bounds, weights, strict=True)
    largest = np.abs(bias) + sum(bound * np.abs(w).sum(axis=0) for bound, w in parts)
    fraction = score_fraction(float(largest.max()))
    if not LEAST_FRACTION <= fraction < 60:
        return "the scores of its actions need more than 32 bits"
    total, terms = np.rint(bias * 2.0**fraction), []
    for term, weight in zip(plan.terms, weights, strict=True):
        most = np.abs(weight).max(initial=0) or 1.0
        drop = max(0, int(_WEIGHT_BITS - fraction - np.ceil(np.log2(most))))
        drop = drop if _silent(plan, term) else 0
        fixed = np.rint(weight * 2.0 ** (fraction + drop)).astype(np.int64)
        # bits that are dropped are half a unit in the mean
        total += fixed.sum(axis=0) // 2 if drop else 0
        terms.append(Int16Term(term.layer, _silent(plan, term), term.lag, drop, fixed))
    return Int16Codec(
        observations, delta, total.astype(np.int64), tuple(terms), fraction, codec.squash
    )


def _silent(plan: Plan, term: ReadoutTerm) -> bool:
    return not plan.program.layer(term.layer).spiking


def scores(plan: Plan) -> tuple[Floats, list[Floats]]:
    """Bias (scores,) of the output, and the weights (N, scores) of each term of the plan."""
    program, weights, first = plan.program, [], 0
    if program.outlets:
        bias = np.concatenate([outlet.bias for outlet in program.outlets])
        places = [(o.port.size, len(o.taps)) for o in program.outlets]
    else:
        size = plan.sizes[program.output]
        bias = np.zeros(size) if program.readout is None else program.readout.bias
        places = [(len(bias), 1)]
    terms = iter(plan.terms)
    for size, taps in places:
        for _ in range(taps):
            term = next(terms)
            inner = np.eye(plan.sizes[term.layer]) if term.weight is None else term.weight
            if _silent(plan, term):
                scale = program.layer(term.layer).scale
                inner = np.broadcast_to(scale, (len(inner),))[:, None] * inner
            weight = np.zeros((len(inner), len(bias)))
            weight[:, first : first + size] = inner
            weights.append(weight)
        first += size
    return bias, weights
