"""Small files that would take minutes or gigabytes are refused, or read in linear time."""

import warnings
from itertools import pairwise

import h5py
import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact import hdf5
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.artifact.nir_data import read_nir_data
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.quantisation import Quantisation
from spikedeploy.runtime.compiler.compile import check, compile_program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import (
    ArtifactError,
    ConfigError,
    ConventionError,
    ObservationError,
    RuleError,
)
from spikedeploy.runtime.float_model import FloatGraph
from spikedeploy.runtime.graph import validate
from spikedeploy.runtime.graph.order import order
from tests.effort import memory_below
from tests.networks import ends, named_chain, unit_lif

TWO = np.ones(2)


def written(path, weights, cells=None):
    """A file of one layer of two neurons with these weights."""
    cells = unit_lif(2) if cells is None else cells
    nir.write(path, named_chain([2], [2], weights=nir.Linear(weights), cells=cells))
    return path


def damaged(path, damage):
    """A small network in which `damage(file, nodes)` was done."""
    with h5py.File(written(path, np.eye(2)), "r+") as file:
        damage(file, file["node/nodes"])
    return path


def bytes_of_zeros(file, nodes):
    del nodes["weights/weight"]
    block = np.zeros((4000, 8000), "u1")
    nodes["weights"].create_dataset("weight", data=block, chunks=(1000, 8000), compression="gzip")


def one_large_chunk(file, nodes):
    del nodes["weights/weight"]
    made = {"chunks": (8000, 8000), "maxshape": (None, None), "compression": "gzip"}
    nodes["weights"].create_dataset("weight", (2, 2), "f8", **made)


def nothing_stored(file, nodes):
    del nodes["weights/weight"]
    nodes["weights"].create_dataset("weight", (8000, 8000), "f8", fillvalue=1.0)


def empty_groups(file, nodes):
    for number in range(3_000):
        nodes.create_group(f"g{number}")


def edges(file, nodes):
    del file["node/edges"]
    pairs = np.array([("input", "output")], dtype=object).repeat(1_100, axis=0)
    file["node"].create_dataset("edges", data=pairs, dtype=h5py.string_dtype(), compression="gzip")


def many_neurons(file, nodes):
    for name, field in (("input", "shape"), ("output", "shape")):
        del nodes[name][field]
        nodes[name][field] = np.array([1_500_000])
    del nodes["weights"]
    again = nodes.create_group("weights")
    again["type"] = "Threshold"
    whole = {"data": np.ones(1_500_000, "f4"), "compression": "gzip"}
    again.create_dataset("threshold", **whole)
    for field in ("r", "tau", "v_leak", "v_reset", "v_threshold"):
        del nodes["cells"][field]
    nodes["cells/type"][()] = "Threshold"
    nodes["cells"].create_dataset("threshold", **whole)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (bytes_of_zeros, "for which too few are in the file"),
        (one_large_chunk, "for which too few are in the file"),
        (nothing_stored, "for which too few are in the file"),
        (empty_groups, "arrays and groups; at most 2048"),
        (edges, "1100 edges; at most 1024"),
        (many_neurons, "3000000 neurons in a timestep; of a file of"),
    ],
)
def test_what_a_small_file_unpacks_to_is_bounded_before_it_is_read(
    damage, message, tmp_path, monkeypatch
):
    monkeypatch.setattr(hdf5, "_MAX_MEMBERS", 2048)
    monkeypatch.setattr(validate, "MAX_EDGES", 1024)
    path = damaged(tmp_path / "a.nir", damage)
    with memory_below(2**25), pytest.raises(ArtifactError, match=message):
        load(path, dt=1e-3)


def scales(count, link):
    names = [f"s{number:04}" for number in range(count)]
    joined = [("input", names[0]), *link(names), (names[-1], "output")]
    nodes = {name: nir.Scale(TWO) for name in names}
    return nir.NIRGraph({**ends(2, 2), **nodes}, joined, type_check=False)


def test_a_graph_of_thousands_of_nodes_is_refused():
    with pytest.raises(ArtifactError, match="4202 nodes; at most 4096"):
        Artifact(scales(4200, pairwise), None, Convention(1e-3))


def test_loops_that_interlock_by_the_hundred_are_refused():
    names = [f"n{number:03}" for number in range(500)]
    nodes = {name: unit_lif(2) for name in names}
    both = [*pairwise(names), *((b, a) for a, b in pairwise(names))]
    graph = nir.NIRGraph(
        {**ends(2, 2), **nodes},
        [("input", names[0]), *both, (names[-1], "output")],
        type_check=False,
    )
    with pytest.raises(ArtifactError, match="too many to open one by one"):
        order(graph)


