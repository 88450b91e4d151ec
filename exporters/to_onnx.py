"""A float policy as one ONNX file, with its normaliser and its provenance.

What spikes is written by spiking_onnx, with its states.

observation (B, obs) -> normalise, clip -> Gemm, Relu ... -> Gemm, Tanh -> action
                                                         -> Gemm -> logits

A pruned policy may have a memory, whose state goes in and out as spiking_onnx names it, and a path
past its layers.

    observation (B, obs) -> normalise, clip -> Gemm, Relu ... -> GRU -> Gemm -> logits

The first output is the action, or for discrete actions the logits: the largest is taken, while
training sampled from their softmax. The other outputs are the inputs of the weight matrices, in
order, from which effective operations are counted; ONNX Runtime computes them only on request.
States go out last.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from torch import Tensor, cat

from spikedeploy.exporters.spiking_onnx import OBSERVATION, OUTPUTS, OnnxGraph, spiking_to_onnx
from spikedeploy.exporters.to_nir import artifact
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import replacing
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.trainers.onnx_session import NEXT
from spikedeploy.trainers.policies import (
    MlpPolicy,
    Policy,
    PrunedGruPolicy,
    PrunedMlpPolicy,
)
from spikedeploy.trainers.policies.policy import PrunedWeight

_KINDS = ("ann", "control")
_Float = MlpPolicy | PrunedMlpPolicy | PrunedGruPolicy


def to_onnx(policy: Policy, origin: Provenance, path: str | Path, kind: str = "ann") -> Path:
    """Write the policy to `path` and return it; `kind` is that of a float one in comparisons."""
    if not isinstance(policy, _Float):
        return spiking_to_onnx(artifact(policy, origin), path)
    if kind not in _KINDS:
        raise ConfigError(f"kind {kind!r} is unknown; it is one of {', '.join(_KINDS)}")
    path = Path(path)
    model = _model(policy, origin, path.stem, kind)
    with replacing(path) as temporary:
        temporary.write_bytes(model.SerializeToString(deterministic=True))
    return path


def _macs(policy: _Float) -> int:
    """Multiply-accumulates of one inference: one for each weight that is left, where it is used."""
    if isinstance(policy, MlpPolicy):
        return sum(layer.get_parameter("weight").numel() for layer in policy.layers)
    return sum(int(counts.sum()) for counts in _fan_outs(policy))


def _fan_outs(policy: PrunedMlpPolicy | PrunedGruPolicy) -> list[Tensor]:
    """Weights that are left of each input (M,) of each matrix; the skip's with the first."""
    if isinstance(policy, PrunedGruPolicy):
        first, *others = (matrix.fan_out for matrix in policy.groups[: len(policy.hidden) + 3])
    else:
        first, *others = (matrix.fan_out for matrix in policy.layers)
    return [first + policy.past.fan_out if policy.skip else first, *others]


def _model(policy: _Float, origin: Provenance, name: str, kind: str) -> onnx.ModelProto:
    graph = OnnxGraph()
    more: dict[str, str] = {}
    if isinstance(policy, MlpPolicy):
        _layers(graph, policy, _add_normaliser(graph, policy))
    else:
        seen = _add_normaliser(graph, policy)
        if isinstance(policy, PrunedGruPolicy):
            _memory_layers(graph, policy, seen)
            more = {"biases": str(sum(policy.hidden) + 6 * policy.gru + policy.actions)}
        else:
            _pruned_layers(graph, policy, seen)
        counts = [[int(n) for n in each] for each in _fan_outs(policy)]
        more["fan_out"] = json.dumps(counts, separators=(",", ":"))
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
        **more,
    }
    return graph.model(policy.observations, policy.actions, policy.head, properties)


def _add_normaliser(graph: OnnxGraph, policy: Policy) -> str:
    """Add the normaliser; return the name of its output."""
    normalizer = policy.normalizer
    mean = graph.constant("mean", _array(normalizer.mean))
    std = graph.constant("std", _array(normalizer.std))
    limits = [
        graph.constant("lowest", -normalizer.clip),
        graph.constant("highest", normalizer.clip),
    ]
    # x = clip((obs - mean) / std)
    shifted = graph.node("Sub", [OBSERVATION, mean], "shifted")
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
    *layers, last = zip(policy.layers, policy.biases, strict=True)
    hidden = _rectified(graph, layers, seen)
    _act(graph, policy, _affine(graph, hidden, *last, len(layers) + 1), seen)


