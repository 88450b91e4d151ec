"""codec.c: observations to the input channels that spike, and what leaves the chip to actions."""

from dataclasses import dataclass
from math import ldexp

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, literal, narrowest, number
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.c.templates import template
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.population import PopulationEncoder, pattern_table
from spikedeploy.runtime.codec.rate import RateEncoder
from spikedeploy.runtime.compiler.program import ReadoutTerm
from spikedeploy.runtime.errors import ConfigError

Floats = NDArray[np.floating]


# far below the logarithm of the least double
_NOTHING = -800.0


def encoder_gaps(codec: Codec, out: Declarations) -> dict[str, str]:
    """The functions of the encoder, what a reset does to it, and what a seed does."""
    encoder = codec.encoder
    if isinstance(encoder, DeltaEncoder):
        return _delta(codec, encoder, out)
    if isinstance(encoder, RateEncoder):
        return _rate(codec, encoder, out)
    if isinstance(encoder, PopulationEncoder):
        return _population(codec, encoder, out)
    raise TypeError(encoder.kind)


def table(name: str, values: Floats, out: Declarations, index: str = "k") -> str:
    """Return C for a value: a number where all are the same, else an entry of a table."""
    values = values.astype(np.float64)
    if (values == values.flat[0]).all():
        return number(float(values.flat[0]))
    return f"{out.constant(name, values)}[{index}]"


def _normalise(codec: Codec, chosen: NDArray[np.bool_], out: Declarations) -> dict[str, str]:
    """C that normalises `observed`, and clips the result."""
    normaliser = codec.normaliser
    mean = table("mean", normaliser.mean[chosen], out)
    std = table("std", normaliser.std[chosen], out)
    centred = "observed" if mean == "0.0" else f"(observed - {mean})"
    clip = number(normaliser.clip)
    clipped = (
        f"if (x > {clip}) {{\n    x = {clip};\n}} else if (x < -{clip}) {{\n    x = -{clip};\n}}"
    )
    return {
        "normalised": centred if std == "1.0" else f"{centred} / {std}",
        "clip": "\n".join(f"    {line}" for line in clipped.splitlines()),
    }


def _delta(codec: Codec, encoder: DeltaEncoder, out: Declarations) -> dict[str, str]:
    live = np.isfinite(encoder.step)
    if not live.any():
        raise ConfigError("--to c: the delta code has no channel with a finite step.")
    count, gaps = int(live.sum()), _normalise(codec, live, out)
    apart_max = 256 * encoder.most * (codec.timesteps + 1)
    apart = narrowest(-apart_max - 128, apart_max + 128)
    apart = apart if apart == "int64_t" else "int32_t"
    moved = narrowest(0, count - 1)
    parts = FixedParts.of(codec, encoder, live)
    furthest = int(parts.x_max.max()) // 256 + 1 + encoder.most
    level = narrowest(-furthest, furthest)
    for name, kind in (("level", level), ("apart", apart), ("moved", moved)):
        out.variable(name, kind, count)
    out.variable("moving", "uint32_t")
    gaps |= {
        "nearest": template("nearest.c"),
        "step": table("step", encoder.step[live], out),
        "observed": _indices(live, out),
        "channels": str(count),
        "threshold": str(encoder.threshold),
        "most": str(encoder.most),
        "level_kind": level,
        "apart_kind": apart,
        "apart_max": str(apart_max),
        "moved_kind": moved,
        "far_kind": "int32_t" if parts.small and apart == "int32_t" else "int64_t",
        "emit": _EMIT[encoder.code],
        **parts.gaps(out),
    }
    return {**gaps, "encoder": template("encode_delta.c"), "reset": _DELTA_RESET, "seed": ""}


def _indices(live: NDArray[np.bool_], out: Declarations) -> str:
    """C for which observation the k-th live channel encodes."""
    return "k" if live.all() else f"{out.constant('observed_at', np.flatnonzero(live))}[k]"


_EMIT = {
    "unary": """\
            uint32_t nth;
            for (nth = 0u; nth < events; nth++) {
                id[count] = (@prefix@_id_t)(first + nth);
                count++;
            }""",
    "one-hot": """\
            id[count] = (@prefix@_id_t)(first + events - 1u);
            count++;""",
}
_DELTA_RESET = """\
    {
        uint32_t k;
        for (k = 0u; k < @channels@u; k++) {
            level[k] = 0;
        }
        moving = 0u;
    }"""


