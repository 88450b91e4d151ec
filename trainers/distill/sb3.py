"""Teachers from Stable-Baselines3 and sb3-contrib with MlpPolicy: what of them is a plain network.

PPO, A2C and TRPO; SAC, TQC, CrossQ, TD3 and DDPG; DQN. State-dependent exploration (gSDE) is noise
on the action of such a network, whose mean is taken.

A saved model is a zip. Its `data` is JSON: what JSON cannot say is pickled and base64 inside it,
and stays unread. Its `policy.pth` is the state dict, a zip of torch's that torch's reader of
weights alone accepts. The state dict says the sizes; the JSON the activation function where it is
not the algorithm's own, the clip of the mean with gSDE, and whether PPO's goes through tanh.
Actions are those of `model.predict(observation, deterministic=True)`.
"""

import io
import json
import re
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Discrete
from torch import Tensor, nn

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill.teacher import FloatArray, OwnSpaces, Teacher, certain

REMEDY = (
    "Export the policy to ONNX, or name a function of yours that acts with it: "
    "docs/own-teacher.md#stable-baselines3"
)
_MAX_BYTES = {"data": 2**24, "policy.pth": 2**28}  # when decompressed: 16 and 256 MiB
# what zipfile raises depends on the damage; ValueError of names that are no text
_DAMAGES = (zipfile.BadZipFile, zlib.error, ValueError, EOFError, RuntimeError, OSError)
# Stable-Baselines3 compresses nothing, and weights hardly compress
_FREE, _RATIO = 2**20, 16  # bytes that any file may unpack to, and more for each that it takes
_FLATTEN = "<class 'stable_baselines3.common.torch_layers.FlattenExtractor'>"
_DTYPES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
# functions whose arguments Stable-Baselines3 leaves at their defaults
_ACTIVATIONS = ("Tanh", "ReLU", "ELU", "GELU", "LeakyReLU", "Mish", "SELU", "SiLU", "Sigmoid")


@dataclass(frozen=True)
class _Kind:
    """Names of the layers of a family of policies.

    hidden: prefix of the layers in a Sequential; out: name of the last layer, None if among them
    activation: unless the file names another
    squashed: whether actions go through tanh, and are then scaled to the bounds
    renormalised: whether there may be batch renormalisation before each layer
    """

    hidden: str
    out: str | None
    activation: str
    squashed: bool = False
    renormalised: bool = False


_SAC = _Kind("actor.latent_pi", "actor.mu", "ReLU", squashed=True)
_KINDS = {  # by the module of the policy's class
    "stable_baselines3.common.policies": _Kind("mlp_extractor.policy_net", "action_net", "Tanh"),
    "stable_baselines3.sac.policies": _SAC,
    "sb3_contrib.tqc.policies": _SAC,
    "sb3_contrib.crossq.policies": replace(_SAC, renormalised=True),
    "stable_baselines3.td3.policies": _Kind("actor.mu", None, "ReLU", squashed=True),
    "stable_baselines3.dqn.policies": _Kind("q_net.q_net", None, "ReLU"),
}


class _DamagedError(Exception):
    """The reason why a file is no model of Stable-Baselines3."""


class _RefusedError(Exception):
    """The reason why a model is no teacher, and what to do."""

    def __init__(self, reason: str, remedy: str = REMEDY) -> None:
        super().__init__(f"{reason}. {remedy}")


def sb3_teacher(path: str, spaces: OwnSpaces) -> Teacher:
    """Return the teacher in a .zip file, or refuse it with the remedy."""
    if not Path(path).is_file():
        raise ConfigError(f"there is no teacher at {path}")
    try:
        data, tensors = _read(path)
        module = _text(data, "policy_class", "__module__")
        _check_algorithm(module, tensors)
        if why := _unfit(module, data, tensors) or _other_actions(data, spaces):
            raise _RefusedError(why)
        kind, settings = _KINDS[module], _settings(data)
        layers = _layers(tensors, kind, settings)
        activation = getattr(nn, _activation(settings, kind))
        clip = _clip_of_mean(tensors, kind, settings)
    except _DamagedError as error:
        raise ConfigError(
            f"{path} cannot be read as a model of Stable-Baselines3: {error}"
        ) from error
    except _RefusedError as error:
        raise ConfigError(f"the teacher {path} cannot be read: {error}") from error
    chain = [module for layer in layers for module in (layer, activation())][:-1]
    network = nn.Sequential(*chain).eval()

    @torch.no_grad()
    def act_all(observation: FloatArray) -> FloatArray:
        out: FloatArray = network(torch.from_numpy(observation).float()).double().numpy()
        if module.endswith("dqn.policies"):  # values of actions, of which the largest is chosen
            return certain(out.argmax(-1), out.shape[1])
        out = np.clip(out, -clip, clip)
        if kind.squashed or settings.get("squash_output"):  # scaled to the bounds, as ours are
            return spaces.labels(path, np.tanh(out), len(out), "scaled")
        return spaces.labels(path, out, len(out), "own")

    widths = (layers[0].in_features, *(layer.out_features for layer in layers))
    return Teacher(act_all, widths[0], widths[-1], widths=widths)