def _rectified(graph: OnnxGraph, layers: Iterable[tuple[PrunedWeight, Tensor]], hidden: str) -> str:
    """Add ReLU layers, weights and biases of each; return the name of the last."""
    for number, layer in enumerate(layers, start=1):
        sums = _affine(graph, hidden, *layer, number)
        hidden = graph.node("Relu", [sums], f"hidden{number}")
    return hidden


def _affine(graph: OnnxGraph, hidden: str, matrix: PrunedWeight, bias: Tensor, number: int) -> str:
    """Add weights and biases of a layer; return the name of its sums."""
    graph.presynaptic(hidden, matrix.fan_out.numel())
    weight = graph.constant(f"weight{number}", _array(matrix.whole()))
    offset = graph.constant(f"bias{number}", _array(bias))
    return graph.node("Gemm", [hidden, weight, offset], f"affine{number}", transB=1)


def _act(
    graph: OnnxGraph, policy: PrunedMlpPolicy | PrunedGruPolicy, hidden: str, seen: str
) -> None:
    """Add the path past the layers, and the output."""
    if policy.skip:
        past = graph.constant("skip_weight", _array(policy.past.whole().T))
        hidden = graph.node("Add", [hidden, graph.node("MatMul", [seen, past], "skip")], "sum")
    squash = "Identity" if policy.head == "discrete" else "Tanh"
    graph.node(squash, [hidden], OUTPUTS[policy.head])


def _memory_layers(graph: OnnxGraph, policy: PrunedGruPolicy, seen: str) -> None:
    """Add the network with a memory, up to its output."""
    layers = list(zip(policy.groups, policy.biases, strict=False))  # groups go on behind them
    hidden = _rectified(graph, layers, seen)
    copies = policy.copies.count if policy.copies else 1
    weights = {"gru": policy.gates(), "back": policy.back()}
    biases = {"gru": policy.gate_bias, "back": policy.back_bias}
    hidden = _gru(graph, hidden, (policy.hidden[-1], policy.gru), weights, biases, copies)
    sums = _affine(graph, hidden, policy.out, policy.action_bias, len(layers) + 1)
    _act(graph, policy, sums, seen)


def _gru(
    graph: OnnxGraph, hidden: str, widths: tuple[int, int], weights: Mapping[str, Tensor],
    biases: Mapping[str, Tensor], copies: int = 1,
) -> str:  # fmt: skip
    """Add a control step of the GRU, whose memory is a state; return its name.

    widths: numbers that it reads, and its units, of all copies together
    weights, biases: from the layer, "gru", and from the memory, "back", of a copy
    """
    memory = graph.state("memory", widths[1])
    past = graph.node("Identity", [memory], "back.inputs")
    both, rows = [], []
    for name, value, width in zip(("gru", "back"), (hidden, past), widths, strict=True):
        graph.presynaptic(value, width)
        both.append(graph.constant(f"{name}.weight", _gates(weights[name])[None]))
        # a row of each copy of each robot
        shape = graph.constant(f"{name}.shape", [1, -1, width // copies])
        rows.append(graph.node("Reshape", [value, shape], f"{name}.row"))
    bias = graph.constant(
        "gru.bias", np.concatenate([_gates(biases[name]) for name in ("gru", "back")])[None]
    )
    # torch's n = tanh(Wn x + b + r (Un h + c)) is ONNX's with linear_before_reset
    done = graph.node(
        "GRU", [rows[0], *both, bias, "", rows[1]], "gru.rows",
        hidden_size=widths[1] // copies, linear_before_reset=1,
    )  # fmt: skip
    sizes = graph.constant("gru.memory.shape", [-1, widths[1]])
    now = graph.node("Reshape", [done, sizes], "gru.memory")
    graph.next_state(f"{NEXT}{memory}", now, widths[1])
    return now


def _gates(tensor: Tensor) -> NDArray[np.float32]:
    """Weights (3 H, M) or biases (3 H,) of reset, update and new, as ONNX orders gates."""
    reset, update, new = tensor.chunk(3)
    return _array(cat([update, reset, new]))


def _array(tensor: Tensor) -> NDArray[np.float32]:
    array: NDArray[np.float32] = tensor.detach().cpu().float().numpy()
    return array