@pytest.mark.parametrize("kind", ["u1", "i4", "u8"])
@pytest.mark.parametrize("name", ["truenorth", "odin", "loihi1", "ideal"])
def test_whole_weights_compile_as_floats_of_the_same_values(kind, name, tmp_path):
    low = 0 if kind[0] == "u" else -128
    weights = np.array([[low, 3], [127, 0]])
    programs = []
    for each in (kind, "f8"):
        artifact = load(written(tmp_path / "a.nir", weights.astype(each)), dt=1e-3)
        check(artifact, chip(name))
        program = compile_program(artifact, chip(name), limits=False)
        programs.append([s.weight for layer in program.layers for s in layer.synapses])
    for ours, wanted in zip(*programs, strict=True):
        np.testing.assert_array_equal(ours, wanted)


def test_whole_numbers_that_no_float_holds_are_refused(tmp_path):
    path = written(tmp_path / "a.nir", np.full((2, 2), 2**63, np.uint64))
    with pytest.raises(ArtifactError, match="weight holds whole numbers beyond 9007199254740992"):
        load(path, dt=1e-3)


@pytest.mark.parametrize("value", [5e-324, -1e-310])
@pytest.mark.parametrize("place", ["weights", "row", "threshold"])
@pytest.mark.parametrize("granularity", ["layer", "channel"])
def test_denormal_numbers_give_no_warnings(granularity, place, value, tmp_path):
    rows = {"weights": [[value, 1.0], [0.0, value]], "row": [[0.3, 1.0], [value, value]]}
    cells = unit_lif(2)
    if place == "threshold":  # its weights as small, so that it fires
        cells.v_threshold[1] = abs(value)
    path = written(tmp_path / "a.nir", np.array(rows.get(place, rows["row"])), cells)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        artifact = load(path, dt=1e-3)
        for name in ("loihi1", "loihi1-nengo", "xylo-a2", "speck2f", "spiker", "int", "ideal"):
            check(artifact, chip(name))
            try:
                chosen = Quantisation(granularity=granularity)
                compile_program(artifact, chip(name), chosen, limits=False)
            except (RuleError, ConfigError):
                assert (name, place) != ("loihi1", "weights")


def recorded_events(path, **changes):
    """NIRData of two events, some of whose fields are others; those that are dicts, attributes."""
    times = np.array([[0.0, 1e-3]])
    events = nir.ValuedEventData(
        idx=np.array([[0, 1]]), time=times, value=times, n_neurons=2, t_max=4e-3
    )
    nir.write_data(path, nir.NIRGraphData({"input": nir.NIRNodeData({"spikes": events})}))
    with h5py.File(path, "r+") as file:
        groups = []
        file.visititems(lambda name, found: groups.append(name) if name.endswith("/idx") else None)
        group = file[groups[0].rpartition("/")[0]]
        for name, value in changes.items():
            if name in group.attrs:
                group.attrs[name] = value
            else:
                del group[name]
                made = value if isinstance(value, dict) else {"data": value}
                group.create_dataset(name, **made)
    return path