def _read(path: str) -> tuple[Mapping[str, Any], Mapping[str, Tensor]]:
    """Return the JSON and the state dict, both bounded by their declared sizes."""
    try:
        with zipfile.ZipFile(path) as archive:
            missing = sorted(_MAX_BYTES.keys() - set(archive.namelist()))
            if not missing:
                for name in _MAX_BYTES:
                    _check_sizes(name, [archive.getinfo(name)])
                raw = {name: archive.read(name) for name in _MAX_BYTES}
    except _DAMAGES as error:
        raise _DamagedError(str(error)) from error
    if missing:
        raise _DamagedError(f"it has no {' and no '.join(missing)}")
    try:
        data = json.loads(raw["data"])
    except (ValueError, RecursionError) as error:
        raise _DamagedError(f"data is no JSON: {error}") from error
    if not isinstance(data, dict):
        raise _DamagedError("data is no table")
    return data, _tensors(raw["policy.pth"])


def _check_sizes(name: str, members: list[zipfile.ZipInfo]) -> None:
    """Refuse, by declared sizes, what would unpack to too much, or to far more than it takes."""
    packed = sum(each.compress_size for each in members)
    unpacked = sum(each.file_size for each in members)
    if unpacked > _MAX_BYTES[name]:
        raise _DamagedError(
            f"{name} has more than {_MAX_BYTES[name] >> 20} MiB; larger ones are not read. Export "
            "the policy to ONNX"
        )
    if unpacked > _FREE + _RATIO * packed:
        raise _DamagedError(
            f"{name} would unpack from {packed:,} to {unpacked:,} bytes, more than {_RATIO} times "
            "as many. Save the model again without compression"
        )


def _tensors(raw: bytes) -> dict[str, Tensor]:
    """Return the state dict, read by torch's reader that runs no code."""
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            members = archive.infolist()
    except _DAMAGES as error:
        raise _DamagedError("policy.pth is in the format of torch before 1.6") from error
    if any(each.filename.endswith("constants.pkl") for each in members):
        raise _DamagedError("policy.pth is a script of torch, which runs code")
    _check_sizes("policy.pth", members)
    try:
        found = torch.load(io.BytesIO(raw), map_location="cpu", weights_only=True)
    except Exception as error:  # whatever a damaged file makes of torch's reader
        first = str(error).partition("\n")[0]
        raise _DamagedError(f"policy.pth holds more than weights, or is cut: {first}") from error
    if not isinstance(found, dict) or not all(isinstance(each, Tensor) for each in found.values()):
        raise _DamagedError("policy.pth is no state dict")
    for name, each in found.items():
        special = each.is_nested or each.is_quantized or each.device.type != "cpu"
        if special or each.layout != torch.strided:
            raise _DamagedError(f"its tensor {name!s:.60} is sparse, nested, quantised or empty")
    if sum(each.numel() for each in found.values()) > _MAX_BYTES["policy.pth"] // 4:
        raise _DamagedError("policy.pth has tensors larger than their file")
    return {str(name): tensor for name, tensor in found.items()}


