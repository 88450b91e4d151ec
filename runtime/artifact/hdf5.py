"""The HDF5 container of a NIR file: written for a release of `nir`, and read without trusting it.

`nir.read` checks inner graphs when told not to, and does not say which node it cannot make. So the
container is checked before anything in it is read (hdf5_limits), and the graph is read node by
node.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import nir
import numpy as np
from nir.serialization import hdf2dict

from spikedeploy.runtime.artifact.hdf5_limits import check_container, check_file
from spikedeploy.runtime.errors import ArtifactError

# releases that refuse the field v_reset; then all that files were opened with
_WITHOUT_V_RESET = ("1.0.4", "1.0.5")
RELEASES = ("1.0.1", "1.0.3", *_WITHOUT_V_RESET, "1.0.6", "1.0.7", "1.0.8")
_REMEDY = "Export the network again, or correct the node."


def write_graph(path: Path, graph: nir.NIRGraph, older: str | None = None) -> None:
    """Write a file that a release of `nir` opens; ArtifactError where it has no such network."""
    if older is not None and older not in RELEASES:
        raise ArtifactError(f"nir {older} was not tried. Choose one of {', '.join(RELEASES)}.")
    nir.write(path, graph)
    if older not in _WITHOUT_V_RESET:
        return
    with h5py.File(path, "r+") as file:
        for name, node in file["node/nodes"].items():
            if "v_reset" not in node:
                continue
            if np.any(node["v_reset"][()]):
                raise ArtifactError(
                    f"node {name!r}: nir {older} has no v_reset, and it is not 0. Choose 1.0.6 or "
                    "later."
                )
            del node["v_reset"]


def read_graph(path: Path) -> nir.NIRGraph:
    """The graph in a HDF5 file, as written; ArtifactError where the file holds none.

    Whether the graph can be computed is for runtime.graph.validate to check.
    """
    try:
        longest = check_file(path)
        with h5py.File(path, "r") as file:
            check_container(file, path, longest)
            tree = hdf2dict(file["node"])
        if tree["type"] != "NIRGraph":
            raise ValueError(f"it holds a single {tree['type']} and no graph")
        return _graph(tree, "")
    except ArtifactError:
        raise
    # h5py and nir raise exceptions of many types for a damaged file
    except Exception as error:
        raise ArtifactError(
            f"cannot be read as a NIR graph: {type(error).__name__}: {error}. The file is "
            "truncated, damaged or of another format; copy or export it again."
        ) from error


def _graph(tree: Mapping[str, Any], path: str) -> nir.NIRGraph:
    unknown = sorted(set(tree) - {"type", "nodes", "edges", "metadata"})
    if unknown:
        raise ArtifactError(
            f"graph{f' {path[:-1]!r}' if path else ''} has the unknown field {unknown[0]!r}; NIR "
            f"knows nodes, edges and metadata. {_REMEDY}"
        )
    nodes = {name: _node(node, f"{path}{name}") for name, node in tree["nodes"].items()}
    edges = [(_text(source), _text(target)) for source, target in tree["edges"]]
    metadata = dict(tree.get("metadata", {}))
    return nir.NIRGraph(nodes, edges, metadata=metadata, type_check=False)


def _node(tree: object, path: str) -> nir.NIRNode:
    if not isinstance(tree, Mapping) or not isinstance(tree.get("type"), str):
        inner = f"{path}/{next(iter(tree))}" if isinstance(tree, Mapping) and tree else path
        raise ArtifactError(
            f"node {path!r} has no type. If it was called {inner!r}: HDF5 splits names at '/', so "
            "that such a name cannot be read back. Rename the node in the tool that wrote it."
        )
    kind = tree["type"]
    if kind == "NIRGraph":
        return _graph(tree, f"{path}.")
    if not isinstance(getattr(nir, kind, None), type):
        raise ArtifactError(
            f"node {path!r}: {kind[:40]!r} is no primitive of NIR. Use one, or update `nir` if the "
            "primitive is newer."
        )
    try:
        return nir.dict2NIRNode(dict(tree))
    # each primitive has its own exceptions, and most name neither node nor field
    except Exception as error:
        raise ArtifactError(
            f"node {path!r}: no {kind} can be made of {_shapes(tree)}: {error or 'nir refuses'}. "
            f"{_REMEDY}"
        ) from error


def _shapes(tree: Mapping[str, Any]) -> str:
    fields = {
        name: value for name, value in sorted(tree.items()) if name not in ("type", "metadata")
    }
    return ", ".join(f"{name} {np.shape(value)}" for name, value in fields.items()) or "nothing"


def _text(name: object) -> str:
    return name.decode() if isinstance(name, bytes) else str(name)