@pytest.mark.parametrize(
    "changes",
    [
        {"idx": np.array([[b"a", b"b"]])},
        {"idx": np.array([[0.5, np.nan]])},
        {"time": np.array([[np.nan, 1e-3]])},
        {"time": np.array([[0.0, np.inf]])},
        {"time": np.array([[1e300, -1e300]])},
        {"time": np.zeros((1, 2), [("a", "f8")])},
        {"value": np.array([[1j, 1]])},
        {"value": np.zeros((1, 3))},
        {"value": {"shape": (1 << 15, 1 << 15), "dtype": "f8", "chunks": (64, 64)}},
        {"t_max": 1e308},
        {"t_max": 1e6},
        {"n_neurons": 1 << 40},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_strange_nir_data_are_refused_in_a_sentence(changes, tmp_path):
    sound = read_nir_data(recorded_events(tmp_path / "a.h5"), {"input": (2,)}, 1e-3)
    assert sound["input"].shape == (4, 2)
    path = recorded_events(tmp_path / "b.h5", **changes)
    with pytest.raises(ObservationError, match=r"b\.h5"):  # and no warning, which is an error here
        read_nir_data(path, {"input": (2,)}, 1e-3)


def test_a_time_constant_below_the_smallest_float_forgets_at_once(tmp_path):
    cells = unit_lif(2)
    cells.tau = np.full(2, np.longdouble("1e-1600"))
    path = written(tmp_path / "a.nir", np.eye(2), cells)
    with pytest.raises(ConventionError, match="longer than tau"):
        load(path, dt=1e-3)
    # and no warning, which is an error here
    load(path, dt=1e-3, integrator="exponential")


OUTSIDE = {
    "soft": ("x", lambda f, n: n.__setitem__("x", h5py.SoftLink("/node")), "x is a SoftLink"),
    "external link": (
        "x", lambda f, n: n.__setitem__("x", h5py.ExternalLink("b.nir", "/")), "is a ExternalLink",
    ),
    "circle": (
        "x", lambda f, n: n.__setitem__("x", f["node"]), "there under another name too",
    ),
    "elsewhere": (
        "cells/r",
        lambda f, n: n.create_dataset("cells/r", (2,), "f8", external=[("/etc/passwd", 0, 16)]),
        "has its numbers in another file",
    ),
    # HDF5 crashed on one that a flipped bit had made of a text
    "type": (
        "cells/type",
        lambda f, n: n.create_dataset("cells/type", (), h5py.vlen_dtype("i8")),
        "nodes/cells/type holds neither numbers nor texts",
    ),
    "reference": (
        "cells/r",
        lambda f, n: n.create_dataset("cells/r", data=f.ref),
        "nodes/cells/r holds neither numbers nor texts",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", OUTSIDE)
def test_links_and_storage_outside_the_file_are_refused_by_name(name, tmp_path):
    place, make, message = OUTSIDE[name]

    def damage(file, nodes):
        nodes.pop(place, None)
        make(file, nodes)

    with pytest.raises(ArtifactError, match=message):
        load(damaged(tmp_path / "a.nir", damage))


flat = nir.Flatten({"input": np.array([3000, 3000])}, 0, -1)


def sized(kernel, shape, padding=0):
    weight = np.ones((1, shape[0], *kernel))
    conv = nir.Conv2d(shape[1:], weight, 1, padding, 1, 1, np.zeros(1))
    return named_chain(list(shape), [1, 1, 1], c=conv)


@pytest.mark.parametrize(
    ("network", "message"),
    [
        (named_chain([3000, 3000], [9000000], a=flat), "18000000 values are put out"),
        (
            sized((300, 300), (1, 600, 600)),
            "8154090000 values in its windows",
        ),
        (sized((999, 999), (1, 1100, 1100), 500), "multiplications in a timestep; at most"),
    ],
    ids=["numbers", "windows", "multiplications"],
)
def test_a_timestep_that_would_take_minutes_is_refused_at_load(network, message, tmp_path):
    nir.write(tmp_path / "a.nir", network)
    with pytest.raises(ArtifactError, match=message):
        load(tmp_path / "a.nir")


# parameters of one number, as tools write them

SCALAR = {"tau": 1e-2, "r": 10.0, "v_leak": 0.0, "v_threshold": 1.0, "v_reset": 0.0}


def neurons(shape=()):
    return nir.LIF(**{n: np.full(shape, each, np.float32)[()] for n, each in SCALAR.items()})


def weights(rows, columns):
    return nir.Linear(np.random.default_rng(rows * columns).normal(size=(rows, columns)))


def filters():
    weight = np.random.default_rng(0).normal(size=(3, 2, 3, 3))
    return nir.Conv2d((8, 8), weight, 1, 0, 1, 1, np.zeros(3))


def flatten_node(shape, start):
    return nir.Flatten({"input": np.array(shape)}, start, -1)


def stored(path, nodes, edges):
    # nir.write cannot compress single numbers
    nir.write(path, nir.NIRGraph(nodes, edges, type_check=False), compression=None)
    return path


def in_a_row(path, *layers, takes, puts):
    nodes = {
        "input": nir.Input(np.array(takes)),
        **{f"n{i}": layer for i, layer in enumerate(layers)},
        "output": nir.Output(np.array(puts)),
    }
    return stored(path, nodes, list(pairwise(nodes)))


def spikes_of(path):
    artifact = load(path, dt=1e-3)
    (node,) = artifact.graph.inputs.values()
    size = int(np.prod(node.output_type["output"]))
    raster = np.random.default_rng(1).random((1, 30, size)) < 0.5
    output = FloatGraph(artifact).run(raster.reshape(1, 30, *node.output_type["output"]))["output"]
    assert output.any()
    return output


@pytest.mark.parametrize("shape", [(), (1,), (1, 1, 1), (3, 1, 1), (1, 3, 1, 1)])
@pytest.mark.parametrize(
    "flatten",
    [((3, 6, 6), 0), ((3, 6, 6), 1), ((1, 3, 6, 6), 0), ((1, 3, 6, 6), 1)],
    ids=["as NIR means it", "batch in its axes", "batch in its shape", "batch in both"],
)
def test_neurons_of_one_number_behind_a_convolution_are_as_many_as_arrive(shape, flatten, tmp_path):
    whole = filters(), neurons((3, 6, 6)), flatten_node((3, 6, 6), 0), weights(4, 108), neurons(4)
    wanted = spikes_of(in_a_row(tmp_path / "a.nir", *whole, takes=(2, 8, 8), puts=(4,)))
    layers = filters(), neurons(shape), flatten_node(*flatten), weights(4, 108), neurons()
    path = in_a_row(tmp_path / "b.nir", *layers, takes=(1, 2, 8, 8), puts=(1, 4))
    np.testing.assert_array_equal(spikes_of(path), wanted)


def test_neurons_of_one_number_in_a_row_with_other_nodes_are_as_many_as_arrive(tmp_path):
    def layers(shape):
        one = np.ones(shape or (1,))
        between = nir.Scale(2 * one), nir.Delay(1e-3 * one), nir.Threshold(0.5 * one)
        return (neurons(shape), weights(5, 6), neurons(shape), *between, neurons(shape))

    whole = list(layers(5))
    whole[0] = neurons(6)
    wanted = spikes_of(in_a_row(tmp_path / "a.nir", *whole, takes=(6,), puts=(5,)))
    for shape, puts in (((), (5,)), ((1,), (1,))):
        path = in_a_row(tmp_path / "b.nir", *layers(shape), takes=(6,), puts=puts)
        np.testing.assert_array_equal(spikes_of(path), wanted)


@pytest.mark.parametrize("shape", [(), (1,)])
def test_neurons_of_one_number_with_weights_back_are_as_many_as_these(shape, tmp_path):
    def loop(shape):
        return {"lif": neurons(shape), "rec": weights(5, 5)}, [("lif", "rec"), ("rec", "lif")]

    ends = {"input": nir.Input(np.array([6])), "w": weights(5, 6), "output": nir.Output([5])}
    around = [("input", "w"), ("w", "lif"), ("lif", "output")]
    found = []
    for each in (5, shape):
        nodes, edges = loop(each)
        found.append(spikes_of(stored(tmp_path / "a.nir", ends | nodes, around + edges)))
    nodes, edges = loop(shape)
    ports = {"input": nir.Input(np.array([1])), "output": nir.Output(np.array([1]))}
    edges = [*edges, ("input", "lif"), ("lif", "output")]
    inner = nir.NIRGraph(nodes | ports, edges, type_check=False)
    nested = [("input", "w"), ("w", "inner"), ("inner", "output")]
    found.append(spikes_of(stored(tmp_path / "a.nir", {**ends, "inner": inner}, nested)))
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


def test_some_parameters_of_one_number_are_those_of_all_neurons(tmp_path):
    path = in_a_row(tmp_path / "a.nir", weights(5, 6), neurons(5), takes=(6,), puts=(5,))
    wanted = spikes_of(path)
    with h5py.File(path, "r+") as file:
        for field, value in (("v_threshold", np.float32(1)), ("r", np.full(1, 10.0))):
            del file["node/nodes/n1"][field]
            file["node/nodes/n1"][field] = value
    np.testing.assert_array_equal(spikes_of(path), wanted)


@pytest.mark.parametrize(
    ("layers", "takes", "puts", "message"),
    [
        ((weights(5, 6), neurons()), (6,), (4,), r"edge 'n1' -> 'output': .*\(5,\).*\(4,\)"),
        ((weights(5, 6), neurons(), weights(2, 4)), (6,), (2,), r"edge 'n1' -> 'n2'"),
        ((weights(5, 6), neurons(4)), (6,), (4,), r"edge 'n0' -> 'n1': .*\(5,\).*\(4,\)"),
        ((filters(), neurons(3)), (2, 8, 8), (3, 6, 6), r"'n1': .* the shape \(3, 1, 1\)"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named_with_its_edge(layers, takes, puts, message, tmp_path):
    path = in_a_row(tmp_path / "a.nir", *layers, takes=takes, puts=puts)
    with pytest.raises(ArtifactError, match=message):
        load(path, dt=1e-3)
