"""A float network quantised to 8-bit weights: the specification that C of it equals bit for bit.

Each layer is  acc = bias + sum_i x_i (w_i 2**k_i)  in 32 bits, with x of 16 bits, w of 8 bits, and
for each input a power of two k_i >= 0 that makes the most of its eight bits. The
normaliser is folded into the first layer; the caller that converts observations applies its clip
(`Int16Observations`).
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.int16 import (
    LARGEST,
    LEAST_FRACTION,
    Int16Observations,
    linear_q15,
    tanh_q15,
)
from spikedeploy.runtime.codec.codec import Normaliser
from spikedeploy.runtime.errors import ArtifactError, ConfigError

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


Activation = Literal["relu", "tanh", "none"]

_WEIGHT = 127
_ACCUMULATED = 2**30  # largest magnitude of a sum: half of what 32 bits hold
_BLOCK = 9  # outputs whose sums a core keeps in registers, at most
_DENSE = 0.5  # part of the weights that are not 0, above which all are computed
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

    @property
    def is_dense(self) -> bool:
        """True if most weights are not 0, so that all are computed."""
        return bool(np.count_nonzero(self.weight) > _DENSE * self.weight.size)

    @property
    def blocks(self) -> list[range]:
        """Outputs, up to nine at a time, in blocks as even as can be."""
        size = len(self.bias)
        ends = np.linspace(0, size, -(-size // _BLOCK) + 1).round().astype(int).tolist()
        return [range(first, end) for first, end in pairwise(ends)]

    def by_block(self, values: Integers) -> Integers:
        """Return values (..., out) of one block after another."""
        return np.concatenate([values[:, each.start : each.stop].ravel() for each in self.blocks])

    @property
    def pairs(self) -> Integers | None:
        """Factors (in / 2, out) of two inputs in one number of 32 bits; None where 16 do not do."""
        factors = self.factors
        if int(np.abs(factors).max()) > LARGEST:
            return None
        padded = np.pad(factors, ((0, len(factors) % 2), (0, 0))) & 0xFFFF
        both = padded[::2] | (padded[1::2] << 16)
        return np.where(both >= 2**31, both - 2**32, both)

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

    @property
    def hidden_tanh(self) -> list[int]:
        """Fractions of the hidden layers whose activation is tanh."""
        return sorted({each.fraction for each in self.layers[:-1] if each.activation == "tanh"})

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


def quantise(policy: FloatMlp) -> Int8Mlp:
    """The network in 8-bit weights."""
    observations, normaliser = (
        Int16Observations.from_normaliser(policy.normaliser),
        policy.normaliser,
    )
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

    session(path)  # refuses what is damaged, larger than it says, or of shapes that do not fit
    model = onnx.load(path)
    said = {entry.key: entry.value for entry in model.metadata_props}
    nodes = list(model.graph.node)
    kinds, layers = [node.op_type for node in nodes], nodes[3:]
    fits = kinds[:3] == ["Sub", "Div", "Clip"] and len(kinds) >= 5 and len(kinds) % 2 == 1
    if not (
        fits
        and all(map(_is_affine, layers[::2]))
        and set(kinds[4:-1:2]) <= {"Relu", "Tanh"}
        and kinds[-1] in ("Tanh", "Identity")
    ):
        raise ConfigError(
            f"--to c: {path.name} computes {' '.join(kinds[:8])} ...; C of float networks is "
            "written for a scaled and clipped observation before affine layers (Gemm) with Relu, "
            "Tanh or Identity. Export a policy such as mlp-8."
        )
    value = {e.name: numpy_helper.to_array(e).astype(float) for e in model.graph.initializer}
    try:
        mean, std = (value[node.input[1]] for node in nodes[:2])
        low, high = (float(value[name]) for name in nodes[2].input[1:3])
        weights = tuple(value[node.input[1]].T for node in layers[::2])
        biases = tuple(value[node.input[2]].reshape(-1) for node in layers[::2])
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ArtifactError(
            f"{path} lacks a constant that its graph names. Export it again"
        ) from error
    sizes = [(weight.shape[1], bias.size) for weight, bias in zip(weights, biases, strict=True)]
    finite = all(np.isfinite(each).all() for each in (*weights, *biases))
    if low != -high or not finite or any(outputs != size for outputs, size in sizes):
        raise ConfigError(
            f"--to c: {path.name} clips unevenly, or has weights or biases that are no numbers, or "
            "biases of another size"
        )
    chooses = said.get("head") == "discrete" or model.graph.output[0].name == "logits"
    activations = tuple(_ACTIVATIONS[kind] for kind in kinds[4::2])
    return FloatMlp(Normaliser(mean, std, high), weights, biases, activations, chooses)


def _is_affine(node: Any) -> bool:  # noqa: ANN401
    """Return True for x W^T + b."""
    options = {each.name: each.i if each.type == 2 else each.f for each in node.attribute}
    expected = {"transB": 1, "alpha": 1.0, "beta": 1.0, "transA": 0}
    wanted = all(expected.get(name) == option for name, option in options.items())
    return node.op_type == "Gemm" and wanted and "transB" in options
