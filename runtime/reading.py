"""Reading a NIR file node by node, so that what cannot be read has a name.

`nir.read` checks the shapes of inner graphs even when it is told not to, and says of a node that
cannot be made only that it cannot.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import nir
import numpy as np
from nir.serialization import hdf2dict

from runtime.container import check_container
from runtime.errors import ArtifactError
from runtime.heap import check_heaps

REMEDY = "Export the network again, or correct the node."


def read_graph(path: Path) -> nir.NIRGraph:
    """The graph in a HDF5 file, as it is written there; nothing is checked but that it is one."""
    check_heaps(path)
    try:
        with h5py.File(path, "r") as file:
            check_container(file, path)
            tree = hdf2dict(file["node"])
        if tree["type"] != "NIRGraph":
            raise ValueError(f"it holds a single {tree['type']} and no graph")
        return _graph(tree, "")
    except ArtifactError:
        raise
    # h5py and nir raise nearly anything when a file is not what they expect
    except Exception as error:
        raise ArtifactError(
            f"cannot be read as a NIR graph: {type(error).__name__}: {error}. The file is "
            "truncated, damaged or something else; copy or export it again."
        ) from error


def _graph(tree: Mapping[str, Any], path: str) -> nir.NIRGraph:
    unknown = sorted(set(tree) - {"type", "nodes", "edges", "metadata"})
    if unknown:
        raise ArtifactError(
            f"graph{f' {path[:-1]!r}' if path else ''} has the unknown field {unknown[0]!r}; NIR "
            f"knows nodes, edges and metadata. {REMEDY}"
        )
    nodes = {name: _node(node, f"{path}{name}") for name, node in tree["nodes"].items()}
    edges = [(_text(source), _text(target)) for source, target in tree["edges"]]
    metadata = dict(tree.get("metadata", {}))
    return nir.NIRGraph(nodes, edges, metadata=metadata, type_check=False)


def _node(tree: object, path: str) -> nir.NIRNode:
    if not isinstance(tree, Mapping) or not isinstance(tree.get("type"), str):
        inner = f"{path}/{next(iter(tree))}" if isinstance(tree, Mapping) and tree else path
        raise ArtifactError(
            f"node {path!r} has no type. If it was called {inner!r}: HDF5 takes a '/' apart, so "
            "that such a name cannot be read back. Rename the node in the tool that wrote it."
        )
    kind = tree["type"]
    if kind == "NIRGraph":
        return _graph(tree, f"{path}.")
    if not isinstance(getattr(nir, kind, None), type):
        raise ArtifactError(
            f"node {path!r}: {kind[:40]!r} is no primitive of NIR. Write it with those, or update "
            "`nir` if it is newer."
        )
    try:
        return nir.dict2NIRNode(dict(tree))
    # each kind has errors of its own, and most do not say which node or which field
    except Exception as error:
        raise ArtifactError(
            f"node {path!r}: no {kind} can be made of {_shapes(tree)}: {error or 'nir refuses'}. "
            f"{REMEDY}"
        ) from error


def _shapes(tree: Mapping[str, Any]) -> str:
    fields = {
        name: value for name, value in sorted(tree.items()) if name not in ("type", "metadata")
    }
    return ", ".join(f"{name} {np.shape(value)}" for name, value in fields.items()) or "nothing"


def _text(name: object) -> str:
    return name.decode() if isinstance(name, bytes) else str(name)
