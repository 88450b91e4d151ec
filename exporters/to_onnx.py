"""A float policy as one ONNX file, with its normaliser and its provenance.

What spikes is written by spiking_onnx, with its states.

observation (B, obs) -> features -> normalise, clip -> Gemm, Relu ... -> Gemm, Tanh -> action
                                                                     -> Gemm -> logits

The first output is the action, or for discrete actions the logits: the largest is taken, while
training sampled from their softmax. The other outputs are the inputs of the weight matrices, in
order, from which effective operations are counted; ONNX Runtime computes them only on request.
"""

import json
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.exporters.spiking_onnx import OBSERVATION, OUTPUTS, OnnxGraph, spiking_to_onnx
from spikedeploy.exporters.to_nir import artifact
from spikedeploy.files import replacing
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies import MlpPolicy, Policy, PrunedMlpPolicy
from spikedeploy.trainers.policies.mlp import Features

_KINDS = ("ann", "control")


def to_onnx(policy: Policy, origin: Provenance, path: str | Path, kind: str = "ann") -> Path:
    """Write the policy to `path` and return it; `kind` is that of a float one in comparisons."""
    if not isinstance(policy, MlpPolicy | PrunedMlpPolicy):
        return spiking_to_onnx(artifact(policy, origin), path)
    if kind not in _KINDS:
        raise ConfigError(f"kind {kind!r} is unknown; it is one of {', '.join(_KINDS)}")
    path = Path(path)
    model = _model(policy, origin, path.stem, kind)
    with replacing(path) as temporary:
        temporary.write_bytes(model.SerializeToString(deterministic=True))
    return path


def _macs(policy: MlpPolicy | PrunedMlpPolicy) -> int:
    """Multiply-accumulates of one inference: one for each weight that is left."""
    if isinstance(policy, PrunedMlpPolicy):
        return sum(int(counts.sum()) for counts in _fan_outs(policy))
    return sum(layer.get_parameter("weight").numel() for layer in policy.layers)


def _fan_outs(policy: PrunedMlpPolicy) -> list[Tensor]:
    """Weights that are left of each input (M,) of each matrix; the skip's with the first."""
    first, *others = (matrix.fan_out for matrix in policy.layers)
    return [first + policy.past.fan_out if policy.skip else first, *others]


def _model(
    policy: MlpPolicy | PrunedMlpPolicy, origin: Provenance, name: str, kind: str
) -> onnx.ModelProto:
    graph = OnnxGraph()
    pruned: dict[str, str] = {}
    if isinstance(policy, PrunedMlpPolicy):
        _pruned_layers(graph, policy, _add_normaliser(graph, policy, OBSERVATION))
        counts = [[int(n) for n in each] for each in _fan_outs(policy)]
        pruned = {"fan_out": json.dumps(counts, separators=(",", ":"))}
    else:
        _layers(graph, policy, _add_normaliser(graph, policy, _features(graph, policy.features)))
    properties = {
        "env": origin.env,
        "recipe": origin.recipe,
        "seed": str(origin.seed),
        "steps": str(origin.steps),
        "kind": kind,
        "head": policy.head,
        "name": name,
        "macs": str(_macs(policy)),
        "created": origin.created,
        "version": origin.version,
        "sha256": graph.sha256(),
        **({"checkpoint": origin.checkpoint} if origin.checkpoint else {}),
        **pruned,
    }
    return graph.model(policy.observations, policy.actions, policy.head, properties)


def _features(graph: OnnxGraph, features: Features) -> str:
    """Add the features of the policy; return their name."""
    if features.name == "all":
        return OBSERVATION
    if features.name == "phase":
        columns = graph.constant("phase_index", features.phase)
        return graph.node("Gather", [OBSERVATION, columns], "features", axis=1)
    if features.name in ("bilinear", "fourier"):
        return _products(graph, features)
    raise ConfigError(f"features {features.name!r} have no ONNX form; add it to {__name__}")


def _products(graph: OnnxGraph, features: Features) -> str:
    """Add the waves times {1, scales} without the constant; return its name."""
    waves = graph.node("Concat", _waves(graph, features), "waves", axis=1)
    groups = [waves]
    for number, scale in enumerate(_scales(graph, features), start=1):
        groups += [scale, graph.node("Mul", [scale, waves], f"modulated{number}")]
    return graph.node("Concat", groups, "features", axis=1)