def _rate(codec: Codec, encoder: RateEncoder, out: Declarations) -> dict[str, str]:
    count = encoder.width
    out.variable("rate", "uint16_t", count)
    regular = encoder.mode == "regular"
    out.variable("carry" if regular else "random", "uint16_t" if regular else "uint32_t", count)
    gaps = _normalise(codec, np.ones(count, np.bool_), out) | {
        "nearest": template("nearest.c"),
        "channels": str(count),
        "low": table("low", encoder.low, out),
        "range": table("range", encoder.high - encoder.low, out),
        "begin": "        carry[k] = 128u;" if regular else "",
        "spike": _REGULAR if regular else _BERNOULLI,
    }
    gaps["clip"] = gaps["clip"].replace("\n", "\n    ").replace("    ", "        ", 1)
    seed = "" if regular else template("seed.c")
    reset = "" if regular else "    @prefix@_seed(0u);"
    return {**gaps, "encoder": template("encode_rate.c"), "reset": reset, "seed": seed}


_REGULAR = """\
        carry[k] = (uint16_t)(carry[k] + rate[k]);
        if (carry[k] >= 256u) {
            carry[k] = (uint16_t)(carry[k] - 256u);
            id[count] = (@prefix@_id_t)k;
            count++;
        }"""
_BERNOULLI = """\
        uint32_t x = random[k];
        x ^= x << 13;
        x ^= x >> 17;
        x ^= x << 5;
        random[k] = x;
        if ((x >> 24) < rate[k]) {
            id[count] = (@prefix@_id_t)k;
            count++;
        }"""


def _population(codec: Codec, encoder: PopulationEncoder, out: Declarations) -> dict[str, str]:
    patterns = pattern_table(encoder.threshold, codec.timesteps, "<f8")
    bits = (patterns.spikes.astype(object) << np.arange(codec.timesteps)[:, None]).sum(axis=0)
    masks = np.array([int(each) for each in bits], np.uint64)
    kind = narrowest(0, int(masks.max()))
    out.constant("pattern_above", exponents(patterns.edges))
    out.constant("pattern_spikes", masks, kind)
    shown = narrowest(0, len(patterns.edges))
    out.variable("channel", "@prefix@_id_t", encoder.width)
    out.variable("shown", shown, encoder.width)
    out.variable("active", "uint32_t")
    gaps = _normalise(codec, np.ones(encoder.observed, np.bool_), out) | {
        "populations": str(encoder.mean.shape[1]),
        "patterns": str(len(patterns.edges)),
        "centre": table("centre", encoder.mean, out, "n"),
        "width": table("width", encoder.std, out, "n"),
        "shown_kind": shown,
    }
    gaps["clip"] = gaps["clip"].replace("\n", "\n    ").replace("    ", "        ", 1)
    return {
        **gaps,
        "encoder": template("encode_population.c"),
        "reset": "    active = 0u;",
        "seed": "",
    }


def exponents(drives: Floats) -> Floats:
    """For each drive the largest u with exp(u) <= drive, as NumPy computes exp."""
    low, high = np.full(drives.shape, _NOTHING), np.zeros(drives.shape)
    while True:
        middle = low + (high - low) / 2
        open_ = (middle > low) & (middle < high)
        if not open_.any():
            return low
        above = np.exp(middle) > drives
        high, low = np.where(open_ & above, middle, high), np.where(open_ & ~above, middle, low)


_OBSERVED = 29  # bits of the magnitude of an observation in fixed point
_PRODUCT = 61  # bits of its product with the gain
_REST = 16  # bits behind the point that tell how near the next whole number is
_LARGEST = 2**30  # as the encoder clips X
_USELESS = 0.05  # [1/256 steps] error at which doubles are better


