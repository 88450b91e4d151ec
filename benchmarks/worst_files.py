"""Small files that were made to take minutes or gigabytes, and small sound ones of their kind."""

import json
import math
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import h5py
import nir
import numpy as np
from onnx import TensorProto, helper, numpy_helper

from benchmarks.fuzz_corpus import chain, lif, write_corpus
from spikedeploy.envs.kart import track_file

TWO = np.ones(2)


def small(suffix: str, folder: Path) -> Path:
    """A small sound file, so that reading it loads every library."""
    return next(path for path in write_corpus(folder / "corpus") if path.suffix == suffix)


def network(path: Path, change: Callable[[h5py.File, Any], object]) -> None:
    """A small network in which something was changed."""
    nir.write(path, chain([2], [2], weights=nir.Linear(np.eye(2)), cells=lif(2)))
    with h5py.File(path, "r+") as file:
        change(file, file["node/nodes"])


def zipped(rows: int, width: int, file: h5py.File, nodes: Any) -> None:  # noqa: ANN401
    """Weights of zeros in gzip, whose chunks are written as they are packed."""
    del nodes["weights/weight"]
    made = {"chunks": (1000, width), "compression": "gzip"}
    found = nodes["weights"].create_dataset("weight", (rows, width), "f8", **made)
    packed = zlib.compress(bytes(8000 * width), 9)
    for first in range(0, rows, 1000):
        found.id.write_direct_chunk((first, 0), packed)


def zeros(path: Path) -> None:
    """A sound network of 6 million weights that are zero, in gzip."""
    weights = nir.Linear(np.zeros((2000, 3000)))
    nir.write(path, chain([3000], [2000], weights=weights, cells=lif(2000)))


def sparse(file: h5py.File, nodes: Any) -> None:  # noqa: ANN401
    """Weights of which nothing is stored."""
    del nodes["weights/weight"]
    nodes["weights"].create_dataset("weight", (16_000, 16_000), "f8", fillvalue=1.0)


def holes(path: Path) -> None:
    """A network whose file goes on for gigabytes that the disk does not hold."""
    network(path, lambda *_: None)
    with path.open("r+b") as file:
        file.truncate(1_900_000_000)


def groups(file: h5py.File, nodes: Any) -> None:  # noqa: ANN401
    """Many empty groups."""
    for number in range(60_000):
        nodes.create_group(f"g{number}")


def scales(path: Path, count: int, link: Callable[[list[str]], Any]) -> None:
    """Nodes of a Scale, joined by `link`."""
    names = [f"s{number:04}" for number in range(count)]
    ends = {"input": nir.Input(np.array([2])), "output": nir.Output(np.array([2]))}
    joined = [("input", names[0]), *link(names), (names[-1], "output")]
    nodes = {name: nir.Scale(TWO) for name in names}
    graph = nir.NIRGraph({**ends, **nodes}, joined, type_check=False)
    nir.write(path, graph, compression=None)


def neurons(path: Path, count: int) -> None:
    """Neurons in gzip that are all alike."""
    cells = chain([count], [count], cells=nir.Threshold(np.ones(count, np.float32)))
    nir.write(path, cells)


def model(path: Path, nodes: list[Any], **constants: np.ndarray) -> None:
    """An ONNX policy of two observations."""
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["B", width])
        for name, width in (("x", 2), ("y", 1))
    ]
    held = [numpy_helper.from_array(np.asarray(a), n) for n, a in constants.items()]
    graph = helper.make_graph(nodes, "g", ends[:1], ends[1:], held)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path.write_bytes(made.SerializeToString())


def wide(path: Path) -> None:
    """A layer of 400,000 units."""
    nodes = [
        helper.make_node("MatMul", ["x", "w"], ["h"]),
        helper.make_node("MatMul", ["h", "v"], ["y"]),
    ]
    ones = np.ones((2, 400_000), np.float32)
    model(path, nodes, w=ones, v=ones[:1].T.copy())


def product(path: Path) -> None:
    """A product of two vectors that is a matrix of 1.6 GB."""
    nodes = [
        helper.make_node("MatMul", ["a", "b"], ["c"]),
        helper.make_node("ReduceMax", ["c"], ["m"], keepdims=0),
        helper.make_node("MatMul", ["x", "w"], ["p"]),
        helper.make_node("Add", ["p", "m"], ["y"]),
    ]
    column, one = np.ones((20_000, 1), np.float32), np.ones((2, 1), np.float32)
    model(path, nodes, a=column, b=column.T.copy(), w=one)