def _scales(graph: OnnxGraph, features: Features) -> list[str]:
    """Add commands, errors and their products (B, 1); return their names."""
    names = [f"command{k}" for k in range(1, len(features.command) + 1)]
    names += [f"error{k}" for k in range(1, len(features.errors) + 1)]
    found = {
        column: graph.column(column, name)
        for column, name in zip(features.scales, names, strict=True)
    }
    pairs = [(found[one], found[other]) for one, other in features.pairs]
    products = [graph.node("Mul", pair, f"{pair[0]}_{pair[1]}") for pair in pairs]
    return [*found.values(), *products]


def _waves(graph: OnnxGraph, features: Features) -> list[str]:
    """Add sine and cosine (B, 1) of the phase, of its double and so on; return their names."""
    sine, cosine = (
        graph.column(k, wave) for k, wave in zip(features.phase, ("sine", "cosine"), strict=True)
    )
    # sin 2p = 2 sin p cos p ; cos 2p = cos^2 p - sin^2 p
    half = graph.node("Mul", [sine, cosine], "half_sine2")
    sine2 = graph.node("Add", [half, half], "sine2")
    squares = [graph.node("Mul", [wave, wave], f"{wave}_squared") for wave in (cosine, sine)]
    cosine2 = graph.node("Sub", squares, "cosine2")
    waves = [sine, cosine, sine2, cosine2]
    for number in range(3, features.harmonics + 1):
        waves += _next_wave(graph, number, waves)
    return waves


def _next_wave(graph: OnnxGraph, number: int, waves: list[str]) -> list[str]:
    """Add sine and cosine (B, 1) of `number` times the phase; return their names."""

    def product(last: str, first: str) -> str:
        return graph.node("Mul", [last, first], f"{last}_{first}")

    # sin (k+1)p = sin kp cos p + cos kp sin p ; cos (k+1)p = cos kp cos p - sin kp sin p
    sine, cosine, *_, last_sine, last_cosine = waves
    parts = [product(last_sine, cosine), product(last_cosine, sine)]
    others = [product(last_cosine, cosine), product(last_sine, sine)]
    return [
        graph.node("Add", parts, f"sine{number}"),
        graph.node("Sub", others, f"cosine{number}"),
    ]


def _add_normaliser(graph: OnnxGraph, policy: Policy, features: str) -> str:
    """Add the normaliser; return the name of its output."""
    normalizer = policy.normalizer
    mean = graph.constant("mean", _array(normalizer.mean))
    std = graph.constant("std", _array(normalizer.std))
    limits = [
        graph.constant("lowest", -normalizer.clip),
        graph.constant("highest", normalizer.clip),
    ]
    # x = clip((obs - mean) / std)
    shifted = graph.node("Sub", [features, mean], "shifted")
    scaled = graph.node("Div", [shifted, std], "scaled")
    return graph.node("Clip", [scaled, *limits], "normalised")


def _layers(graph: OnnxGraph, policy: MlpPolicy, hidden: str) -> None:
    """Add the network, up to its output."""
    for number, layer in enumerate(policy.layers, start=1):
        weight = graph.constant(f"weight{number}", _array(layer.get_parameter("weight")))
        graph.presynaptic(hidden, layer.get_parameter("weight").shape[1])
        bias = graph.constant(f"bias{number}", _array(layer.get_parameter("bias")))
        hidden = graph.node("Gemm", [hidden, weight, bias], f"affine{number}", transB=1)
        if number < len(policy.layers):
            hidden = graph.node("Relu", [hidden], f"hidden{number}")
    squash = "Identity" if policy.head == "discrete" else "Tanh"
    graph.node(squash, [hidden], OUTPUTS[policy.head])


def _pruned_layers(graph: OnnxGraph, policy: PrunedMlpPolicy, seen: str) -> None:
    """Add the network with its skip connection, up to its output."""
    hidden = seen
    pairs = zip(policy.layers, policy.biases, strict=True)
    for number, (matrix, bias) in enumerate(pairs, start=1):
        graph.presynaptic(hidden, matrix.weight.shape[1])
        weight = graph.constant(f"weight{number}", _array(matrix()))
        offset = graph.constant(f"bias{number}", _array(bias))
        hidden = graph.node("Gemm", [hidden, weight, offset], f"affine{number}", transB=1)
        if number < len(policy.layers):
            hidden = graph.node("Relu", [hidden], f"hidden{number}")
    if policy.skip:
        past = graph.constant("skip_weight", _array(policy.past().T))
        hidden = graph.node("Add", [hidden, graph.node("MatMul", [seen, past], "skip")], "sum")
    squash = "Identity" if policy.head == "discrete" else "Tanh"
    graph.node(squash, [hidden], OUTPUTS[policy.head])


def _array(tensor: Tensor) -> NDArray[np.float32]:
    array: NDArray[np.float32] = tensor.detach().cpu().float().numpy()
    return array
