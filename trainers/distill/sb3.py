"""Teachers from Stable-Baselines3 and sb3-contrib with MlpPolicy: what of them is a plain network.

A saved model is a zip. Its `data` is JSON: what JSON cannot say is pickled and base64 inside it,
and stays unread. Its `policy.pth` is a state dict, which torch's reader of weights alone accepts.
The state dict says the sizes; the JSON the activation function where it is not the algorithm's own,
the clip of the mean with state-dependent exploration (gSDE, noise on the action whose mean is
taken), and whether PPO's goes through tanh. Actions are those of
`model.predict(observation, deterministic=True)`. Another algorithm is a row of `_ALGORITHMS`.
"""

import io
import json
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Discrete
from pydantic import BaseModel, Field
from torch import Tensor, nn

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.schema import validate
from spikedeploy.trainers.distill.teacher import FloatArray, OwnSpaces, Teacher, certain

REMEDY = (
    "Export the policy to ONNX, or name a function of yours that acts with it: "
    "docs/own-teacher.md#stable-baselines3"
)
_MAX_BYTES = {"data": 2**24, "policy.pth": 2**28}  # when decompressed: 16 and 256 MiB
# Stable-Baselines3 compresses nothing, and weights hardly compress
_FREE, _RATIO = 2**20, 16  # bytes that any file may unpack to, and more for each that it takes
# functions whose arguments Stable-Baselines3 leaves at their defaults
_ACTIVATIONS = (
    r"^<class 'torch\.nn\.modules\.activation\."
    r"(Tanh|ReLU|ELU|GELU|LeakyReLU|Mish|SELU|SiLU|Sigmoid)'>$"
)
_FLATTEN = r"^<class 'stable_baselines3\.common\.torch_layers\.FlattenExtractor'>$"
_RENORM = ("scale", "bias", "ra_mean", "ra_var")


@dataclass(frozen=True)
class _Algorithm:
    """Names of the layers of a family of policies.

    hidden: prefix of the layers in a Sequential
    out: name of the last layer, None if among them
    activation: unless the file names another
    squashed: whether actions go through tanh, and are then scaled to the bounds
    renormalised: whether there may be batch renormalisation before each layer
    """

    hidden: str
    out: str | None
    activation: str
    squashed: bool = False
    renormalised: bool = False


_SAC = _Algorithm("actor.latent_pi", "actor.mu", "ReLU", squashed=True)
_DQN = "stable_baselines3.dqn.policies"
_ON_POLICY = "stable_baselines3.common.policies"  # PPO, A2C and TRPO
_ALGORITHMS = {  # by the module of the policy's class
    _ON_POLICY: _Algorithm("mlp_extractor.policy_net", "action_net", "Tanh"),
    "stable_baselines3.sac.policies": _SAC,
    "sb3_contrib.tqc.policies": _SAC,
    "sb3_contrib.crossq.policies": replace(_SAC, renormalised=True),
    "stable_baselines3.td3.policies": _Algorithm("actor.mu", None, "ReLU", squashed=True),
    _DQN: _Algorithm("q_net.q_net", None, "ReLU"),
}
_RECURRENT = (
    "it is recurrent (RecurrentPPO), and a teacher labels single observations. Train one without "
    "memory (PPO, SAC), in an environment that shows what it has to remember, such as the last "
    "observations by gymnasium.wrappers.FrameStackObservation"
)
_OTHERS = {  # algorithms that are known and not read
    "sb3_contrib.common.recurrent.policies": _RECURRENT,
    "sb3_contrib.common.maskable.policies": (
        "it is MaskablePPO, and the mask is not in the observation. Name a function of yours that "
        "asks for the mask and acts with it: docs/own-teacher.md#stable-baselines3"
    ),
    "sb3_contrib.qrdqn.policies": f"it is QR-DQN, which puts out quantiles of values. {REMEDY}",
    "sb3_contrib.ars.policies": f"it is ARS, whose layers are named otherwise. {REMEDY}",
}


class _Settings(BaseModel):
    """What counts of `policy_kwargs`."""

    activation_fn: str | None = Field(default=None, pattern=_ACTIVATIONS)
    features_extractor_class: str | None = Field(default=None, pattern=_FLATTEN)
    squash_output: bool = False
    clip_mean: float = Field(default=2.0, ge=0, strict=True, allow_inf_nan=False)
    batch_norm_eps: float = Field(default=1e-3, gt=0, strict=True, allow_inf_nan=False)


