"""An 8-bit network as C: one statement for each weight, or loops where there are many.

Where the compiler has the packed multiplication of ARM's DSP extension (two products of 16 bits and
their sum in one instruction), weights are read in pairs; the integers are the same.
"""

from dataclasses import dataclass

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
from spikedeploy.exporters.c.refusals import check_prefix
from spikedeploy.exporters.c.templates import filled, template
from spikedeploy.exporters.c.to_c import MARK, printable

Integers = NDArray[np.int64]

_BLOCK = 8  # outputs whose sums a core keeps in registers
_STRAIGHT = 4096  # weights of a network that are written as statements of their own
_PAIRED = 0.5  # part of the weights that are not 0, from which pairs take fewer instructions
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
    return (*own, "selftest_i16.c", "vectors_i16.h", "Makefile")


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
    """tanh of hidden sums, under a name of its own."""
    return tanh_gaps("tanh", fraction, out).replace("tanh_q15", f"hidden_tanh{fraction}")


def _act(network: Int8Mlp, squash: str) -> str:
    loop = f"    for (a = 0u; a < {network.scores}u; a++) {{"
    if not network.chooses:
        return f"{loop}\n        action[a] = {squashed(squash, 'score[a]')};\n    }}"
    lines = [loop, "        chosen = (score[a] > score[chosen]) ? a : chosen;", "    }"]
    return "\n".join([*lines, "    action[0] = (int16_t)chosen;"])


def _layer(k: int, layer: Int8Layer, last: bool, straight: bool, out: Declarations) -> str:
    """The function of a layer, with a second body for pairs where that is shorter.

    straight: whether weights are statements.
    """
    kind = "int32_t" if last else "int16_t"
    factors = layer.factors
    nonzero = np.count_nonzero(factors)
    body = _statements(layer, last) if straight else _loops(k, layer, last, out)
    paired = nonzero > _PAIRED * factors.size and int(np.abs(factors).max()) <= _INT16
    if paired:
        pairs = _pairs(k, layer, last)
        body = ["#ifdef @PREFIX@_PAIRS", *pairs, "#else", *body, "#endif"]
    shown = [line if line.startswith("#") or not line else f"    {line}" for line in body]
    return "\n".join([f"static void layer{k}(const int16_t *x, {kind} *y)", "{", *shown, "}", ""])


def _blocks(layer: Int8Layer) -> list[range]:
    size = len(layer.bias)
    return [range(first, min(first + _BLOCK, size)) for first in range(0, size, _BLOCK)]


def _statements(layer: Int8Layer, last: bool) -> list[str]:
    """One statement for each weight that is not 0."""
    lines, factors = [], layer.factors
    for block in _blocks(layer):
        lines.append("{")
        lines += [f"    int32_t a{j - block[0]} = {literal(int(layer.bias[j]), 'int32_t')};" for j in block]
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


def _loops(k: int, layer: Int8Layer, last: bool, out: Declarations) -> list[str]:
    """The same as loops over the outputs, with weights in a table; as lists where many are 0."""
    factors = layer.factors.T
    bias = out.constant(f"bias{k}", layer.bias, "int32_t")
    size, width = factors.shape
    lines = ["uint32_t i;", "uint32_t j;", f"for (j = 0u; j < {size}u; j++) {{"]
    lines.append(f"    int32_t a = {bias}[j];")
    if np.count_nonzero(factors) > _PAIRED * factors.size:
        weight = out.constant(f"weight{k}", factors)
        kind = narrowest_of(factors)
        lines += [
            f"    const {kind} *w = &{weight}[j * {width}u];",
            f"    for (i = 0u; i < {width}u; i++) {{",
            "        a += (int32_t)x[i] * w[i];",
            "    }",
        ]
    else:
        rows, columns = np.nonzero(factors)
        first = out.constant(f"first{k}", np.searchsorted(rows, np.arange(size + 1)))
        source = out.constant(f"source{k}", columns)
        weight = out.constant(f"weight{k}", factors[rows, columns])
        lines += [
            f"    for (i = {first}[j]; i < {first}[j + 1u]; i++) {{",
            f"        a += (int32_t)x[{source}[i]] * {weight}[i];",
            "    }",
        ]
    return [*lines, f"    y[j] = {_after(layer, 'a', last)};", "}"]


def _pairs(k: int, layer: Int8Layer, last: bool) -> list[str]:
    """The same with two products in one instruction; its table is declared inside."""
    factors = layer.factors
    width = len(factors) + len(factors) % 2
    padded = np.zeros((width, factors.shape[1]), np.int64)
    padded[: len(factors)] = factors
    both = (padded[::2] & 0xFFFF) | ((padded[1::2] & 0xFFFF) << 16)
    both = np.where(both >= 2**31, both - 2**32, both)
    own, lines = Declarations(), []
    table = np.concatenate([both[:, block.start : block.stop].ravel() for block in _blocks(layer)])
    own.constant("pairs", table, "int32_t")
    lines += own.lines
    lines += ["const int32_t *w = pairs;", "uint32_t i;"]
    whole = len(factors) // 2
    for block in _blocks(layer):
        each = [f"        a{n} = __smlad(in, w[{n}], a{n});" for n in range(len(block))]
        lines += [
            "{",
            *(f"    int32_t a{j - block[0]} = {literal(int(layer.bias[j]), 'int32_t')};" for j in block),
            "    int32_t in;",
            f"    for (i = 0u; i < {whole}u; i++) {{",
            "        in = pair_at(&x[2u * i]);",
            *each,
            f"        w += {len(block)};",
            "    }",
        ]
        if len(factors) % 2:
            lines += [f"    in = x[{len(factors) - 1}];", *(line[4:].replace(
                "__smlad(in, w", "__smlad(in & 0xFFFF, w") for line in each), f"    w += {len(block)};"]
        lines += [f"    y[{j}] = {_after(layer, f'a{j - block[0]}', last)};" for j in block]
        lines.append("}")
    return [*lines, "(void)w;"]
