"""codec_i16.c, PREFIX_i16.h and host_i16.c: a policy with observations and actions in 16 bits."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, bytes_of, literal, narrowest
from spikedeploy.exporters.c.int16 import (
    BETWEEN,
    PER_UNIT,
    TABLE,
    Int16Codec,
    Int16Observations,
    Int16Term,
)
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.c.templates import fill, template

Integers = NDArray[np.int64]

# channels of an encoder, and weights of a readout, that are written one by one and not as a loop
_STRAIGHT = 160


def codec_files(
    plan: Plan, codec: Int16Codec, common: Mapping[str, str], prefix: str
) -> tuple[dict[str, str], Declarations]:
    """Text of the files of the interface by name, and what they declare."""
    out = Declarations(bytes_of(plan.kind), bytes_of(plan.id_kind))
    gaps = {**common, **interface_gaps(codec.actions, len(codec.bias) if codec.chooses else 0)}
    files = {
        f"{prefix}_i16.h": fill(template("policy_i16.h"), gaps),
        "codec_i16.c": fill(template("codec_i16.c"), {**gaps, **_codec_gaps(plan, codec, out)}),
        "host_i16.c": host_file(codec.observations, gaps, f"{prefix}_i16"),
    }
    return files, out


def interface_gaps(actions: int, choices: int) -> dict[str, str]:
    """Gaps of the header of the interface."""
    words = "an index" if choices else "Q15: 32767 stands for 1"
    return {
        "actions": str(actions),
        "choices": str(choices),
        "action_words": words,
        "net_call": "",
        "action_kind": "int32_t" if choices else "double",
        "action_value": "out[a]" if choices else "(double)out[a] / 32768.0",
    }


def host_file(observations: Int16Observations, gaps: Mapping[str, str], host: str) -> str:
    """host_i16.c; host: what the names of the interface in doubles begin with."""
    tables = [
        _public(f"@prefix@_{name}", getattr(observations, name), kind)
        for name, kind in (("exponent", "int8_t"), ("low", "int16_t"), ("high", "int16_t"))
    ]
    suffix = "_i16" if host.endswith("_i16") else ""
    more = {"declarations": "\n".join(tables), "host": host, "lib_suffix": suffix}
    return fill(template("host_i16.c"), {**gaps, **more})


def tanh_gaps(squash: str, fraction: int, out: Declarations) -> str:
    """The function from a score to Q15, with its table; "" where the largest is chosen."""
    if squash == "argmax":
        return ""
    if squash == "tanh":
        out.constant("tanh_of", TABLE, "int16_t")
        gaps = {
            "fraction": str(fraction),
            "place_shift": str(fraction - PER_UNIT),
            "between_shift": str(fraction - PER_UNIT - BETWEEN),
            "last": str(len(TABLE) - 1),
        }
        return fill(template("tanh_i16.c"), gaps)
    lines = [
        f"/* Q15 of a score in 2**-{fraction}. */",
        "static int16_t linear_q15(int32_t score)",
        "{",
        f"    int32_t y = score >> {fraction - 15};",
        "    y = (y > 32767) ? 32767 : y;",
        "    return (int16_t)((y < -32767) ? -32767 : y);",
        "}",
        "",
        "",
    ]
    return "\n".join(lines)


def squash_call(squash: str, score: str) -> str:
    """C for the action of a score."""
    return f"{'tanh_q15' if squash == 'tanh' else 'linear_q15'}({score})"


def _public(name: str, values: Integers, kind: str) -> str:
    own = Declarations()
    own.constant(name, values, kind)
    return own.text.removeprefix("static ")


def _codec_gaps(plan: Plan, codec: Int16Codec, out: Declarations) -> dict[str, str]:
    decoder, reset = _decoder(plan, codec, out)
    encoder = _encoder(codec, out)
    tanh = tanh_gaps(codec.squash, codec.fraction, out)
    return {
        "encoder": encoder,
        "tanh": tanh + decoder,
        "channels": str(len(codec.delta.observed)),
        "decoder_reset": reset,
        "declarations": out.text,
    }


def _encoder(codec: Int16Codec, out: Declarations) -> str:
    delta = codec.delta
    count = len(delta.observed)
    level = narrowest(-delta.levels_max - delta.most, delta.levels_max + delta.most)
    # what is added to gain o; the threshold makes the smallest sum that sends nothing 0
    rest = delta.offset + (delta.threshold << delta.shift)
    out.constant("centre_at_rest", rest, "int32_t")
    out.variable("level", level, count)
    out.variable("centre", "int32_t", count)
    bound = (2 * delta.threshold + 1) << delta.shift
    each = "".join(
        f"    sum = ({gain} * observation[{k}]) + centre[{n}];\n"
        f"    if ((uint32_t)sum >= {literal(int(most), 'uint32_t')}) {{\n"
        f"        count = sent({n}u, sum, id, count);\n    }}\n"
        for n, (k, gain, most) in enumerate(zip(delta.observed, delta.gain, bound, strict=True))
    )
    most = str(delta.most)
    first = np.asarray(2 * delta.most * delta.observed)
    gaps = {
        "prefix": "@prefix@",
        "threshold": str(delta.threshold),
        "shift": out.per_neuron("shift", delta.shift, "k", "uint32_t"),
        "x_max": out.per_neuron("x_max", delta.x_max, "k", "int32_t"),
        "most": most,
        "first": out.per_neuron("first_of", first, "k", "uint32_t"),
        "level_kind": level,
        "channels_of": each.rstrip("\n") if count <= _STRAIGHT else _loop(codec, out),
        "emit": _EMIT[delta.code],
    }
    return fill(template("encode_i16.c"), {**gaps, "prefix": "\0"}).replace("\0", "@prefix@")


def _loop(codec: Int16Codec, out: Declarations) -> str:
    """The channels of an encoder as a loop."""
    delta = codec.delta
    bound = (2 * delta.threshold + 1) << delta.shift
    at = out.per_neuron("observed_at", delta.observed, "k", "uint32_t")
    gain = out.per_neuron("gain", delta.gain, "k", "int32_t")
    limit = out.per_neuron("bound", bound, "k", "uint32_t")
    return "\n".join(
        [
            "    uint32_t k;",
            f"    for (k = 0u; k < {len(delta.observed)}u; k++) {{",
            f"        sum = ({gain} * observation[{at}]) + centre[k];",
            f"        if ((uint32_t)sum >= {limit}) {{",
            "            count = sent(k, sum, id, count);",
            "        }",
            "    }",
        ]
    )


_EMIT = {
    "unary": """\
        while (events > 0) {
            id[count] = (@prefix@_id_t)first;
            first++;
            count++;
            events--;
        }""",
    "one-hot": """\
        id[count] = (@prefix@_id_t)(first + (uint32_t)events - 1u);
        count++;""",
}


def _decoder(plan: Plan, codec: Int16Codec, out: Declarations) -> tuple[str, str]:
    """The function `decode`, and what a reset does to it."""
    layers = {layer.name: k for k, layer in enumerate(plan.program.layers)}
    scores, adds, resets = len(codec.bias), [], []
    bias = out.per_neuron("bias", codec.bias, "a", "int32_t")
    if _one_to_one(codec):
        (term,) = codec.terms
        weight = out.per_neuron("read_weight", np.diag(term.weight), "a", "int32_t")
        value = f"(view.membrane[a] >> {term.drop})" if term.drop else "view.membrane[a]"
        score = f"{bias} + {value} * {weight}"
        lines = [
            "@prefix@_layer_t view;",
            "uint32_t a;",
            f"@prefix@_net_layer({layers[term.layer]}u, 0u, &view);",
            f"for (a = 0u; a < {scores}u; a++) {{",
            f"    action[a] = {squash_call(codec.squash, score)};",
            "}",
        ]
        return _function("decode", lines), ""
    for k, term in enumerate(codec.terms):
        if term.silent and term.lag:
            resets += _declare_late(k, term, out)
        adds += _add(k, term, layers[term.layer], out)
    lines = [
        "@prefix@_layer_t view;",
        f"int32_t score[{scores}];",
        "uint32_t a;",
        "uint32_t n;",
        f"for (a = 0u; a < {scores}u; a++) {{",
        f"    score[a] = {bias};",
        "}",
        *adds,
        *_act(codec),
    ]
    return _function("decode", lines), "\n".join(f"    {line}" for line in resets)


def _one_to_one(codec: Int16Codec) -> bool:
    """Return True if each score is a bias and one membrane as it is now."""
    if codec.chooses or len(codec.terms) != 1:
        return False
    (term,) = codec.terms
    square = term.weight.shape[0] == term.weight.shape[1]
    return bool(
        square
        and term.silent
        and not term.lag
        and not (term.weight - np.diag(np.diag(term.weight))).any()
    )


def _function(name: str, lines: list[str]) -> str:
    body = "\n".join(f"    {line}" for line in lines)
    return f"static void {name}(int16_t *action)\n{{\n{body}\n}}\n\n"


def _act(codec: Int16Codec) -> list[str]:
    scores = len(codec.bias)
    if not codec.chooses:
        value = squash_call(codec.squash, "score[a]")
        return [f"for (a = 0u; a < {scores}u; a++) {{", f"    action[a] = {value};", "}"]
    return [
        "n = 0u;",
        f"for (a = 1u; a < {scores}u; a++) {{",
        "    n = (score[a] > score[n]) ? a : n;",
        "}",
        "action[0] = (int16_t)n;",
    ]


def _declare_late(k: int, term: Int16Term, out: Declarations) -> list[str]:
    """Memory for membranes that are read late, and its reset."""
    out.variable(f"late{k}", "@prefix@_int_t", term.lag, len(term.weight))
    out.variable(f"late{k}_at", "uint32_t")
    return [
        f"late{k}_at = 0u;",
        f"for (k = 0u; k < {term.lag * len(term.weight)}u; k++) {{",
        f"    late{k}[k / {len(term.weight)}u][k % {len(term.weight)}u] = 0;",
        "}",
    ]


def _add(k: int, term: Int16Term, layer: int, out: Declarations) -> list[str]:
    """C that adds what a layer says to the scores."""
    late = 0 if term.silent else term.lag
    lines = [f"@prefix@_net_layer({layer}u, {late}u, &view);"]
    if not term.silent:
        body = _weigh(k, term, "1", "view.id[n]", out)
        return [*lines, "for (n = 0u; n < view.count; n++) {", *body, "}"]
    value = f"late{k}[late{k}_at][n]" if term.lag else "view.membrane[n]"
    dropped = f"({value} >> {term.drop})" if term.drop else value
    lines += [f"for (n = 0u; n < {len(term.weight)}u; n++) {{"]
    lines += _weigh(k, term, dropped, "n", out)
    if term.lag:
        lines.append(f"    {value} = view.membrane[n];")
    lines.append("}")
    return [*lines, *([f"late{k}_at = (late{k}_at + 1u) % {term.lag}u;"] if term.lag else [])]


def _weigh(k: int, term: Int16Term, value: str, index: str, out: Declarations) -> list[str]:
    """C that adds a value times the weights of neuron `index`."""
    rows, columns = np.nonzero(term.weight)
    if (np.bincount(rows, minlength=len(term.weight)) == 1).all():
        weight = out.per_neuron(f"read{k}_weight", term.weight[rows, columns], index, "int32_t")
        same = (columns - rows == columns[0]).all()
        place = index if same and not columns[0] else f"{index} + {columns[0]}u"
        if not same:
            place = out.per_neuron(f"read{k}_score", columns, index, "uint32_t")
        factor = "" if value == "1" else f"{value} * "
        return [f"    score[{place}] += {factor}{weight};"]
    first = out.constant(f"read{k}_first", np.searchsorted(rows, np.arange(len(term.weight) + 1)))
    target = out.constant(f"read{k}_score", columns)
    weight = out.constant(f"read{k}_weight", term.weight[rows, columns])
    factor = "" if value == "1" else "value * "
    held = [] if value == "1" else [f"    const int32_t value = {value};"]
    return [
        *held,
        f"    for (a = {first}[{index}]; a < {first}[({index}) + 1u]; a++) {{",
        f"        score[{target}[a]] += {factor}{weight}[a];",
        "    }",
    ]


def selftest_files(
    observation: Integers, action: Integers, common: Mapping[str, str]
) -> dict[str, str]:
    """The self-test of the interface; observations (S, obs), and the actions (S, act) of them."""
    out = Declarations()
    out.constant("vector_observation_i16", observation, "int16_t")
    out.constant("vector_action_i16", action, "int16_t")
    head = f"/* {common['mark']} */\n#include <stdint.h>\n\n#define VECTOR_STEPS {len(action)}u\n"
    return {
        "selftest_i16.c": fill(template("selftest_i16.c"), common),
        "vectors_i16.h": f"{head}\n{out.text}\n",
    }