def sb3_teacher(path: str, spaces: OwnSpaces) -> Teacher:
    """Return the teacher in a .zip file; ConfigError, with the remedy, of a file that is none."""
    if not Path(path).is_file():
        raise ConfigError(f"there is no teacher at {path}")
    try:
        with zipfile.ZipFile(path) as archive:
            data, tensors = _read_data(archive), _read_weights(archive)
    except Exception as error:  # whatever a damaged file makes of the readers
        first = str(error).partition("\n")[0]
        raise ConfigError(
            f"{path} cannot be read as a model of Stable-Baselines3: {first}"
        ) from error
    module = _text(data, "policy_class", "__module__")
    try:
        _check_algorithm(module, data, tensors)
        _check_actions(data, spaces)
        settings = validate(_Settings, data.get("policy_kwargs", {}), "its policy_kwargs")
        algorithm = _ALGORITHMS[module]
        layers = _layers(tensors, algorithm, settings)
    except ConfigError as error:
        why = str(error)
        remedy = "" if why in _OTHERS.values() else f". {REMEDY}"
        raise ConfigError(f"the teacher {path} cannot be read: {why}{remedy}") from error
    named = (settings.activation_fn or algorithm.activation).strip("<>'").rpartition(".")[2]
    activation = getattr(nn, named)
    network = nn.Sequential(*[m for layer in layers for m in (layer, activation())][:-1]).eval()
    clip = settings.clip_mean if _is_clipped(tensors, algorithm) else np.inf
    scaled = algorithm.squashed or settings.squash_output

    @torch.no_grad()
    def act_all(observation: FloatArray) -> FloatArray:
        out: FloatArray = network(torch.from_numpy(observation).float()).double().numpy()
        if module == _DQN:  # values of actions, of which the largest is chosen
            return certain(out.argmax(-1), out.shape[1])
        out = np.clip(out, -clip, clip)
        if scaled:  # to the bounds, as ours are
            return spaces.labels(path, np.tanh(out), len(out), "scaled")
        return spaces.labels(path, out, len(out), "own")

    widths = (layers[0].in_features, *(layer.out_features for layer in layers))
    return Teacher(act_all, widths[0], widths[-1], widths=widths)


# -- the two members of a file


def _check_sizes(name: str, members: list[zipfile.ZipInfo]) -> None:
    """Refuse, by declared sizes, what would unpack to too much, or to far more than it takes."""
    packed = sum(each.compress_size for each in members)
    unpacked = sum(each.file_size for each in members)
    most = min(_MAX_BYTES[name], _FREE + _RATIO * packed)
    if unpacked > most:
        raise ValueError(
            f"{name} would unpack from {packed:,} to {unpacked:,} bytes, over {most:,}. {REMEDY}"
        )


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    if name not in archive.namelist():
        raise ValueError(f"it has no {name}")
    _check_sizes(name, [archive.getinfo(name)])
    return archive.read(name)


def _read_data(archive: zipfile.ZipFile) -> dict[str, Any]:
    data = json.loads(_member(archive, "data"))
    if not isinstance(data, dict):
        raise ValueError("data is no table")
    return data


def _read_weights(archive: zipfile.ZipFile) -> dict[str, Tensor]:
    """Return the state dict, read by torch's reader that runs no code."""
    raw = io.BytesIO(_member(archive, "policy.pth"))
    try:
        with zipfile.ZipFile(raw) as inner:
            members = inner.infolist()
    except zipfile.BadZipFile as error:
        raise ValueError("policy.pth is damaged, or of torch before 1.6") from error
    _check_sizes("policy.pth", members)
    # which torch before 2.6 runs whatever `weights_only` says
    if any(each.filename.endswith("constants.pkl") for each in members):
        raise ValueError("policy.pth is a script of torch, which runs code")
    raw.seek(0)
    try:
        found = torch.load(raw, map_location="cpu", weights_only=True)
    except Exception as error:  # whose text advises to load what may run code
        raise ValueError("policy.pth holds more than weights, or is damaged") from error
    if not isinstance(found, dict) or not all(isinstance(each, Tensor) for each in found.values()):
        raise ValueError("policy.pth is no state dict")
    for name, each in found.items():
        special = each.is_nested or each.is_quantized or each.device.type != "cpu"
        if special or each.layout != torch.strided:
            raise ValueError(f"its tensor {name!s:.60} is sparse, nested, quantised or empty")
    if sum(each.numel() for each in found.values()) > _MAX_BYTES["policy.pth"] // 4:
        raise ValueError("policy.pth has tensors larger than their file")
    return {str(name): tensor for name, tensor in found.items()}


# -- what is no plain network of the observation


