"""Mutations of arrays in .npy and .npz, of models in .zip, and of a TOML file's lines."""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from benchmarks.fuzz_json import JSON

Rng: TypeAlias = np.random.Generator


def _arrays(path: Path) -> dict[str, Any]:
    with path.open("rb") as file, np.load(file) as archive:
        return dict(archive)


def _write(path: Path, arrays: dict[str, Any]) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def other_array(path: Path, rng: Rng) -> None:
    """An array has other numbers, axes or another type."""
    arrays = _arrays(path)
    name = str(rng.choice(sorted(arrays)))
    old = arrays[name]
    values: list[Any] = [
        np.full(old.shape, np.nan), np.full(old.shape, -1), np.zeros(old.shape, complex),
        old[None], old.ravel()[:0], old.ravel()[:1], np.array("text"), np.array("[" * 100_000),
        np.full(old.shape, 2**62), np.array({}, dtype=object), np.zeros(old.shape, "M8[s]"),
        np.zeros((3, 3, 3)), np.array('{"version": 1, "env_id": 3, "options": []}'),
        np.zeros(1 << 17), np.zeros(old.shape, [("a", "f8")]),
    ]  # fmt: skip
    arrays[name] = values[rng.integers(len(values))]
    _write(path, arrays)


def missing_array(path: Path, rng: Rng) -> None:
    """An array is missing, or is there under another name."""
    arrays = _arrays(path)
    moved = arrays.pop(str(rng.choice(sorted(arrays))))
    _write(path, {**arrays, **({"../x": moved} if rng.random() < 0.5 else {})})


def archive_bomb(path: Path, rng: Rng) -> None:
    """A member that unpacks to hundreds of megabytes."""
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        name, size = f"more{rng.integers(1 << 30)}.npy", 70 << 20 if rng.random() < 0.1 else 1 << 20
        archive.writestr(name, bytes(size), compresslevel=1)


def toml_line(path: Path, rng: Rng) -> None:
    """A strange line, or a strange value."""
    lines = path.read_text().splitlines()
    values = [
        "[" * 5000,
        "9" * 5000,
        "nan",
        "-1",
        "1e999",
        "[[[]]]",
        "{}",
        "'x'",
        "2020-01-01",
        "[",
    ]
    value = str(rng.choice(values))
    keys = ("hidden", "count", "steps", "seed", "batch", "env", "x.y.z", "learning_rate")
    new = value if rng.random() < 0.2 else f"{rng.choice(keys)} = {value}"
    lines[int(rng.integers(len(lines)))] = new
    path.write_text("\n".join(lines))


def other_header(path: Path, rng: Rng) -> None:
    """A .npy file's header says something else than the file holds."""
    kinds = ("<f8", "|u1", "<f2", ">i8", "|O", "<U9", "<M8[s]", "<c16", "|V3", "<f16", "?", "x", "")
    shapes = ("()", "(0,)", "(4,4)", "(-1,)", "(1<<9,)", "(2**62,4)", "(9,)*9", "4", "(True,)",
              "(100000000,)", "(" + "9" * 30 + ",)", "(1," * 900)  # fmt: skip
    order = rng.choice(("False", "True", "None"))
    text = f"{{'descr': '{rng.choice(kinds)}', 'fortran_order': {order}, "
    text += f"'shape': {rng.choice(shapes)}}}"
    text = str(rng.choice((text, text, text, "{}", "(" * 60_000, "__import__('os').getcwd()")))
    head = text.encode() + b"\n"
    body = path.read_bytes()[128:]
    path.write_bytes(b"\x93NUMPY\x02\x00" + len(head).to_bytes(4, "little") + head + body)


def numpy_array(path: Path, rng: Rng) -> None:
    """A .npy file holds other numbers, axes or another type."""
    old = np.load(path)
    plain = old.real  # after another mutation it may be complex
    values: list[Any] = [
        old[0], old.ravel()[:0], np.array(1.0), old * np.nan, -plain.astype(float), old * 1e300,
        plain.astype(np.float16), old > 0, old.astype(complex), old.astype("U5"), old[None, None],
        np.zeros(old.shape, "M8[s]"), np.zeros(old.shape, [("a", "f8")]), np.full((2, 1 << 20), 7),
    ]  # fmt: skip
    np.save(path, values[rng.integers(len(values))])


def _members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _pack(path: Path, members: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def model_json(path: Path, rng: Rng) -> None:
    """A value of the settings in a model of Stable-Baselines3."""
    members, text = _members(path), path.with_suffix(".data")
    text.write_bytes(members["data"])
    JSON[rng.integers(len(JSON))](text, rng)
    _pack(path, {**members, "data": text.read_bytes()})
    text.unlink()


def model_setting(path: Path, rng: Rng) -> None:
    """A setting that decides what a model of Stable-Baselines3 computes."""
    members = _members(path)
    keys = ("policy_class", "policy_kwargs", "observation_space", "action_space", "use_sde",
            "_last_original_obs", "activation_fn", "net_arch")  # fmt: skip
    values = (None, 0, "text", [], {}, True, {"__module__": "os"}, {":type:": "<class 'x.Dict'>"},
              {"activation_fn": "<class 'torch.nn.modules.activation.ReLU'>"})  # fmt: skip
    said = json.loads(members["data"])
    said[keys[rng.integers(len(keys))]] = values[rng.integers(len(values))]
    _pack(path, {**members, "data": json.dumps(said).encode()})


def model_tensor(path: Path, rng: Rng) -> None:
    """A tensor of the policy is missing, or has other numbers, axes or another type."""
    import torch

    members = _members(path)
    tensors = dict(torch.load(io.BytesIO(members["policy.pth"]), weights_only=True))
    name = sorted(tensors)[rng.integers(len(tensors))]
    old = tensors.pop(name)
    values: list[Callable[[], Any]] = [
        lambda: old * float("nan"), lambda: old[None], lambda: old.flatten()[:0],
        lambda: old.long(), lambda: old.to(torch.complex64), lambda: old.half(), lambda: 3,
        lambda: "text", lambda: old.to_sparse(), lambda: torch.zeros(3, 3, 3), lambda: [old],
        lambda: torch.zeros(1).expand(1 << 20, 1 << 10), lambda: torch.empty(2, device="meta"),
    ]  # fmt: skip
    if rng.random() < 0.9:
        tensors[str(rng.choice((name, name, name, "x", "lstm")))] = values[
            rng.integers(len(values))
        ]()
    buffer = io.BytesIO()
    torch.save(tensors if rng.random() < 0.95 else [tensors], buffer)
    _pack(path, {**members, "policy.pth": buffer.getvalue()})


def model_member(path: Path, rng: Rng) -> None:
    """A member is missing, cut, or has other bytes, with the right check sum."""
    members = _members(path)
    name = ("data", "policy.pth")[rng.integers(2)]
    content = bytearray(members.pop(name))
    for _ in range(rng.integers(0, 20)):
        content[rng.integers(len(content))] = rng.integers(256)
    if rng.random() < 0.8:
        members[name] = bytes(content[: len(content) if rng.random() < 0.7 else rng.integers(9999)])
    _pack(path, members)


NUMPY = [other_header, numpy_array]
MODELS = [model_json, model_setting, model_tensor, model_tensor, model_member, model_member]
ARCHIVES = [*[other_array] * 5, missing_array, archive_bomb]
TOML = [toml_line]