def _check_algorithm(module: str, tensors: Mapping[str, Tensor]) -> None:
    """Refuse, by their names, policies that need more than one observation, or are read otherwise.

    What they need is not in the file, or no teacher has it: each has a remedy of its own.
    """
    if "recurrent" in module or any("lstm" in name for name in tensors):
        raise _RefusedError(
            "it is recurrent (RecurrentPPO), and a teacher labels single observations, in whatever "
            "format it is",
            "Train one without memory (PPO, SAC), in an environment that shows what it has to "
            "remember, such as the last observations by gymnasium.wrappers.FrameStackObservation",
        )
    if module == "sb3_contrib.common.maskable.policies":
        raise _RefusedError(
            "it is MaskablePPO, which chooses among the actions that a mask allows, and the mask "
            "is not in the observation",
            "Name a function of yours that asks for the mask and acts with it: "
            "docs/own-teacher.md#stable-baselines3",
        )
    if module in _VALUES_OR_SEARCH:
        raise _RefusedError(_VALUES_OR_SEARCH[module])


_VALUES_OR_SEARCH = {
    "sb3_contrib.qrdqn.policies": "it is QR-DQN, whose network puts out quantiles of the value of "
    "each action, from which it chooses by their means",
    "sb3_contrib.ars.policies": "it is ARS, whose layers are named otherwise",
}


