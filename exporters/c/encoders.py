"""The encoder in C: observations to the input channels that spike."""

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, narrowest, number
from spikedeploy.exporters.c.fixed_parts import FixedParts
from spikedeploy.exporters.c.templates import template
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.codec.population import PopulationEncoder, pattern_table
from spikedeploy.runtime.codec.rate import RateEncoder
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
    """What stands for a value in C: a number where all are the same."""
    values = values.astype(np.float64)
    if (values == values.flat[0]).all():
        return number(float(values.flat[0]))
    return f"{out.constant(name, values)}[{index}]"


def _normalised(codec: Codec, chosen: NDArray[np.bool_], out: Declarations) -> dict[str, str]:
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
    count, gaps = int(live.sum()), _normalised(codec, live, out)
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
    gaps = _normalised(codec, np.ones(count, np.bool_), out) | {
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
    gaps = _normalised(codec, np.ones(encoder.observed, np.bool_), out) | {
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
