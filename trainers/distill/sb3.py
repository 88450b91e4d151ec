"""Teachers from Stable-Baselines3: PPO, A2C, SAC, TD3, DDPG and DQN with MlpPolicy.

The state dict says the sizes, the JSON beside it the activation function where it is not the
algorithm's own. Actions are those of `model.predict(observation, deterministic=True)`.
"""

import io
import json
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Discrete
from torch import Tensor, nn

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill.teacher import FloatArray, OwnSpaces, Teacher, certain

_MAX_BYTES = {"data": 2**24, "policy.pth": 2**28}  # when decompressed: 16 and 256 MiB
# what zipfile raises depends on the damage; ValueError of names that are no text
_DAMAGES = (zipfile.BadZipFile, zlib.error, ValueError, EOFError, RuntimeError, OSError)
# Stable-Baselines3 compresses nothing, and weights hardly compress
_FREE, _RATIO = 2**20, 16  # bytes that any file may unpack to, and more for each that it takes


@dataclass(frozen=True)
class Sb3File:
    """A saved model.

        data        JSON; what JSON cannot say is pickled and base64 inside it, and stays unread
        policy.pth  the state dict, a zip of torch's that its reader of weights alone accepts

    path: of the file
    data: its JSON
    tensors: the policy's state dict
    """

    path: str
    data: Mapping[str, Any]
    tensors: Mapping[str, Tensor]


def read_sb3(path: str) -> Sb3File:
    """Return what a .zip file of Stable-Baselines3 says, or raise ConfigError."""
    if not Path(path).is_file():
        raise ConfigError(f"there is no teacher at {path}")
    raw = _members(path)
    try:
        data = json.loads(raw["data"])
    except (ValueError, RecursionError) as error:
        raise _damaged(path, f"data is no JSON: {error}") from error
    if not isinstance(data, dict):
        raise _damaged(path, "data is no table")
    return Sb3File(path, data, _tensors(path, raw["policy.pth"]))


def _members(path: str) -> dict[str, bytes]:
    """Return the bytes of the two files that are read, unless they are too large."""
    try:
        with zipfile.ZipFile(path) as archive:
            if missing := sorted(_MAX_BYTES.keys() - set(archive.namelist())):
                raise ConfigError(
                    f"{path} is no model of Stable-Baselines3: it has no {' and no '.join(missing)}"
                )
            for name, limit in _MAX_BYTES.items():
                _check_sizes(path, name, [archive.getinfo(name)], limit)
            return {name: archive.read(name) for name in _MAX_BYTES}
    except _DAMAGES as error:
        raise _damaged(path, str(error)) from error


def _check_sizes(path: str, name: str, members: Sequence[zipfile.ZipInfo], limit: int) -> None:
    """Refuse, by declared sizes, what would unpack to too much, or to far more than it takes."""
    packed = sum(each.compress_size for each in members)
    unpacked = sum(each.file_size for each in members)
    if unpacked > limit:
        raise ConfigError(
            f"{path}: {name} has more than {limit >> 20} MiB; larger ones are not read. Export "
            "the policy to ONNX"
        )
    if unpacked > _FREE + _RATIO * packed:
        raise _damaged(
            path,
            f"{name} would unpack from {packed:,} to {unpacked:,} bytes, more than {_RATIO} times "
            "as many. Save the model again without compression",
        )


def _tensors(path: str, raw: bytes) -> dict[str, Tensor]:
    """Return the state dict, read by torch's reader that runs no code."""
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            members = archive.infolist()
    except _DAMAGES as error:
        raise _damaged(path, "policy.pth is in the format of torch before 1.6") from error
    if any(each.filename.endswith("constants.pkl") for each in members):
        raise _damaged(path, "policy.pth is a script of torch, which runs code")
    _check_sizes(path, "policy.pth", members, _MAX_BYTES["policy.pth"])
    try:
        found = torch.load(io.BytesIO(raw), map_location="cpu", weights_only=True)
    except Exception as error:  # whatever a damaged file makes of torch's reader
        first = str(error).partition("\n")[0]
        raise _damaged(path, f"policy.pth holds more than weights, or is cut: {first}") from error
    if not isinstance(found, dict) or not all(isinstance(each, Tensor) for each in found.values()):
        raise _damaged(path, "policy.pth is no state dict")
    for name, each in found.items():
        special = each.is_nested or each.is_quantized or each.device.type != "cpu"
        if special or each.layout != torch.strided:
            raise _damaged(path, f"its tensor {name!s:.60} is sparse, nested, quantised or empty")
    if sum(each.numel() for each in found.values()) > _MAX_BYTES["policy.pth"] // 4:
        raise _damaged(path, "policy.pth has tensors larger than their file")
    return {str(name): tensor for name, tensor in found.items()}


