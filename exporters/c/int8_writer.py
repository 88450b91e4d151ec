"""An 8-bit network as C: loops that keep sums in registers; of pruned layers what is left.

Where the compiler has the packed multiplication of ARM's DSP extension (two products of 16 bits and
their sum in one instruction), weights are read in pairs; the integers are the same.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, literal, narrowest_of
from spikedeploy.exporters.c.int8_mlp import Int8Layer, Int8Mlp
from spikedeploy.exporters.c.int16_writer import (
    host_file,
    interface_gaps,
    selftest_files,
    squashed,
    tanh_gaps,
)
from spikedeploy.exporters.c.packaging import Interface, package_files, package_names
from spikedeploy.exporters.c.refusals import check_prefix
from spikedeploy.exporters.c.templates import filled, template
from spikedeploy.exporters.c.to_c import MARK, printable

Integers = NDArray[np.int64]

_BLOCK = 9  # outputs whose sums a core keeps in registers, at most
_STRAIGHT = 4096  # weights of a pruned network that are written as statements of their own
_DENSE = 0.5  # part of the weights that are not 0, above which all are computed
_INT16 = 2**15 - 1


@dataclass(frozen=True)
class DenseFiles:
    """C of a network.

    text: of each file, by name.
    rom, ram: constants and variables [bytes]; code comes on top, which holds the weights where
        they are statements.
    """

    text: dict[str, str]
    rom: int
    ram: int


def dense_names(prefix: str) -> tuple[str, ...]:
    """The files that an export with this prefix writes."""
    own = (f"{prefix}_i16.h", f"{prefix}.c", "host_i16.c")
    every = (*own, "selftest_i16.c", "vectors_i16.h", "Makefile")
    return (*every, *package_names(prefix))


def mlp_in_c(
    network: Int8Mlp, observation: NDArray[np.float64], origin: str, prefix: str = "policy"
) -> DenseFiles:
    """C of a quantised network; observation: (S, obs) of the self-test."""
    check_prefix(prefix)
    choices = network.scores if network.chooses else 0
    common = {
        "mark": MARK,
        "origin": printable(origin),
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "observations": str(len(network.observations.exponent)),
        **interface_gaps(network.actions, choices),
        "net_call": _NET_CALL,
        "scores": str(network.scores),
    }
    out = Declarations()
    rows = network.observations.quantise(observation)
    text = {
        f"{prefix}_i16.h": filled(template("policy_i16.h"), common),
        f"{prefix}.c": filled(template("dense_i16.c"), {**common, **_gaps(network, out)}),
        "host_i16.c": host_file(network.observations, common, prefix),
        **selftest_files(rows, network.act(rows), common),
        "Makefile": filled(template("dense.mk"), common),
        **package_files(Interface(network.observations, False, choices, network.actions), common),
    }
    names = dense_names(prefix)
    return DenseFiles({name: text[name] for name in names}, out.rom, out.ram)


_NET_CALL = """
/* The network alone: the sums of its last layer. */
void @prefix@_net_i16(const int16_t observation[@PREFIX@_OBSERVATIONS], int32_t score[@scores@]);
"""


def _gaps(network: Int8Mlp, out: Declarations) -> dict[str, str]:
    """What the template leaves open."""
    count = len(network.layers)
    functions, calls, place = [], [], "observation"
    fractions = {each.fraction for each in network.layers[:-1] if each.activation == "tanh"}
    hidden_tanh = "".join(_hidden_tanh(fraction, out) for fraction in sorted(fractions))
    for k, layer in enumerate(network.layers):
        last = k == count - 1
        functions.append(_layer(k, layer, last, network.weights <= _STRAIGHT, out))
        if not last:
            calls.append(f"    int16_t hidden{k}[{len(layer.bias)}];")
    for k in range(count):
        target = "score" if k == count - 1 else f"hidden{k}"
        calls.append(f"    layer{k}({place}, {target});")
        place = target
    final = network.layers[-1]
    squash = "argmax" if network.chooses else ("tanh" if final.activation == "tanh" else "none")
    return {
        "weights": str(network.weights),
        "tanh": tanh_gaps(squash, final.fraction, out),
        "layers": hidden_tanh + "\n".join(functions),
        "net": "\n".join(calls),
        "act": _act(network, squash),
        "chosen": "    uint32_t chosen = 0u;" if network.chooses else "",
        "declarations": out.text,
    }


def _hidden_tanh(fraction: int, out: Declarations) -> str:
    """Write tanh of hidden sums, under a name of its own."""
    return tanh_gaps("tanh", fraction, out).replace("tanh_q15", f"hidden_tanh{fraction}")


def _act(network: Int8Mlp, squash: str) -> str:
    loop = f"    for (a = 0u; a < {network.scores}u; a++) {{"
    if not network.chooses:
        return f"{loop}\n        action[a] = {squashed(squash, 'score[a]')};\n    }}"
    lines = [loop, "        chosen = (score[a] > score[chosen]) ? a : chosen;", "    }"]
    return "\n".join([*lines, "    action[0] = (int16_t)chosen;"])


def _layer(k: int, layer: Int8Layer, last: bool, straight: bool, out: Declarations) -> str:
    """The function of a layer, with a second body where weights can be read in pairs.

    straight: whether the weights of a pruned layer are statements.
    """
    kind = "int32_t" if last else "int16_t"
    factors = layer.factors
    nonzero = np.count_nonzero(factors)
    if nonzero <= _DENSE * factors.size:
        body = _statements(layer, last) if straight else _lists(k, layer, last, out)
    else:
        body = _rows(layer, last)
        if int(np.abs(factors).max()) <= _INT16:
            body = ["#ifdef @PREFIX@_PAIRS", *_pairs(layer, last), "#else", *body, "#endif"]
    shown = [line if line.startswith("#") or not line else f"    {line}" for line in body]
    return "\n".join([f"static void layer{k}(const int16_t *x, {kind} *y)", "{", *shown, "}", ""])


def _blocks(layer: Int8Layer) -> list[range]:
    """Outputs, up to nine at a time, in blocks as even as can be."""
    size = len(layer.bias)
    ends = np.linspace(0, size, -(-size // _BLOCK) + 1).round().astype(int).tolist()
    return [range(first, end) for first, end in pairwise(ends)]


def _statements(layer: Int8Layer, last: bool) -> list[str]:
    """One statement for each weight that is not 0."""
    lines, factors = [], layer.factors
    for block in _blocks(layer):
        lines.append("{")
        lines += [
            f"    int32_t a{j - block[0]} = {literal(int(layer.bias[j]), 'int32_t')};"
            for j in block
        ]
        lines.append("    int32_t in;")
        for i, row in enumerate(factors):
            used = [j for j in block if row[j]]
            if used:
                lines.append(f"    in = x[{i}];")
                lines += [f"    a{j - block[0]} += in * {int(row[j])};" for j in used]
        lines += [f"    y[{j}] = {_after(layer, f'a{j - block[0]}', last)};" for j in block]
        lines.append("}")
    return lines


def _after(layer: Int8Layer, value: str, last: bool) -> str:
    """C for what a layer hands on of a sum."""
    if last:
        return value
    if layer.activation == "tanh":
        return f"hidden_tanh{layer.fraction}({value})"
    return f"(int16_t)(({value} < 0) ? 0 : ({value} >> {layer.drop}))"


def _lists(k: int, layer: Int8Layer, last: bool, out: Declarations) -> list[str]:
    """The weights of each output that are not 0 as lists."""
    factors = layer.factors.T
    rows, columns = np.nonzero(factors)
    bias = out.constant(f"bias{k}", layer.bias, "int32_t")
    first = out.constant(f"first{k}", np.searchsorted(rows, np.arange(len(factors) + 1)))
    source = out.constant(f"source{k}", columns)
    weight = out.constant(f"weight{k}", factors[rows, columns])
    return [
        "uint32_t i;",
        "uint32_t j;",
        f"for (j = 0u; j < {len(factors)}u; j++) {{",
        f"    int32_t a = {bias}[j];",
        f"    for (i = {first}[j]; i < {first}[j + 1u]; i++) {{",
        f"        a += (int32_t)x[{source}[i]] * {weight}[i];",
        "    }",
        f"    y[j] = {_after(layer, 'a', last)};",
        "}",
    ]


def _rows(layer: Int8Layer, last: bool) -> list[str]:
    """All weights as a loop over the inputs, with the sums of a block of outputs in registers."""
    factors = layer.factors
    own = Declarations()
    blocks = _blocks(layer)
    table = np.concatenate([factors[:, each.start : each.stop].ravel() for each in blocks])
    kind = narrowest_of(factors)
    own.constant("weights", table, kind)
    lines = [*own.lines, f"const {kind} *w = weights;", "uint32_t i;"]
    for each in blocks:
        names = [f"a{j - each.start}" for j in each]
        bias = [literal(int(layer.bias[j]), "int32_t") for j in each]
        lines += [
            "{",
            *(f"    int32_t {n} = {b};" for n, b in zip(names, bias, strict=True)),
            f"    for (i = 0u; i < {len(factors)}u; i++) {{",
            "        const int32_t in = x[i];",
            *(f"        {n} += in * w[{k}];" for k, n in enumerate(names)),
            f"        w += {len(each)};",
            "    }",
            *(f"    y[{j}] = {_after(layer, n, last)};" for j, n in zip(each, names, strict=True)),
            "}",
        ]
    return lines


def _pairs(layer: Int8Layer, last: bool) -> list[str]:
    """The same with two products and their sum in one instruction."""
    factors = layer.factors
    odd = len(factors) % 2
    padded = np.concatenate([factors, np.zeros((odd, factors.shape[1]), np.int64)])
    both = (padded[::2] & 0xFFFF) | ((padded[1::2] & 0xFFFF) << 16)
    both = np.where(both >= 2**31, both - 2**32, both)
    own, blocks = Declarations(), _blocks(layer)
    table = np.concatenate([both[:, each.start : each.stop].ravel() for each in blocks])
    own.constant("pairs", table, "int32_t")
    lines = [*own.lines, "const int32_t *w = pairs;", "int32_t in;", "uint32_t i;"]
    for each in blocks:
        names = [f"a{j - each.start}" for j in each]
        bias = [literal(int(layer.bias[j]), "int32_t") for j in each]
        lines += [
            "{",
            *(f"    int32_t {n} = {b};" for n, b in zip(names, bias, strict=True)),
            f"    for (i = 0u; i < {len(factors) // 2}u; i++) {{",
            "        in = pair_at(&x[2u * i]);",
            *(f"        {n} = __smlad(in, w[{k}], {n});" for k, n in enumerate(names)),
            f"        w += {len(each)};",
            "    }",
        ]
        if odd:
            lines.append(f"    in = x[{len(factors) - 1}];")
            lines += [f"    {n} += in * (int16_t)w[{k}];" for k, n in enumerate(names)]
            lines.append(f"    w += {len(each)};")
        lines += [
            f"    y[{j}] = {_after(layer, n, last)};" for j, n in zip(each, names, strict=True)
        ]
        lines.append("}")
    return [*lines, "(void)w;"]