@dataclass(frozen=True, eq=False)
class FixedParts:
    """Numbers by which C computes X = 256 (observation - mean) / std / step; per live channel.

    exponent: an observation is multiplied by 2**this, and cut.
    mean: in the same unit.
    gain: of the difference, in 2**-fraction of X.
    fraction: bits of the product behind the point.
    x_max: largest X, by the clip of the normaliser.
    error: of X [1/256 steps], at most.
    """

    exponent: NDArray[np.int64]
    mean: NDArray[np.int64]
    gain: NDArray[np.int64]
    fraction: int
    x_max: NDArray[np.int64]
    error: float

    @classmethod
    def of(cls, codec: Codec, encoder: DeltaEncoder, live: NDArray[np.bool_]) -> "FixedParts":
        """Those of a codec, with as many bits as fit."""
        normaliser = codec.normaliser
        mean, std = (v[live].astype(np.float64) for v in (normaliser.mean, normaliser.std))
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            parts = 256 / (std * encoder.step[live])  # per unit of the observation
            reach = normaliser.clip * std
            # beyond the clip by some parts, so that what is cut off there is clipped anyway
            reach = np.abs(mean) + reach + np.maximum(0.05 * reach, 4 / parts)
            x_max = np.rint(np.minimum(normaliser.clip / encoder.step[live] * 256, _LARGEST))
            exponent = _OBSERVED - np.ceil(np.log2(reach))
            each = parts / 2.0**exponent
            fraction = np.floor(_PRODUCT - 31 - np.log2(each))
            fine = np.isfinite(fraction) & (np.abs(exponent) < 900)
        if not fine.all() or not 34 <= fraction.min() < 59 or x_max.max() >= _LARGEST:
            zero = np.zeros(len(mean), np.int64)
            return cls(zero, zero, zero, 40, np.minimum(x_max, _LARGEST).astype(np.int64), 1.0)
        bits = int(fraction.min())
        lost = 1.5 * each + 2.0 ** (_OBSERVED + 1 - bits) / 2 + x_max * 2.0**-48
        return cls(
            exponent.astype(np.int64),
            np.rint(mean * 2.0**exponent).astype(np.int64),
            np.rint(each * 2.0**bits).astype(np.int64),
            bits,
            x_max.astype(np.int64),
            float(lost.max()),
        )

    @property
    def small(self) -> bool:
        """True if X, also before it is clipped, and its levels differ by less than 2**31."""
        return _PRODUCT - self.fraction < 29 and int(self.x_max.max()) < 2**29

    def gaps(self, out: Declarations) -> dict[str, str]:
        """Gaps of the template."""
        useful = self.error < _USELESS
        unsure = int(np.ceil(self.error * 2**_REST)) + 2 if useful else 2**_REST
        return {
            # 1054: the bias of a double's exponent, and the 31 bits before the point of its size
            "scale": out.per_neuron("scale", 1054 - self.exponent, "k", "int32_t"),
            "mean_fixed": out.per_neuron("mean_fixed", self.mean, "k", "int32_t"),
            "gain": out.per_neuron("gain", self.gain, "k", "int32_t"),
            "x_max": out.per_neuron("x_max", self.x_max, "k", "int32_t"),
            "fraction": f"{self.fraction}u",
            "raise": literal((1 << _PRODUCT) + (1 << (self.fraction - 1)), "int64_t"),
            "base": str(1 << (_PRODUCT - self.fraction)),
            "rest_shift": f"{self.fraction - _REST}u",
            "rest_mask": str((1 << _REST) - 1),
            "unsure": str(unsure),
            "sure": str((1 << _REST) - 2 * unsure) if useful else "1",
        }


# of 1/16 each, up to where tanh is 1 within 1e-13
_STEPS = 240