def _settings(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the policy's settings; none where they are no table."""
    given = data.get("policy_kwargs", {})
    return given if isinstance(given, dict) else {}


def _unfit(module: str, data: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> str:
    """Return why a policy is more than an MLP of the observation; empty where it is one."""
    settings = _settings(data)
    extractor = settings.get("features_extractor_class", _FLATTEN)
    # algorithms with a rollout buffer set it for VecNormalize alone; others set it always
    on_policy = module in _KINDS and _KINDS[module].out == "action_net"
    reasons = {
        "it is a MultiInputPolicy, and students observe one vector": (
            "Dict" in _text(data, "observation_space", ":type:")
        ),
        "its policy_kwargs are no table, so its networks are unknown": (
            not isinstance(data.get("policy_kwargs", {}), dict)
        ),
        f"its features extractor is {extractor!s:.80}, not FlattenExtractor": (
            extractor != _FLATTEN
        ),
        "it has a features extractor with weights, such as a CnnPolicy's": any(
            # that of gSDE in old versions makes noise alone
            "features_extractor" in name and "sde_features_extractor" not in name
            for name in tensors
        ),
        f"its policy is of {module or 'an unknown class'}, not MlpPolicy": module not in _KINDS,
        "it was trained behind VecNormalize, whose statistics are in a pickle beside it, which "
        "could run code and stays unread": (
            on_policy and data.get("_last_original_obs") is not None
        ),
    }
    return next((why for why, applies in reasons.items() if applies), "")


def _other_actions(data: Mapping[str, Any], spaces: OwnSpaces) -> str:
    """Return how the actions are other ones than the environment's; empty where they are those."""
    found = _text(data, "action_space", ":type:")
    kind = "Discrete" if isinstance(spaces.action, Discrete) else "Box"
    if f".{kind}'" not in found:
        return f"its actions are {found or 'unknown'}; {spaces.name} takes a {kind}"
    if kind == "Discrete":
        return ""
    for side, ours in zip(("low", "high"), spaces.bounds(), strict=True):
        words = re.sub(r"[\[\]]", " ", _text(data, "action_space", side)).split()
        try:
            theirs = np.array([float(word) for word in words])
        except ValueError:  # NumPy leaves out numbers of long arrays
            continue
        if theirs.shape == ours.shape and not np.allclose(theirs, ours, rtol=1e-5, atol=1e-6):
            return (
                f"it was trained for actions with {side} {theirs.tolist()}, and {spaces.name} has "
                f"{ours.tolist()}"
            )
    return ""


def _layers(
    tensors: Mapping[str, Tensor], kind: _Kind, settings: Mapping[str, Any]
) -> list[nn.Linear]:
    """Return the layers from observation to action, renormalisations folded into them."""
    inner = [name for name in tensors if name.startswith(f"{kind.hidden}.")]
    renormalised = kind.renormalised and f"{kind.hidden}.0.ra_mean" in tensors
    parts = ("weight", "bias", *_RENORM, "steps") if renormalised else ("weight", "bias")
    pattern = re.compile(re.escape(kind.hidden) + rf"\.([0-9]{{1,3}})\.({'|'.join(parts)})")
    matches = [pattern.fullmatch(name) for name in inner]
    for name, match in zip(inner, matches, strict=True):
        if match is None:
            raise _RefusedError(f"it has a layer {name:.60}: not an MLP's")
    places = sorted({int(match[1]) for match in matches if match and match[2] == "weight"})
    first, stride = (1, 3) if renormalised else (0, 2)  # linear, activation; or one more before
    if places != list(range(first, first + stride * len(places), stride)) or not (
        places or kind.out
    ):
        raise _RefusedError(f"its layers {kind.hidden} are {places}: not an MLP's")
    names = [f"{kind.hidden}.{place}" for place in places]
    if kind.out:
        names.append(f"{kind.out}.0" if _is_clipped(tensors, kind) else kind.out)
    layers = [_linear(tensors, name) for name in names]
    if any(a.out_features != b.in_features for a, b in pairwise(layers)):
        raise _RefusedError("its layers do not fit one another")
    if renormalised:
        eps = _positive(settings, "batch_norm_eps", 1e-3)
        for place, layer in enumerate(layers):
            _fold(tensors, f"{kind.hidden}.{stride * place}", layer, eps)
    return layers


_RENORM = ("scale", "bias", "ra_mean", "ra_var")


def _fold(tensors: Mapping[str, Tensor], name: str, layer: nn.Linear, eps: float) -> None:
    """Fold the batch renormalisation before a layer into it, as it acts once training is over.

    sb3_contrib.common.torch_layers.BatchRenorm: y = scale (x - ra_mean) / sqrt(ra_var + eps) + bias
    """
    found = [tensors.get(f"{name}.{part}") for part in _RENORM]
    if not all(each is not None and each.shape == (layer.in_features,) for each in found):
        raise _RefusedError(f"its renormalisation {name} does not fit the layer after it")
    scale, bias, mean, variance = (each.double() for each in found if each is not None)
    gain = scale / torch.sqrt(variance + eps)
    weight = layer.weight.double()
    folded = {"weight": weight * gain, "bias": layer.bias.double() + weight @ (bias - gain * mean)}
    if not all(bool(each.isfinite().all()) for each in folded.values()):
        raise _RefusedError(f"its renormalisation {name} has no finite numbers")
    layer.load_state_dict({part: each.float() for part, each in folded.items()})


def _is_clipped(tensors: Mapping[str, Tensor], kind: _Kind) -> bool:
    """True of a squashed policy with gSDE, whose last layer stands before a clip of the mean."""
    return kind.squashed and f"{kind.out}.0.weight" in tensors


def _clip_of_mean(tensors: Mapping[str, Tensor], kind: _Kind, settings: Mapping[str, Any]) -> float:
    """Return the largest size of the mean before tanh; inf where it is not clipped."""
    return _positive(settings, "clip_mean", 2.0) if _is_clipped(tensors, kind) else np.inf


def _positive(settings: Mapping[str, Any], name: str, default: float) -> float:
    """Return a setting that is a positive number."""
    found = settings.get(name, default)
    if isinstance(found, bool) or not isinstance(found, int | float) or not 0 < found < np.inf:
        raise _RefusedError(f"its setting {name} is {found!s:.40}, no positive number")
    return float(found)


def _linear(tensors: Mapping[str, Tensor], name: str) -> nn.Linear:
    weight, bias = (tensors.get(f"{name}.{part}") for part in ("weight", "bias"))
    if weight is None or bias is None or weight.ndim != 2 or bias.shape != weight.shape[:1]:
        raise _RefusedError(f"it has no layer {name} with weight and bias")
    if not all(t.dtype in _DTYPES for t in (weight, bias)):
        raise _RefusedError(f"its layer {name} is of {weight.dtype} and {bias.dtype}, no floats")
    if not all(bool(t.isfinite().all()) for t in (weight, bias)):
        raise _RefusedError(f"its layer {name} has weights that are no finite numbers")
    layer = nn.Linear(weight.shape[1], weight.shape[0])
    layer.load_state_dict({"weight": weight.float(), "bias": bias.float()})
    return layer


def _activation(settings: Mapping[str, Any], kind: _Kind) -> str:
    """Return the name of the activation function in torch.nn."""
    named = settings.get("activation_fn")
    if named is None:
        return kind.activation
    found = re.fullmatch(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>", str(named))
    if found is None or found[1] not in _ACTIVATIONS:
        raise _RefusedError(
            f"its activation function is {named}; known are {', '.join(_ACTIVATIONS)}"
        )
    return found[1]


def _text(data: Any, *keys: str) -> str:  # noqa: ANN401
    """Return a text in nested tables, empty where there is none."""
    for key in keys:
        data = data.get(key) if isinstance(data, dict) else None
    return data if isinstance(data, str) else ""