def _damaged(path: str, what: str) -> ConfigError:
    return ConfigError(f"{path} cannot be read as a model of Stable-Baselines3: {what}")


REMEDY = (
    "Export the policy to ONNX, or name a function of yours that acts with it: "
    "docs/own-teacher.md#stable-baselines3"
)
_FLATTEN = "<class 'stable_baselines3.common.torch_layers.FlattenExtractor'>"
_DTYPES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
# functions whose arguments Stable-Baselines3 leaves at their defaults
_ACTIVATIONS = ("Tanh", "ReLU", "ELU", "GELU", "LeakyReLU", "Mish", "SELU", "SiLU", "Sigmoid")


@dataclass(frozen=True)
class _Kind:
    """Where a family of policies has its layers.

    hidden: prefix of the layers in a Sequential; out: name of the last layer, None if among them
    activation: unless the file names another
    squashed: whether actions go through tanh, and are then scaled to the bounds
    """

    hidden: str
    out: str | None
    activation: str
    squashed: bool = False


_KINDS = {  # by the module of the policy's class
    "stable_baselines3.common.policies": _Kind("mlp_extractor.policy_net", "action_net", "Tanh"),
    "stable_baselines3.sac.policies": _Kind("actor.latent_pi", "actor.mu", "ReLU", squashed=True),
    "stable_baselines3.td3.policies": _Kind("actor.mu", None, "ReLU", squashed=True),
    "stable_baselines3.dqn.policies": _Kind("q_net.q_net", None, "ReLU"),
}


def sb3_teacher(path: str, spaces: OwnSpaces) -> Teacher:
    """Return the teacher in a .zip file, or refuse it with the remedy."""
    file = read_sb3(path)
    module = _text(file.data, "policy_class", "__module__")
    _check(file, module)
    kind = _KINDS[module]
    _check_actions(file, spaces)
    layers = _layers(file, kind)
    network = _network(layers, _activation(file, kind))
    first, last = layers[0].in_features, layers[-1].out_features
    act_all = _acting(path, network, kind, module.endswith("dqn.policies"), spaces)
    return Teacher(act_all, first, last)


def _acting(
    path: str, network: nn.Module, kind: _Kind, values: bool, spaces: OwnSpaces
) -> Callable[[FloatArray], FloatArray]:
    """Return what the network does: actions in [-1, 1], or logits.

    values: whether its outputs are values of actions, of which the largest is chosen
    """

    @torch.no_grad()
    def act_all(observation: FloatArray) -> FloatArray:
        out: FloatArray = network(torch.from_numpy(observation).float()).double().numpy()
        if values:
            return certain(out.argmax(-1), out.shape[1])
        if kind.squashed:  # to be scaled to the bounds as policies of ours are
            return spaces.labels(path, np.tanh(out), len(out), "scaled")
        return spaces.labels(path, out, len(out), "own")

    return act_all


def _check(file: Sb3File, module: str) -> None:
    """Refuse policies that are more than an MLP of the observation."""
    if "recurrent" in module or any("lstm" in name for name in file.tensors):
        raise _refused(file, "it is recurrent, and a teacher labels single observations")
    if "Dict" in _text(file.data, "observation_space", ":type:"):
        raise _refused(file, "it is a MultiInputPolicy, and students observe one vector")
    settings = file.data.get("policy_kwargs", {})
    if not isinstance(settings, dict):
        raise _refused(file, "its policy_kwargs are no table, so its networks are unknown")
    if (extractor := settings.get("features_extractor_class", _FLATTEN)) != _FLATTEN:
        raise _refused(file, f"its features extractor is {extractor!s:.80}, not FlattenExtractor")
    if any("features_extractor" in name for name in file.tensors):
        raise _refused(file, "it has a features extractor with weights, such as a CnnPolicy's")
    if module not in _KINDS:
        raise _refused(file, f"its policy is of {module or 'an unknown class'}, not MlpPolicy")
    if file.data.get("use_sde"):
        raise _refused(file, "it was trained with state-dependent exploration (use_sde)")
    # algorithms with a rollout buffer set it for VecNormalize alone; others set it always
    on_policy = _KINDS[module].out == "action_net"
    if on_policy and file.data.get("_last_original_obs") is not None:
        raise _refused(
            file,
            "it was trained behind VecNormalize, whose statistics are in a pickle beside it, "
            "which could run code and stays unread",
        )


