"""The artifact: one `.nir` file with all a robot needs; the only reader and writer of `.nir`."""

import copy
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import nir
import numpy as np

from spikedeploy.runtime.artifact.hdf5 import read_graph, write_graph
from spikedeploy.runtime.codec.codec import Codec
from spikedeploy.runtime.convention import (
    Convention,
    Floor,
    Integrator,
    Reset,
    SpikeCondition,
    State,
    check_timestep,
)
from spikedeploy.runtime.dialects.reading import finite_nodes, read_as_written, read_like
from spikedeploy.runtime.dialects.rewriting import rewrite_for
from spikedeploy.runtime.errors import ArtifactError, ConventionError
from spikedeploy.runtime.files import replacing
from spikedeploy.runtime.graph.discretisation import (
    NEURONS,
    DiscreteNeuron,
    SigmaDelta,
    check_sigma_delta,
    discretise,
    infer_convention,
    infer_timestep,
)
from spikedeploy.runtime.graph.normal_form import (
    flatten,
    with_floats,
    with_full_parameters,
    without_batch_axis,
)
from spikedeploy.runtime.graph.order import Timing, delay_timesteps, timing
from spikedeploy.runtime.graph.shapes import check_size
from spikedeploy.runtime.graph.validate import (
    DERIVED_FIELDS,
    check_graph,
    check_neurons,
    check_nodes,
)
from spikedeploy.runtime.metadata import Provenance, Record, Tree

_SCHEMA = 1
_KEY = "spikedeploy"


@dataclass(frozen=True, eq=False)
class Artifact:
    """A network and everything that NIR leaves open; ArtifactError where they are inconsistent.

    graph: standard NIR nodes; nested graphs are flattened. results/interop.md lists the tools that
        compute the same from them. Neurons, order and delays are derived from it once: after a
        change in place, only `dataclasses.replace(artifact)` derives them again.
    codec: observation to spikes and output to action; None in files of other tools.
    convention: how the graph is discretised; inferred or given for files of other tools.
    provenance: where the policy comes from; None in files of other tools.
    sigma_delta: sigma-delta neurons by the name of their node `I`: what NIR cannot express.
    tuned: what `adapt` changed since the policy was exported, in words; empty where nothing.
    neurons: the difference equation of each node of neurons, by name.
    """

    graph: nir.NIRGraph
    codec: Codec | None
    convention: Convention
    provenance: Provenance | None = None
    sigma_delta: Mapping[str, SigmaDelta] = field(default_factory=dict)
    tuned: str = ""
    neurons: dict[str, DiscreteNeuron] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "graph", flatten(self.graph))
        check_graph(self.graph)
        check_sigma_delta(self.graph, self.sigma_delta)
        self._discretise()
        if self.codec is not None:
            self._check_width(self.codec)

    def _discretise(self) -> None:
        nodes = sorted(self.graph.nodes.items())
        for name, node in nodes:
            if isinstance(node, nir.Delay):
                delay_timesteps(name, node, self.convention)
        neurons = {n: discretise(n, m, self.convention) for n, m in nodes if isinstance(m, NEURONS)}
        object.__setattr__(self, "neurons", neurons)

    def _check_width(self, codec: Codec) -> None:
        inputs, outputs = self.graph.inputs, self.graph.outputs
        if len(inputs) != 1 or len(outputs) != 1:
            raise ArtifactError(
                f"a codec needs one Input and one Output node; the graph has the inputs "
                f"{', '.join(sorted(inputs))} and the outputs {', '.join(sorted(outputs))}. Join "
                "them, or store the graph without a codec."
            )
        (name,) = inputs
        if (width := int(np.prod(inputs[name].input_type["input"]))) != codec.encoder.width:
            raise ArtifactError(
                f"the codec makes {codec.encoder.width} spike trains, node {name!r} takes {width}. "
                "Export the policy again."
            )

    @cached_property
    def timing(self) -> Timing:
        """The timing of nodes: the order in which they run, and the delays of their outputs."""
        return timing(self.graph, self.convention)

    @property
    def trained_for(self) -> str:
        """The chip alone on which the policy computes as it was trained to; empty where none is."""
        return self.provenance.chip if self.provenance else ""

    def with_convention(self, convention: Convention) -> "Artifact":
        """The artifact under another convention; its graph is not checked again."""
        other = copy.copy(self)
        other.__dict__.pop("timing", None)
        object.__setattr__(other, "convention", convention)
        other._discretise()
        return other

    def with_numbers(self, graph: nir.NIRGraph) -> "Artifact":
        """The artifact with other numbers at the same nodes, of which only neurons are checked."""
        other = copy.copy(self)
        object.__setattr__(other, "graph", graph)
        for name, node in graph.nodes.items():
            if isinstance(node, NEURONS):
                check_neurons(name, node)
            elif isinstance(node, nir.Delay):
                other.__dict__.pop("timing", None)
        other._discretise()
        return other


