"""Mutations of an HDF5 file's tree: its arrays, groups and links."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import h5py
import numpy as np

Rng: TypeAlias = np.random.Generator
STRANGE = (np.nan, np.inf, -np.inf, -1.0, 0.0, 1e-300, 1e300, 0.5, 2.0**31, -(2.0**63))
KINDS = (
    "Affine", "Linear", "Scale", "Conv1d", "Conv2d", "Flatten", "SumPool2d", "AvgPool2d", "Delay",
    "Threshold", "I", "IF", "LI", "LIF", "CubaLI", "CubaLIF", "Input", "Output", "NIRGraph", "Foo",
)  # fmt: skip


def a_dataset(file: h5py.File, rng: Rng) -> str:
    """The name of one."""
    return _one(file, rng, h5py.Dataset)


def a_group(file: h5py.File, rng: Rng) -> str:
    """The name of one."""
    return _one(file, rng, h5py.Group)


def _one(file: h5py.File, rng: Rng, kind: type) -> str:
    names: list[str] = []
    file.visititems(lambda name, thing: names.append(name) if isinstance(thing, kind) else None)
    return names[rng.integers(len(names))]


def replace(file: h5py.File, name: str, value: object, **how: object) -> None:
    """Replace a value under the same name."""
    del file[name]
    file.create_dataset(name, data=value, **how)


def strange_value(path: Path, rng: Rng) -> None:
    """One number, or all of an array, is NaN, infinite, negative, zero, tiny or huge."""
    with h5py.File(path, "r+") as file:
        name = a_dataset(file, rng)
        value = np.asarray(file[name][()])
        if value.dtype.kind not in "fiu":
            replace(file, name, "".join(chr(c) for c in rng.integers(1, 500, 5)))
            return
        value = np.array(value, np.float64) if rng.random() < 0.5 else np.array(value)
        new = rng.choice(STRANGE)
        with np.errstate(all="ignore"):
            cast = np.array(new).astype(value.dtype)
        if rng.random() < 0.5 or not value.size:
            value[...] = cast
        else:
            value.flat[rng.integers(value.size)] = cast
        replace(file, name, value)


def other_value(path: Path, rng: Rng) -> None:
    """Plausible other numbers: reversed, scaled, or small whole ones."""
    with h5py.File(path, "r+") as file:
        name = a_dataset(file, rng)
        value = np.asarray(file[name][()])
        if value.dtype.kind in "iu":
            replace(file, name, rng.integers(0, 5, value.shape).astype(value.dtype))
        elif value.dtype.kind == "f":
            forms = [
                -value,
                value * 10 ** rng.uniform(-6, 6),
                rng.normal(size=value.shape),
                np.where(rng.random(value.shape) < 0.5, value, 0.0),
                np.rint(value),
            ]
            replace(file, name, forms[rng.integers(len(forms))])
        else:
            strange_value(path, rng)


def strange_shape(path: Path, rng: Rng) -> None:
    """An array without axes, empty, longer, transposed, or with another axis."""
    with h5py.File(path, "r+") as file:
        name = a_dataset(file, rng)
        value = np.asarray(file[name][()])
        forms: list[Callable[[], object]] = [
            lambda: value.ravel()[0],
            lambda: value.ravel()[:0],
            lambda: np.concatenate([value.ravel(), value.ravel()[:1]]),
            lambda: value.T,
            lambda: value[None],
            lambda: value[..., None],
            lambda: value.ravel()[:-1],
            lambda: np.broadcast_to(value.ravel()[0], (1,) * int(rng.integers(1, 30))),
        ]
        replace(file, name, forms[rng.integers(len(forms))]())


def strange_type(path: Path, rng: Rng) -> None:
    """Another type for numbers: text, bool, complex, records, references, dates or nothing."""
    with h5py.File(path, "r+") as file:
        name = a_dataset(file, rng)
        shape = np.shape(file[name][()])
        values: list[object] = [
            "text",
            np.full(shape, b"x"),
            np.zeros(shape, bool),
            np.zeros(shape, complex),
            np.zeros(shape, [("a", "f8"), ("b", "i4")]),
            np.full(shape, 3, np.uint64),
            np.full(shape, -3, np.int8),
            np.zeros(shape, np.float16),
            h5py.Empty("f8"),
            np.array(["a", "b"], dtype=h5py.string_dtype()),
            np.full(shape, 2**64 - 1, np.uint64),
            file.ref,
        ]
        replace(file, name, values[rng.integers(len(values))])


def missing(path: Path, rng: Rng) -> None:
    """A group or an array is deleted."""
    with h5py.File(path, "r+") as file:
        del file[a_dataset(file, rng) if rng.random() < 0.5 else a_group(file, rng)]


def renamed(path: Path, rng: Rng) -> None:
    """A group or an array is renamed."""
    names = ("a/b", "x", "input", "output", "é", "a.b", " ", "nodes", "metadata", "type", "z" * 999)
    with h5py.File(path, "r+") as file:
        name = a_dataset(file, rng) if rng.random() < 0.5 else a_group(file, rng)
        parent = name.rpartition("/")[0]
        file.move(name, f"{parent}/{rng.choice(names)}")


def stray(path: Path, rng: Rng) -> None:
    """An array or a group where none belongs."""
    with h5py.File(path, "r+") as file:
        group = file[a_group(file, rng)]
        if rng.random() < 0.5:
            group.create_group("stray").create_dataset("type", data=str(rng.choice(KINDS)))
        else:
            group["stray"] = np.arange(3.0)


def other_kind(path: Path, rng: Rng) -> None:
    """A node has another type."""
    with h5py.File(path, "r+") as file:
        types: list[str] = []
        file.visititems(lambda n, _: types.append(n) if n.endswith("/type") else None)
        replace(file, types[rng.integers(len(types))], str(rng.choice(KINDS)))


def other_edges(path: Path, rng: Rng) -> None:
    """Edges that form cycles, are duplicated, lead nowhere, or are not pairs."""
    with h5py.File(path, "r+") as file:
        names = [*file["node/nodes"], "nobody"]
        edges = [tuple(edge) for edge in file["node/edges"][()].astype(str)]
        edges += [tuple(map(str, rng.choice(names, 2))) for _ in range(rng.integers(1, 4))]
        if rng.random() < 0.3:
            edges = edges[rng.integers(len(edges)) :] + edges[:1]
        triple = rng.random() < 0.05
        table = [(*edge, "x") if triple else edge for edge in edges]
        replace(file, "node/edges", np.array(table, dtype=h5py.string_dtype()))


def huge_claim(path: Path, rng: Rng) -> None:
    """An array with nothing stored, or one that is compressed a thousandfold."""
    with h5py.File(path, "r+") as file:
        name = a_dataset(file, rng)
        del file[name]
        if rng.random() < 0.5:
            side = int(2 ** rng.integers(8, 30))
            file.create_dataset(name, (side, side), "f8", chunks=(64, 64), fillvalue=1.0)
        else:
            side = int(2 ** rng.integers(4, 11))
            packed = {"chunks": (side, side), "compression": "gzip"}
            file.create_dataset(name, data=np.ones((side, side)), **packed)


def huge_shape(path: Path, rng: Rng) -> None:
    """A shape, a kernel, a padding or a stride of millions."""
    fields = ("shape", "padding", "stride", "kernel_size", "dilation", "groups", "input_shape")
    with h5py.File(path, "r+") as file:
        found: list[str] = []
        ends = (*fields, "input_type", "start_dim", "end_dim", "output_type")
        file.visititems(lambda n, _: found.append(n) if n.rpartition("/")[2] in ends else None)
        name = found[rng.integers(len(found))]
        value = np.asarray(file[name][()])
        new = int(rng.choice([0, -1, 2, 7, 999, 10**5, 2**24, 2**31, 2**62]))
        replace(file, name, np.full(value.shape, new))


def link(path: Path, rng: Rng) -> None:
    """A link to itself, to its parent, to nothing, or to another file."""
    with h5py.File(path, "r+") as file:
        group = file[a_group(file, rng)]
        targets: list[Any] = [
            h5py.SoftLink(f"{group.name}/link"),
            h5py.SoftLink("/nowhere"),
            h5py.SoftLink("/"),
            h5py.ExternalLink("other.nir", "/node"),
            h5py.ExternalLink(path.name, "/"),
            h5py.ExternalLink("/dev/zero", "/"),
            file["/"],
            group,
            file["node"],
        ]
        group["link"] = targets[rng.integers(len(targets))]


def elsewhere(path: Path, rng: Rng) -> None:
    """An array with external storage."""
    with h5py.File(path, "r+") as file:
        name = a_dataset(file, rng)
        shape = np.shape(file[name][()])
        del file[name]
        if rng.random() < 0.5:
            file.create_dataset(name, shape or (1,), "f8", external=[("/etc/passwd", 0, 8 << 20)])
        else:
            layout = h5py.VirtualLayout(shape=(4,), dtype="f8")
            layout[:] = h5py.VirtualSource(str(rng.choice(["x.h5", "."])), "data", shape=(4,))
            file.create_virtual_dataset(name, layout)


def deep(path: Path, rng: Rng) -> None:
    """Deeply nested graphs or groups."""
    with h5py.File(path, "r+") as file:
        group = file["node"] if rng.random() < 0.5 else file[a_group(file, rng)]
        for _ in range(rng.choice([3, 20, 150])):
            group = group.require_group("nodes").create_group("deeper")
            if rng.random() < 0.99:
                group["type"] = "NIRGraph"
                group["edges"] = np.array([("a", "b")], dtype=h5py.string_dtype())


def many(path: Path, rng: Rng) -> None:
    """A long chain of nodes."""
    with h5py.File(path, "r+") as file:
        nodes, before = file["node/nodes"], "input"
        edges = [tuple(edge) for edge in file["node/edges"][()].astype(str)]
        for k in range(int(rng.choice([5, 5, 5, 100]))):
            node = nodes.create_group(f"many{k}")
            node["type"], node["scale"] = "Scale", np.ones(int(rng.choice([1, 3, 3, 3])))
            edges.append((before, f"many{k}"))
            before = f"many{k}"
        edges.append((before, str(rng.choice([*nodes]))))
        replace(file, "node/edges", np.array(edges, dtype=h5py.string_dtype()))


def attribute(path: Path, rng: Rng) -> None:
    """An attribute where none belongs."""
    with h5py.File(path, "r+") as file:
        file[a_group(file, rng)].attrs["remark"] = rng.random(int(rng.integers(1, 100)))


HDF5 = [
    strange_value, strange_shape, strange_type, missing, renamed, stray, other_kind, other_edges,
    huge_claim, huge_shape, link, elsewhere, deep, many, attribute, strange_value, strange_shape,
    *[other_value] * 12, huge_shape,
]  # fmt: skip
# those that need no graph
ARRAYS = [
    strange_value, strange_shape, strange_type, missing, renamed, stray, huge_claim, link,
    elsewhere, attribute, other_value,
]  # fmt: skip