def endless(path: Path) -> None:
    """A Loop without an end."""
    boolean, number = TensorProto.BOOL, TensorProto.INT64
    info = helper.make_tensor_value_info
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["on"]), helper.make_node("Identity", ["a"], ["b"])],
        "body",
        [info("i", number, []), info("go", boolean, []), info("a", TensorProto.FLOAT, ["B", 2])],
        [info("on", boolean, []), info("b", TensorProto.FLOAT, ["B", 2])],
    )
    loop = helper.make_node("Loop", ["", "yes", "x"], ["z"], body=body)
    last = helper.make_node("MatMul", ["z", "w"], ["y"])
    model(path, [loop, last], yes=np.array(True), w=np.ones((2, 1), np.float32))


def filled(path: Path) -> None:
    """A ConstantOfShape of 2 GB."""
    nodes = [
        helper.make_node("ConstantOfShape", ["n"], ["big"]),
        helper.make_node("ReduceMax", ["big"], ["top"], keepdims=0),
        helper.make_node("MatMul", ["x", "w"], ["p"]),
        helper.make_node("Add", ["p", "top"], ["y"]),
    ]
    model(path, nodes, n=np.array([1 << 29]), w=np.ones((2, 1), np.float32))


def walls(path: Path, points: int) -> None:
    """A track with a wall of so many points."""
    record = json.loads((track_file.FOLDER / "small_S.json").read_text(encoding="utf-8"))
    angles = np.linspace(0, 2 * math.pi, points + 1)
    circle = 1500 * np.stack([np.cos(angles), np.sin(angles)], 1)
    record["walls"] = [np.round(circle, 3).tolist()]
    record["gates"], record["start"]["position"] = [[[100, -50], [100, 50]]], [0, 0]
    path.write_text(json.dumps(record))


def archive(path: Path, megabytes: int) -> None:
    """A .npz whose `input` (T, 2) is so many megabytes of zeros."""
    rows = megabytes * 62_500
    shape = {"descr": "<f8", "fortran_order": False, "shape": (rows, 2)}
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as made,
        made.open("input.npy", "w", force_zip64=True) as file,
    ):
        np.lib.format.write_array_header_1_0(file, shape)
        for _ in range(megabytes):
            file.write(bytes(1_000_000))


def raster(path: Path) -> None:
    """A .npy of which the disk holds nothing."""
    np.lib.format.open_memmap(path, mode="w+", dtype="f8", shape=(120_000_000, 2)).flush()


def text(path: Path, content: str) -> None:
    """A file of text."""
    path.write_text(content)


Writer = Callable[[Path], object]
FILES: dict[str, tuple[str, Writer]] = {
    "gzip, 2 GB of zeros": (".nir", partial(network, change=partial(zipped, 16_000, 16_000))),
    "gzip, 48 MB of zeros": (".nir", zeros),
    "HDF5, 2 GB not stored": (".nir", partial(network, change=sparse)),
    "HDF5, 1.9 GB of holes": (".nir", holes),
    "HDF5, 60,000 empty groups": (".nir", partial(network, change=groups)),
    "chain of 2,600 nodes": (".nir", partial(scales, count=2600, link=pairwise)),
    "chain of 4,000 nodes": (".nir", partial(scales, count=4000, link=pairwise)),
    "300 nodes, all to all": (
        ".nir",
        partial(scales, count=300, link=lambda names: combinations(names, 2)),
    ),
    "5 million neurons in gzip": (".nir", partial(neurons, count=5_000_000)),
    "1 million neurons in gzip": (".nir", partial(neurons, count=1_000_000)),
    "ONNX, 400,000 units": (".onnx", wide),
    "ONNX, a product of 1.6 GB": (".onnx", product),
    "ONNX, endless Loop": (".onnx", endless),
    "ONNX, ConstantOfShape of 2 GB": (".onnx", filled),
    ".npz, 1 GB of zeros": (".npz", partial(archive, megabytes=1000)),
    ".npz, 120 MB of zeros": (".npz", partial(archive, megabytes=120)),
    ".npy, 1.9 GB of holes": (".npy", raster),
    "track of 200,000 points": (".track", partial(walls, points=200_000)),
    "track of 19,000 points": (".track", partial(walls, points=19_000)),
    "JSON, a million brackets": (".track", partial(text, content="[" * 1_000_000)),
    "TOML, a million brackets": (".toml", partial(text, content="x = " + "[" * 1_000_000)),
    "TOML, 10^9 units": (".toml", partial(text, content="[policy]\nhidden = [1000000000]\n")),
}