def save(artifact: Artifact, path: str | Path, older: str | None = None) -> None:
    """Write a file; equal artifacts give equal bytes, and an interruption leaves the old file.

    Raises ArtifactError where it cannot be written, for release `older` of `nir` if one is given.
    """
    try:
        with replacing(Path(path)) as part:
            write_graph(part, _stamped(artifact), older)
    except (OSError, AttributeError, TypeError, ValueError) as error:
        raise ArtifactError(
            f"cannot write {path}: {error}. Check the folder and the metadata of the graph."
        ) from error


def load(
    path: str | Path,
    dt: float | None = None,
    reset: Reset | None = None,
    integrator: Integrator | None = None,
    delay: int | None = None,
    state: State | None = None,
    spikes: SpikeCondition | None = None,
    floor: Floor | None = None,
    like: str | None = None,
    written_by: str | None = None,
) -> Artifact:
    """The artifact in a `.nir` file, ours or another tool's.

    dt: [s]; like reset, integrator, delay, state, spikes and floor an option of Convention, which
        replaces what the file states.
    like: name of one of the PRESETS: read the file as that tool does.
    written_by: name of one of the WRITERS: read the file as that tool means what it writes. Options
        say what its files do not; what was assumed is in the source of the convention.

    Raises ArtifactError or ConventionError, with the path, where the file cannot be read or run.
    """
    options = dict(
        dt=dt, reset=reset, integrator=integrator, delay=delay, state=state, spikes=spikes,
        floor=floor, like=like, written_by=written_by,
    )  # fmt: skip
    try:
        artifact = interpret(_read(Path(path)), options)
        check_size(artifact.graph, Path(path).stat().st_size)
    except (ArtifactError, ConventionError) as error:
        raise type(error)(f"{path}: {error}") from error
    return artifact


def read_graph_of(path: str | Path) -> nir.NIRGraph:
    """The graph in a file, in one level, for `interpret`; ArtifactError, with the path."""
    try:
        return _read(Path(path))
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from error


def interpret(graph: nir.NIRGraph, options: Mapping[str, Any]) -> Artifact:
    """The artifact of a file's graph, which stays as it is, under the options of `load`.

    Raises ArtifactError or ConventionError where the graph cannot be read or run.
    """
    given = {name: value for name, value in options.items() if value is not None}
    like, written_by = given.pop("like", None), given.pop("written_by", None)
    if "dt" in given:
        check_timestep(given["dt"])
    if like is not None and written_by is not None:
        raise ConventionError(
            f"--like {like} is how a tool reads the file, --from {written_by} how a tool wrote "
            "it. Give one of them."
        )
    again = nir.NIRGraph(
        dict(graph.nodes), list(graph.edges), metadata=dict(graph.metadata), type_check=False
    )
    return _artifact_of_graph(again, given, like, written_by)


def for_importer(artifact: Artifact, tool: str) -> Artifact:
    """Return the artifact that a tool reads as this network; ConventionError where it cannot."""
    if artifact.sigma_delta:
        raise ConventionError(
            f"--for {tool}: it would sum up what sigma-delta neurons rectify and round. Without "
            "--for the network is written as it is."
        )
    graph, convention = rewrite_for(artifact.graph, artifact.convention, tool)
    return replace(artifact, graph=graph, convention=convention)


def digest(artifact: Artifact) -> str:
    """SHA-256 of everything that decides what the policy does: network, codec and convention."""
    nodes = {
        name: {
            **{key: value for key, value in vars(node).items() if key not in DERIVED_FIELDS},
            "type": type(node).__name__,
        }
        for name, node in artifact.graph.nodes.items()
    }
    edges = repr(sorted(artifact.graph.edges))
    sha = hashlib.sha256()
    for part in _parts("", {**_record(artifact), "nodes": nodes, "edges": edges}):
        sha.update(part)
    return sha.hexdigest()


def _parts(path: str, tree: Mapping[str, object]) -> Iterator[bytes | memoryview]:
    """Names and values, sorted by name; arrays with dtype and shape, in C order."""
    for name, value in sorted(tree.items()):
        here = f"{path}/{name}"
        if isinstance(value, dict):
            yield from _parts(here, value)
        elif isinstance(value, str):
            yield f"{here} {value}".encode()
        else:
            numbers = np.ascontiguousarray(value)
            yield f"{here} {numbers.dtype.str} {numbers.shape}".encode()
            yield numbers.data


