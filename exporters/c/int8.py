"""A float network quantised to 8-bit weights: the specification that C of it equals bit for bit.

Each layer is  acc = bias + sum_i x_i (w_i 2**k_i)  in 32 bits, with x of 16 bits, w of 8 bits, and
for each input a power of two k_i >= 0 that makes the most of its eight bits. The
normaliser is folded into the first layer: its clip is that of the observations, which whoever
converts them keeps (`Int16Observations`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, literal, narrowest_of
from spikedeploy.exporters.c.int16 import (
    LARGEST,
    LEAST_FRACTION,
    Int16Observations,
    linear_q15,
    tanh_q15,
)
from spikedeploy.exporters.c.int16_writer import (
    host_file,
    interface_gaps,
    selftest_files,
    squash_call,
    tanh_gaps,
)
from spikedeploy.exporters.c.packaging import Interface, package_files, package_names
from spikedeploy.exporters.c.plan import check_prefix
from spikedeploy.exporters.c.templates import fill, template
from spikedeploy.exporters.c.to_c import MARK, printable
from spikedeploy.runtime.codec.codec import Normaliser
from spikedeploy.runtime.errors import ArtifactError, ConfigError

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


Activation = Literal["relu", "tanh", "none"]

_WEIGHT = 127
_ACCUMULATED = 2**30  # largest magnitude of a sum: half of what 32 bits hold
_ACTIVATIONS: dict[str, Activation] = {"Relu": "relu", "Tanh": "tanh", "Identity": "none"}


@dataclass(frozen=True, eq=False)
class FloatMlp:
    """A float network as its file has it: clip((x - mean) / std), then affine layers.

    weights: (in, out) each; biases: (out,) each; activations: after each layer.
    """

    normaliser: Normaliser
    weights: tuple[Floats, ...]
    biases: tuple[Floats, ...]
    activations: tuple[Activation, ...]
    chooses: bool


@dataclass(frozen=True, eq=False)
class Int8Layer:
    """acc = bias + sum_i x_i (weight_i 2**shift_i), and what becomes of it.

    weight: (in, out) within +-127.
    shift: (in,) power of two of each input.
    bias: (out,) in 2**-fraction, as acc is.
    activation: "relu": max(acc, 0) >> drop; "tanh": Q15; "none": acc itself.
    """

    weight: Integers
    shift: Integers
    bias: Integers
    fraction: int
    activation: Activation
    drop: int = 0

    @property
    def factors(self) -> Integers:
        """Weights (in, out) with their powers of two."""
        return self.weight << self.shift[:, None]

    def accumulate(self, x: Integers) -> Integers:
        """Sums (..., out) of inputs (..., in)."""
        return np.asarray(x @ self.factors + self.bias)

    def __call__(self, x: Integers) -> Integers:
        """Outputs (..., out) of inputs (..., in)."""
        acc = self.accumulate(x)
        if self.activation == "relu":
            return np.maximum(acc, 0) >> self.drop
        return tanh_q15(acc, self.fraction) if self.activation == "tanh" else acc


@dataclass(frozen=True, eq=False)
class Int8Mlp:
    """A quantised network: int16 observations to Q15 actions, or to an index."""

    observations: Int16Observations
    layers: tuple[Int8Layer, ...]
    chooses: bool

    @property
    def scores(self) -> int:
        """Numbers of the last layer."""
        return len(self.layers[-1].bias)

    @property
    def actions(self) -> int:
        """Numbers of an action."""
        return 1 if self.chooses else self.scores

    @property
    def weights(self) -> int:
        """Weights that are not 0."""
        return sum(int(np.count_nonzero(layer.weight)) for layer in self.layers)

    def act(self, o: Integers) -> Integers:
        """Actions (..., act) of int16 observations (..., obs)."""
        for layer in self.layers[:-1]:
            o = layer(o)
        last = self.layers[-1]
        acc = last.accumulate(o)
        if self.chooses:
            return np.asarray(acc.argmax(axis=-1)[..., None])
        squash = tanh_q15 if last.activation == "tanh" else linear_q15
        return squash(acc, last.fraction)

    def floats(self, action: Integers) -> NDArray[np.float64]:
        """Actions (..., act) as the environment takes them; an index stays one."""
        return action.astype(np.float64) if self.chooses else action / 2.0**15


def quantise(policy: FloatMlp) -> Int8Mlp:
    """The network in 8-bit weights."""
    observations, normaliser = Int16Observations.of(policy.normaliser), policy.normaliser
    mean, std = normaliser.mean.astype(np.float64), normaliser.std.astype(np.float64)
    # x = (o - centre) unit
    unit, centre = 2.0**-observations.exponent / std, mean * 2.0**observations.exponent
    largest = np.full(len(unit), LARGEST + 1)
    layers = []
    for k, activation in enumerate(policy.activations):
        weight = unit[:, None] * policy.weights[k]
        layer = _quantise_layer(weight, policy.biases[k], centre, largest, activation)
        layers.append(layer)
        centre = np.zeros(len(layer.bias))
        if activation == "tanh":
            unit, largest = np.full(len(layer.bias), 2.0**-15), np.full(len(layer.bias), LARGEST)
        else:
            reached = _bound_sums(layer, largest) >> layer.drop
            unit, largest = np.full(len(reached), 2.0 ** (layer.drop - layer.fraction)), reached
    return Int8Mlp(observations, tuple(layers), policy.chooses)


def _quantise_layer(
    weight: Floats, bias: Floats, centre: Floats, largest: Integers, activation: Activation
) -> Int8Layer:
    """A layer of real weights (in, out) of integer inputs, as fine as 32 bits let it be.

    centre: (in,) inputs at which the sums are the bias: there, rounding of weights changes nothing.
    largest: (in,) magnitudes of the inputs.
    """
    row = np.abs(weight).max(axis=1)
    total = float((np.abs(bias) + np.abs(weight).T @ (largest + np.abs(centre))).max()) or 1.0
    fraction = int(np.floor(np.log2(_ACCUMULATED / total)))
    if not LEAST_FRACTION <= fraction < 60:
        raise ConfigError(
            f"--to c: a layer sums up to {total:.3g}, which leaves {fraction} of 32 bits behind "
            f"the point; at least {LEAST_FRACTION} are needed. Scale its weights down."
        )
    with np.errstate(divide="ignore"):
        shift = np.ceil(np.log2(row * 2.0**fraction / _WEIGHT))
    shift = np.where(row > 0, np.maximum(shift, 0), 0).astype(np.int64)
    fixed = np.rint(weight * 2.0**fraction / 2.0 ** shift[:, None]).astype(np.int64)
    offset = np.rint(bias * 2.0**fraction - (centre * 2.0**shift) @ fixed).astype(np.int64)
    layer = Int8Layer(fixed, shift, offset, fraction, activation)
    if activation != "relu":
        return layer
    drop = max(0, int(_bound_sums(layer, largest).max()).bit_length() - 15)
    return Int8Layer(fixed, shift, offset, fraction, activation, drop)


def _bound_sums(layer: Int8Layer, largest: Integers) -> Integers:
    """Largest magnitude (out,) of the sums of a layer."""
    return np.asarray(np.abs(layer.bias) + largest @ np.abs(layer.factors))


def read_onnx(path: Path) -> FloatMlp:
    """The network in an ONNX file of our exporters; ConfigError where it is of another kind."""
    import onnx
    from onnx import numpy_helper

    from spikedeploy.trainers.onnx_session import session

    session(path)  # refuses what is damaged or larger than it says
    model = onnx.load(path)
    said = {entry.key: entry.value for entry in model.metadata_props}
    graph = model.graph
    kinds = [node.op_type for node in graph.node]
    if kinds[:3] != ["Sub", "Div", "Clip"] or not _alternates(kinds[3:]):
        raise ConfigError(
            f"--to c: {path.name} computes {' '.join(kinds[:8])} ...; C of float networks is "
            "written for a scaled and clipped observation before affine layers (Gemm) with Relu, "
            "Tanh or Identity. Export a policy such as mlp-8."
        )
    value: dict[str, Any] = {each.name: numpy_helper.to_array(each) for each in graph.initializer}
    try:
        affine = [_affine(node, value) for node in graph.node[3::2]]
        mean, std = (value[graph.node[k].input[1]].astype(np.float64) for k in (0, 1))
        low, high = (float(value[name]) for name in graph.node[2].input[1:3])
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ArtifactError(
            f"{path} lacks a constant that its graph names. Export it again"
        ) from error
    if low != -high:
        raise ConfigError(f"--to c: {path.name} clips from {low} to {high}, not evenly.")
    activations = [_ACTIVATIONS[kind] for kind in kinds[4::2]]
    if "none" in activations[:-1] or activations[-1] == "relu":
        raise ConfigError(f"--to c: {path.name} has activations {', '.join(activations)}.")
    weights, biases = zip(*affine, strict=True)
    _check_shapes(path, len(mean), weights)
    chooses = said.get("head") == "discrete" or graph.output[0].name == "logits"
    return FloatMlp(
        Normaliser(mean, std, high), tuple(weights), tuple(biases), tuple(activations), chooses
    )


def _alternates(kinds: Sequence[str]) -> bool:
    """Return True if affine maps and activations take turns."""
    return (
        len(kinds) >= 2
        and len(kinds) % 2 == 0
        and set(kinds[::2]) == {"Gemm"}
        and set(kinds[1::2]) <= set(_ACTIVATIONS)
    )


def _affine(node: Any, value: dict[str, Any]) -> tuple[Floats, Floats]:  # noqa: ANN401
    """Weight (in, out) and bias (out,) of a Gemm."""
    options = {each.name: each.i if each.type == 2 else each.f for each in node.attribute}
    if {options.get("alpha", 1.0), options.get("beta", 1.0)} != {1.0} or options.get("transA", 0):
        raise ConfigError("--to c: a Gemm with alpha, beta or transA is not written in C.")
    weight = value[node.input[1]].astype(np.float64)
    bias = value[node.input[2]].astype(np.float64)
    return (weight.T if options.get("transB", 0) else weight), bias.reshape(-1)


def _check_shapes(path: Path, observed: int, weights: Sequence[Floats]) -> None:
    """Refuse layers that do not follow one another."""
    width = observed
    for k, weight in enumerate(weights):
        if weight.ndim != 2 or weight.shape[0] != width or not np.isfinite(weight).all():
            raise ArtifactError(
                f"{path}: layer {k + 1} has a weight of shape {weight.shape}, and {width} inputs; "
                "all must be finite. Export it again"
            )
        width = weight.shape[1]


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
        f"{prefix}_i16.h": fill(template("policy_i16.h"), common),
        f"{prefix}.c": fill(template("dense_i16.c"), {**common, **_gaps(network, out)}),
        "host_i16.c": host_file(network.observations, common, prefix),
        **selftest_files(rows, network.act(rows), common),
        "Makefile": fill(template("dense.mk"), common),
        **package_files(Interface(network.observations, False, choices, network.actions), common),
    }
    names = dense_names(prefix)
    return DenseFiles({name: text[name] for name in names}, out.rom, out.ram)


_NET_CALL = """
/* The network alone: the sums of its last layer. */
void @prefix@_net_i16(const int16_t observation[@PREFIX@_OBSERVATIONS], int32_t score[@scores@]);
"""


def _gaps(network: Int8Mlp, out: Declarations) -> dict[str, str]:
    """Gaps of the template."""
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
        return f"{loop}\n        action[a] = {squash_call(squash, 'score[a]')};\n    }}"
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