def _check_actions(file: Sb3File, spaces: OwnSpaces) -> None:
    """Refuse a policy that was trained for other actions than the environment's."""
    found = _text(file.data, "action_space", ":type:")
    kind = "Discrete" if isinstance(spaces.action, Discrete) else "Box"
    if f".{kind}'" not in found:
        raise _refused(file, f"its actions are {found or 'unknown'}; {spaces.name} takes a {kind}")
    if kind == "Discrete":
        return
    for side, ours in zip(("low", "high"), spaces.bounds(), strict=True):
        theirs = _numbers(_text(file.data, "action_space", side))
        if theirs.shape == ours.shape and not np.allclose(theirs, ours, rtol=1e-5, atol=1e-6):
            raise _refused(
                file,
                f"it was trained for actions with {side} {theirs.tolist()}, and {spaces.name} has "
                f"{ours.tolist()}",
            )


def _numbers(text: str) -> FloatArray:
    """Return the numbers of an array as NumPy prints it; none where it leaves some out."""
    words = text.replace("[", " ").replace("]", " ").split()
    try:
        return np.array([float(word) for word in words])
    except ValueError:
        return np.array([])


def _layers(file: Sb3File, kind: _Kind) -> list[nn.Linear]:
    """Return the layers from observation to action."""
    places = _places(file, kind.hidden)
    if places != list(range(0, 2 * len(places), 2)) or not (places or kind.out):
        raise _refused(file, f"its layers {kind.hidden} are {places}: not an MLP's")
    names = [f"{kind.hidden}.{place}" for place in places]
    layers = [_linear(file, name) for name in (*names, *([kind.out] if kind.out else []))]
    if any(a.out_features != b.in_features for a, b in pairwise(layers)):
        raise _refused(file, "its layers do not fit one another")
    return layers


def _places(file: Sb3File, hidden: str) -> list[int]:
    """Return the places of the layers in their Sequential, in order."""
    pattern = re.compile(r"([0-9]{1,3})\.(weight|bias)")
    found = set()
    for name in file.tensors:
        if name.startswith(f"{hidden}."):
            match = pattern.fullmatch(name.removeprefix(f"{hidden}."))
            if match is None:
                raise _refused(file, f"it has a layer {name:.60}: not an MLP's")
            found.add(int(match[1]))
    return sorted(found)


def _linear(file: Sb3File, name: str) -> nn.Linear:
    weight, bias = (file.tensors.get(f"{name}.{part}") for part in ("weight", "bias"))
    if weight is None or bias is None or weight.ndim != 2 or bias.shape != weight.shape[:1]:
        raise _refused(file, f"it has no layer {name} with weight and bias")
    if not all(t.dtype in _DTYPES for t in (weight, bias)):
        raise _refused(file, f"its layer {name} is of {weight.dtype} and {bias.dtype}, no floats")
    if not all(bool(t.isfinite().all()) for t in (weight, bias)):
        raise _refused(file, f"its layer {name} has weights that are no finite numbers")
    layer = nn.Linear(weight.shape[1], weight.shape[0])
    layer.load_state_dict({"weight": weight.float(), "bias": bias.float()})
    return layer


def _activation(file: Sb3File, kind: _Kind) -> str:
    """Return the name of the activation function in torch.nn."""
    named = file.data.get("policy_kwargs", {}).get("activation_fn")
    if named is None:
        return kind.activation
    found = re.fullmatch(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>", str(named))
    if found is None or found[1] not in _ACTIVATIONS:
        raise _refused(
            file, f"its activation function is {named}; known are {', '.join(_ACTIVATIONS)}"
        )
    return found[1]


def _network(layers: list[nn.Linear], activation: str) -> nn.Module:
    chain: list[nn.Module] = []
    for layer in layers:
        chain += [layer, getattr(nn, activation)()]
    return nn.Sequential(*chain[:-1]).eval()


def _text(data: Any, *keys: str) -> str:  # noqa: ANN401
    """Return a text in nested tables, empty where there is none."""
    for key in keys:
        data = data.get(key) if isinstance(data, dict) else None
    return data if isinstance(data, str) else ""


def _refused(file: Sb3File, why: str) -> ConfigError:
    return ConfigError(f"the teacher {file.path} cannot be read: {why}. {REMEDY}")
