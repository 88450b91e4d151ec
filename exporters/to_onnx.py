"""A float policy as one ONNX file, with its normaliser and its provenance.

Spiking policies are written by spiking_onnx, with their states.

    observation (B, obs) -> normalise, clip -> Gemm, Relu ... -> Gemm, Tanh -> action
                                                             -> Gemm -> logits

The first output is the action, or for discrete actions the logits: the largest is taken, while
training sampled from their softmax. The other outputs are the inputs of the weight matrices, in
order, from which effective operations are counted; ONNX Runtime computes them only on request.
"""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from spikedeploy.exporters.onnx_graph import OUTPUTS, OnnxGraph, Value
from spikedeploy.exporters.spiking_onnx import spiking_to_onnx
from spikedeploy.exporters.to_nir import artifact
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.policies import MlpPolicy, Policy, PrunedMlpPolicy

_KINDS = ("ann", "control")
_Float = MlpPolicy | PrunedMlpPolicy


def to_onnx(policy: Policy, origin: Provenance, path: str | Path, kind: str = "ann") -> Path:
    """Write the policy to `path` and return it; `kind` is that of a float one in comparisons."""
    path = Path(path)
    if not isinstance(policy, _Float):
        return spiking_to_onnx(artifact(policy, origin), path)
    if kind not in _KINDS:
        raise ConfigError(f"kind {kind!r} is unknown; it is one of {', '.join(_KINDS)}")
    graph, counts = OnnxGraph(), _fan_outs(policy)
    _add_policy(graph, policy)
    more: dict[str, str] = {}
    if not isinstance(policy, MlpPolicy):
        listed = [[int(n) for n in each] for each in counts]
        more["fan_out"] = json.dumps(listed, separators=(",", ":"))
    properties = {
        "env": origin.env,
        "recipe": origin.recipe,
        "seed": str(origin.seed),
        "steps": str(origin.steps),
        "kind": kind,
        "head": policy.head,
        "name": path.stem,
        "macs": str(sum(int(each.sum()) for each in counts)),
        "created": origin.created,
        "version": origin.version,
        "sha256": graph.sha256(),
        **({"checkpoint": origin.checkpoint} if origin.checkpoint else {}),
        **more,
    }
    return graph.write(path, policy.observations, policy.actions, policy.head, properties)


def _fan_outs(policy: _Float) -> list[Tensor]:
    """Weights that are left of each input (M,) of each matrix; the skip's with the first."""
    if isinstance(policy, MlpPolicy):
        weights = [layer.get_parameter("weight") for layer in policy.layers]
        return [weight.new_full(weight.shape[1:], len(weight)) for weight in weights]
    first, *others = (matrix.fan_out for matrix in policy.layers)
    return [first + policy.past.fan_out if policy.skip else first, *others]


def _layers(policy: _Float) -> list[tuple[Tensor, Tensor]]:
    """Weights (out, in) and biases of the layers."""
    if isinstance(policy, MlpPolicy):
        return [(a.get_parameter("weight"), a.get_parameter("bias")) for a in policy.layers]
    both = zip(policy.layers, policy.biases, strict=True)
    return [(matrix(), bias) for matrix, bias in both]


def _add_policy(graph: OnnxGraph, policy: _Float) -> None:
    """Add the normaliser, the layers, the skip connection, and the output."""
    seen = _add_normaliser(graph, policy)
    layers = _layers(policy)
    *others, last = layers
    hidden = seen
    for number, layer in enumerate(others, start=1):
        hidden = graph.node(
            "Relu", _add_affine(graph, hidden, *layer, number), name=f"hidden{number}"
        )
    sums = _add_affine(graph, hidden, *last, len(layers))
    if not isinstance(policy, MlpPolicy) and policy.skip:
        sums = sums + seen @ graph.constant(_array(policy.past().T), "skip_weight")
    squash = "Identity" if policy.head == "discrete" else "Tanh"
    graph.node(squash, sums, name=OUTPUTS[policy.head])


def _add_normaliser(graph: OnnxGraph, policy: Policy) -> Value:
    """Add the normaliser; a reader of the file finds its numbers by name."""
    normaliser = policy.normalizer
    mean = graph.constant(_array(normaliser.mean), "mean")
    std = graph.constant(_array(normaliser.std), "std")
    limits = [
        graph.constant(-normaliser.clip, "lowest"),
        graph.constant(normaliser.clip, "highest"),
    ]
    # x = clip((obs - mean) / std)
    return graph.node("Clip", (graph.observation - mean) / std, *limits)


def _add_affine(
    graph: OnnxGraph, hidden: Value, weight: Tensor, bias: Tensor, number: int
) -> Value:
    """Add weights (out, in) and biases of a layer."""
    graph.presynaptic(hidden, weight.shape[1])
    matrix = graph.constant(_array(weight), f"weight{number}")
    return graph.node(
        "Gemm", hidden, matrix, graph.constant(_array(bias), f"bias{number}"), transB=1
    )


def _array(tensor: Tensor) -> NDArray[np.float32]:
    array: NDArray[np.float32] = tensor.detach().cpu().float().numpy()
    return array