def _check_algorithm(module: str, data: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> None:
    """Refuse policies that are more than an MLP of one observation, or whose layers are unknown."""
    if module in _OTHERS:
        raise ConfigError(_OTHERS[module])
    # gSDE's extractor in old versions makes noise alone
    extractors = [name for name in tensors if "features_extractor" in name and "sde_" not in name]
    reasons = {
        _RECURRENT: any("lstm" in name for name in tensors),
        "it is a MultiInputPolicy, and students observe one vector": (
            "Dict" in _text(data, "observation_space", ":type:")
        ),
        "its features extractor has weights, such as a CnnPolicy's": bool(extractors),
        f"its policy is of {module or 'an unknown class'}, not MlpPolicy": (
            module not in _ALGORITHMS
        ),
        # algorithms with a rollout buffer set it for VecNormalize alone; others set it always
        "it was trained behind VecNormalize, whose statistics are in a pickle beside it": (
            module == _ON_POLICY and data.get("_last_original_obs") is not None
        ),
    }
    for why, applies in reasons.items():
        if applies:
            raise ConfigError(why)


def _check_actions(data: Mapping[str, Any], spaces: OwnSpaces) -> None:
    """Refuse actions that are other ones than the environment's."""
    found = _text(data, "action_space", ":type:")
    kind = "Discrete" if isinstance(spaces.action, Discrete) else "Box"
    if f".{kind}'" not in found:
        raise ConfigError(f"its actions are {found or 'unknown'}; {spaces.name} takes a {kind}")
    if kind == "Discrete":
        return
    for side, ours in zip(("low", "high"), spaces.bounds(), strict=True):
        words = re.sub(r"[\[\]]", " ", _text(data, "action_space", side)).split()
        try:
            theirs = np.array([float(word) for word in words])
        except ValueError:  # NumPy leaves out numbers of long arrays
            continue
        if theirs.shape == ours.shape and not np.allclose(theirs, ours, rtol=1e-5, atol=1e-6):
            raise ConfigError(
                f"it was trained for actions with {side} {theirs.tolist()}, and {spaces.name} has "
                f"{ours.tolist()}"
            )


# -- layers


def _layers(
    tensors: Mapping[str, Tensor], algorithm: _Algorithm, settings: _Settings
) -> list[nn.Linear]:
    """Return the layers from observation to action, renormalisations folded into them."""
    prefix = algorithm.hidden
    renormalised = algorithm.renormalised and f"{prefix}.0.ra_mean" in tensors
    first, stride = (1, 3) if renormalised else (0, 2)  # linear, activation; or one more before
    linear = {name for name in tensors if name.startswith(f"{prefix}.")}
    if renormalised:
        parts = "|".join((*_RENORM, "steps"))
        norms = re.compile(rf"{re.escape(prefix)}\.([0-9]{{1,3}})\.({parts})")
        matches = {name: norms.fullmatch(name) for name in linear}
        linear -= {n for n, m in matches.items() if m is not None and int(m[1]) % stride == 0}
    count = sum(name.endswith(".weight") for name in linear)
    names = [f"{prefix}.{first + stride * k}" for k in range(count)]
    if linear != {f"{name}.{part}" for name in names for part in ("weight", "bias")}:
        raise ConfigError(f"its layers {prefix} are not an MLP's")
    if algorithm.out:
        names.append(f"{algorithm.out}.0" if _is_clipped(tensors, algorithm) else algorithm.out)
    layers = [_linear(tensors, name) for name in names]
    if not layers or any(a.out_features != b.in_features for a, b in pairwise(layers)):
        raise ConfigError("its layers do not fit one another")
    for place, layer in enumerate(layers if renormalised else ()):
        _fold(tensors, f"{prefix}.{stride * place}", layer, settings.batch_norm_eps)
    return layers


def _fold(tensors: Mapping[str, Tensor], name: str, layer: nn.Linear, eps: float) -> None:
    """Fold the batch renormalisation before a layer into it, as it acts once training is over.

    sb3_contrib.common.torch_layers.BatchRenorm: y = scale (x - ra_mean) / sqrt(ra_var + eps) + bias
    """
    found = [tensors.get(f"{name}.{part}") for part in _RENORM]
    if not all(each is not None and each.shape == (layer.in_features,) for each in found):
        raise ConfigError(f"its renormalisation {name} does not fit the layer after it")
    scale, bias, mean, variance = (each.double() for each in found if each is not None)
    gain = scale / torch.sqrt(variance + eps)
    weight = layer.weight.double()
    _load(layer, weight * gain, layer.bias.double() + weight @ (bias - gain * mean), name)


def _is_clipped(tensors: Mapping[str, Tensor], algorithm: _Algorithm) -> bool:
    """True of a squashed policy with gSDE, whose last layer stands before a clip of the mean."""
    return algorithm.squashed and f"{algorithm.out}.0.weight" in tensors


def _linear(tensors: Mapping[str, Tensor], name: str) -> nn.Linear:
    weight, bias = (tensors.get(f"{name}.{part}") for part in ("weight", "bias"))
    if weight is None or bias is None or weight.ndim != 2 or bias.shape != weight.shape[:1]:
        raise ConfigError(f"it has no layer {name} with weight and bias")
    layer = nn.Linear(weight.shape[1], weight.shape[0])
    _load(layer, weight, bias, name)
    return layer


def _load(layer: nn.Linear, weight: Tensor, bias: Tensor, name: str) -> None:
    """Give a layer its numbers, which must be finite floats."""
    floats = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
    if not all(t.dtype in floats and bool(t.isfinite().all()) for t in (weight, bias)):
        raise ConfigError(f"its layer {name} has weights that are no finite floats")
    layer.load_state_dict({"weight": weight.float(), "bias": bias.float()})


def _text(data: Any, *keys: str) -> str:  # noqa: ANN401
    """Return a text in nested tables, empty where there is none."""
    for key in keys:
        data = data.get(key) if isinstance(data, dict) else None
    return data if isinstance(data, str) else ""