def _stamped(artifact: Artifact) -> nir.NIRGraph:
    record = _record(artifact)
    if artifact.provenance is not None:
        record["origin"] = replace(artifact.provenance, sha256=digest(artifact)).to_record()
    return nir.NIRGraph(
        nodes=dict(sorted(artifact.graph.nodes.items())),
        edges=sorted(artifact.graph.edges),
        metadata={**artifact.graph.metadata, _KEY: record},
        type_check=False,
    )


def _record(artifact: Artifact) -> Tree:
    """The metadata without the provenance."""
    record: Tree = {"schema": _SCHEMA, "convention": artifact.convention.to_record()}
    if artifact.codec is not None:
        record["codec"] = artifact.codec.to_record()
    if artifact.sigma_delta:
        record["sigma_delta"] = {n: each.to_record() for n, each in artifact.sigma_delta.items()}
    if artifact.tuned:
        record["tuned"] = artifact.tuned
    return record


def _read(path: Path) -> nir.NIRGraph:
    """The graph in the file, in one level."""
    if not path.is_file():
        raise ArtifactError("there is no such file. Check the path.")
    if path.suffix in (".pt", ".pth", ".ckpt"):
        raise ArtifactError(
            "a file of torch, not NIR. Load the module in Python, and export it: "
            "spikedeploy.export(module, 'net.nir', input_shape=(64,))."
        )
    if not h5py.is_hdf5(path):
        raise ArtifactError(
            "not an HDF5 file, so not NIR. Give the .nir file that `spikedeploy export` or another "
            "NIR tool wrote; if it is that file, copy it again, it is truncated."
        )
    return without_batch_axis(flatten(read_graph(path)))


def _artifact_of_graph(
    graph: nir.NIRGraph, given: Mapping[str, object], like: str | None, written_by: str | None
) -> Artifact:
    """The artifact of a graph: ours as stored, another tool's as it is read, written or inferred.

    As another tool reads a file of ours, its convention and provenance are ignored.
    """
    codec = None
    if _KEY in graph.metadata:
        if written_by is not None:
            raise ConventionError(
                f"--from {written_by}: spikedeploy wrote this file, and its metadata state the "
                "convention. Leave --from away; --like reads it as another tool would."
            )
        stored = _artifact_of_ours(graph)
        if like is None:
            return stored.with_convention(stored.convention.with_options(given))
        graph, codec = stored.graph, stored.codec
    else:
        if written_by is not None:
            graph = finite_nodes(graph, written_by)
        check_nodes(graph)
        graph = with_full_parameters(with_floats(graph))
        check_graph(graph)
    if like is not None:
        graph, convention = read_like(graph, like, given)
    elif written_by is not None:
        graph, convention = read_as_written(graph, written_by, given)
    else:
        convention = infer_convention(graph, given)
    return Artifact(graph, codec, convention)


def _artifact_of_ours(graph: nir.NIRGraph) -> Artifact:
    """The artifact of a graph with our metadata; ArtifactError where they contradict each other."""
    record = Record(graph.metadata, "file").group(_KEY)
    record.only("schema", "convention", "codec", "origin", "sigma_delta", "tuned")
    if (schema := record.integer("schema")) != _SCHEMA:
        raise ArtifactError(
            f"metadata {record.where}.schema is {schema}; this version reads {_SCHEMA}. "
            "Update spikedeploy, or export the policy again."
        )
    try:
        convention = Convention.from_record(record.group("convention"))
    except ConventionError as error:
        raise ArtifactError(f"metadata {record.where}.convention: {error}") from error
    codec = Codec.from_record(record.group("codec")) if "codec" in record else None
    # "origin" is the key of the file format
    found = Provenance.from_record(record.group("origin")) if "origin" in record else None
    graded = record.group("sigma_delta") if "sigma_delta" in record else Record({}, "")
    neurons = {name: SigmaDelta.from_record(graded.group(name)) for name in sorted(graded.fields)}
    tuned = record.text("tuned") if "tuned" in record else ""
    del graph.metadata[_KEY]
    artifact = Artifact(graph, codec, convention, found, neurons, tuned)
    evidence = infer_timestep(graph)
    agrees = evidence.dt is None or np.isclose(evidence.dt, convention.dt, rtol=1e-3)
    if evidence.confirmed and not agrees:
        raise ArtifactError(
            f"the metadata state dt = {convention.dt:g} s, the nodes {evidence.dt:g} s "
            f"({evidence.reason}). Export the policy again."
        )
    if found is not None and (sha256 := digest(artifact)) != found.sha256:
        raise ArtifactError(
            f"the policy is not the one that was exported: its SHA-256 is {sha256[:12]}…, its "
            f"provenance states {found.sha256[:12]}…. Export the policy again; if the change "
            f"is intended, delete metadata/{_KEY}/origin from the file."
        )
    # after the digest, which is of the numbers as they were exported
    floats = with_floats(graph)
    return artifact if floats is graph else replace(artifact, graph=floats)