class DecoderWriter:
    """Writes what becomes of that which leaves the chip.

    scores: numbers of the output, of which actions are made.
    """

    def __init__(self, plan: Plan, codec: Codec, out: Declarations) -> None:
        self.plan, self.codec, self.out = plan, codec, out
        self._layers = {layer.name: k for k, layer in enumerate(plan.program.layers)}
        for term in plan.terms:
            if term.layer not in self._layers:
                raise ConfigError(
                    f"--to c: the output receives {term.layer!r}, which is no layer of the chip."
                )
        self.scores = len(plan.bias)

    def gaps(self) -> dict[str, str]:
        """The functions of the decoder, and what a reset does to it."""
        terms = list(enumerate(self.plan.terms))
        for k, term in terms:
            self._declare(k, term)
        clear = [line for k, term in terms for line in self._clear(k, term)]
        return {
            "decoder": template("decode.c"),
            "scores": str(self.scores),
            "clear": _lines(clear),
            "add": _lines([line for k, term in terms for line in self._add(k, term)]),
            "weigh": _lines([line for k, term in terms for line in self._weigh(k, term)]),
            "act": _lines(self._act()),
            "score_start": self._start(),
            "squash_function": self._squash(),
            "decoder_reset": _lines([line for k, term in terms for line in self._forget(k, term)]),
        }

    def _squash(self) -> str:
        """The function tanh in C, where it is needed, with its table."""
        if self.codec.squash != "tanh":
            return ""
        table = [int(ldexp(value, 64)) for value in np.tanh(np.arange(_STEPS) / 16)]
        self.out.constant("tanh_of", np.array(table, np.uint64))
        return template("squash.c")

    def _silent(self, term: ReadoutTerm) -> bool:
        return not self.plan.is_spiking(term)

    def _size(self, term: ReadoutTerm) -> int:
        return self.plan.sizes[term.layer]

    def _kind(self, term: ReadoutTerm) -> str:
        """The C type of what is added up."""
        if self._silent(term):
            return self.plan.kind if self.codec.timesteps == 1 else "int64_t"
        kind = narrowest(0, self.codec.timesteps * self.plan.times_max[term.layer])
        return kind if kind in ("uint8_t", "uint16_t") else "uint32_t"

    def _declare(self, k: int, term: ReadoutTerm) -> None:
        size = self._size(term)
        self.out.variable(f"total{k}", self._kind(term), size)
        if self._silent(term) and term.lag:
            self.out.variable(f"late{k}", "@prefix@_int_t", term.lag, size)
            self.out.variable(f"late{k}_at", "uint32_t")

    def _clear(self, k: int, term: ReadoutTerm) -> list[str]:
        zero = "0" if self._silent(term) else "0u"
        return [f"for (n = 0u; n < {self._size(term)}u; n++) {{", f"    total{k}[n] = {zero};", "}"]

    def _forget(self, k: int, term: ReadoutTerm) -> list[str]:
        if not (self._silent(term) and term.lag):
            return []
        return [
            "{",
            "    uint32_t n;",
            "    uint32_t t;",
            f"    late{k}_at = 0u;",
            f"    for (t = 0u; t < {term.lag}u; t++) {{",
            f"        for (n = 0u; n < {self._size(term)}u; n++) {{",
            f"            late{k}[t][n] = 0;",
            "        }",
            "    }",
            "}",
        ]

    def _add(self, k: int, term: ReadoutTerm) -> list[str]:
        silent, size, kind = self._silent(term), self._size(term), self._kind(term)
        late = 0 if silent else term.lag
        lines = [f"@prefix@_net_layer({self._layers[term.layer]}u, {late}u, &view);"]
        if not silent:
            times = "view.times[n]" if self.plan.times_max[term.layer] > 1 else "1u"
            total = f"total{k}[view.id[n]]"
            added = f"{total} = ({kind})({total} + {times});"
            return [*lines, "for (n = 0u; n < view.count; n++) {", f"    {added}", "}"]
        lines.append(f"for (n = 0u; n < {size}u; n++) {{")
        if not term.lag:
            return [*lines, f"    total{k}[n] += view.membrane[n];", "}"]
        row = f"late{k}[late{k}_at][n]"
        lines += [f"    total{k}[n] += {row};", f"    {row} = view.membrane[n];", "}"]
        return [*lines, f"late{k}_at = (late{k}_at + 1u) % {term.lag}u;"]

    def _weigh(self, k: int, term: ReadoutTerm) -> list[str]:
        """C that adds what a term has added up to the scores, times its weights."""
        size, (first, weight) = self._size(term), self.plan.score_weights[k]
        if weight.shape[0] == weight.shape[1] and not (weight - np.diag(np.diag(weight))).any():
            return self._diagonal(k, np.diag(weight), first)
        rows, columns = np.nonzero(weight)
        out, starts = self.out, np.searchsorted(rows, np.arange(size + 1))
        start, target = (
            out.constant(f"read{k}_first", starts),
            out.constant(f"read{k}_score", columns + first),
        )
        value = out.constant(f"read{k}_weight", weight[rows, columns])
        return [
            f"for (n = 0u; n < {size}u; n++) {{",
            f"    if (total{k}[n] != 0) {{",
            f"        const double total = (double)total{k}[n];",
            f"        for (a = {start}[n]; a < {start}[n + 1u]; a++) {{",
            f"            score[{target}[a]] += total * {value}[a];",
            "        }",
            "    }",
            "}",
        ]

    def _diagonal(self, k: int, weight: Floats, first: int) -> list[str]:
        """The same where each neuron has a score of its own."""
        if (weight == weight[0]).all():
            factor = number(float(weight[0]))
        else:
            factor = f"{self.out.constant(f'read{k}_weight', weight)}[n]"
        times = "" if factor == "1.0" else f" * {factor}"
        place = f"n + {first}u" if first else "n"
        value = f"(double)total{k}[n]{times}"
        return [f"for (n = 0u; n < {len(weight)}u; n++) {{", f"    score[{place}] += {value};", "}"]

    def _start(self) -> str:
        """C for what a score begins with: its bias in every timestep."""
        bias = self.plan.bias * self.codec.timesteps
        if (bias == bias[0]).all():
            return number(float(bias[0]))
        return f"{self.out.constant('bias', bias)}[a]"

    def _act(self) -> list[str]:
        """C from scores to actions."""
        timesteps = self.codec.timesteps
        value = "score[a]" if timesteps == 1 else f"score[a] / {number(float(timesteps))}"
        loop = f"for (a = 0u; a < {self.scores}u; a++) {{"
        if self.codec.chooses:
            return [
                loop,
                f"    score[a] = {value};",
                "}",
                "action[0] = 0;",
                f"for (a = 1u; a < {self.scores}u; a++) {{",
                "    if (score[a] > score[action[0]]) {",
                "        action[0] = (int32_t)a;",
                "    }",
                "}",
            ]
        squashed = f"squash({value})" if self.codec.squash == "tanh" else value
        return [loop, f"    action[a] = {squashed};", "}"]


def _lines(lines: list[str]) -> str:
    return "\n".join(f"    {line}" for line in lines)
