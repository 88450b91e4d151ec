import contextlib
import os

import h5py
import nir
import numpy as np
import pytest

from spikedeploy.runtime.artifact.artifact import Artifact, digest, load, save
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.errors import ArtifactError, ConventionError, SpikedeployError
from spikedeploy.runtime.graph.discretisation import discretise
from spikedeploy.runtime.metadata import Provenance
from tests.networks import chain, codec, cuba, ends, lif, popsan


@pytest.fixture
def artifact():
    return popsan()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "policy.nir"


def foreign(path, network):
    """A file as another tool would write it."""
    nir.write(path, network)
    return path


def edited(path, field, value):
    """The file with one number or text of its HDF5 changed."""
    with h5py.File(path, "r+") as file:
        del file[field]
        file[field] = value
    return path


# what is written is what is read


def test_everything_comes_back(artifact, path):
    save(artifact, path)
    back = load(path)
    obs = np.random.default_rng(0).normal(size=(20, 3))
    np.testing.assert_array_equal(back.codec.encode(obs), artifact.codec.encode(obs))
    assert (back.convention, back.convention.source) == (Convention(1e-3), "stated")
    assert back.provenance == Provenance(
        "spikedeploy/Hexapod-v0",
        "smoke",
        seed=3,
        steps=7,
        created="2026-01-01T00:00:00Z",
        sha256=digest(artifact),
    )
    assert digest(back) == digest(artifact)


def test_the_same_artifact_gives_the_same_bytes_in_any_node_order(artifact, path, tmp_path):
    network = artifact.graph
    turned = nir.NIRGraph(dict(reversed(network.nodes.items())), network.edges[::-1])
    save(artifact, path)
    save(Artifact(turned, artifact.codec, artifact.convention, artifact.provenance), tmp_path / "b")
    assert path.read_bytes() == (tmp_path / "b").read_bytes()


def test_saving_what_was_loaded_gives_the_same_bytes(artifact, path, tmp_path):
    save(artifact, path)
    save(load(path), tmp_path / "again.nir")
    assert path.read_bytes() == (tmp_path / "again.nir").read_bytes()


@pytest.mark.parametrize("metadata", [{"impossible": None}, np.int64(3)])
def test_a_write_that_fails_leaves_the_old_file_and_no_other(metadata, artifact, path):
    save(artifact, path)
    before = path.read_bytes()
    artifact.graph.nodes["n1"].metadata = metadata
    with pytest.raises(ArtifactError, match=r"cannot write .*policy\.nir"):
        save(artifact, path)
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["policy.nir"]


def test_decays_come_back_within_one_unit_in_the_last_place_of_one():
    for decay in np.linspace(0, 0.999, 500):
        layer = discretise("n", cuba(1, alpha=decay, beta=decay), Convention(1e-3))
        assert abs(layer.membrane_decay[0] - decay) <= np.spacing(1.0)
        assert layer.current_decay[0] == layer.membrane_decay[0]
        assert layer.gain[0] == 1.0


# files of other tools


def test_the_timestep_of_a_foreign_file_is_inferred_with_its_reason(artifact, path):
    back = load(foreign(path, artifact.graph))
    assert back.convention == Convention(1e-3)
    assert "dt = tau/r in n2, n4, n6" in back.convention.describe()
    assert (back.codec, back.provenance) == (None, None)


@pytest.mark.parametrize(
    ("dt", "given", "asked"),
    [
        (1e-3, {}, "if snnTorch, Norse … wrote the file: --from TOOL"),
        (1e-3, {"dt": 1e-3}, "wrote the file: --from TOOL"),
        (1e-4, {}, "this dt is that of snnTorch: if it wrote the file, --from snntorch"),
        (1e-4, {"reset": "zero"}, ""),
    ],
)
def test_a_file_that_says_no_convention_is_asked_for_its_tool(dt, given, asked, path):
    said = load(foreign(path, chain(cuba(4, dt=dt), width=4, act=4)), **given).convention.source
    assert asked in said
    assert ("--from" in said) == bool(asked)


def test_float32_gains_give_a_clean_timestep_and_a_gain_of_one(path):
    network = chain(cuba(4, alpha=0.8, beta=0.95, dt=1e-4, dtype=np.float32), width=4, act=4)
    back = load(foreign(path, network))
    assert back.convention.dt == 1e-4
    assert (discretise("n1", back.graph.nodes["n1"], back.convention).gain == 1).all()


@pytest.mark.parametrize(
    ("nodes", "reason"),
    [
        # r = 1 is a physical gain: dt = tau would leave no membrane at all
        ([lif(2, tau=0.0025, r=1.0)], "in node 'n1' r is 1"),
        (
            [lif(2, tau=0.01, r=10.0), lif(2, tau=0.01, r=5.0)],
            r"in node 'n.' tau/r is 0\.00. s and not",
        ),
        (
            [nir.CubaLIF(*(np.full(2, v) for v in (0.01, 0.01, 10.0, 0.0, 1.0)))],
            "in node 'n1' w_in dt/tau_syn is 0.1",
        ),
        ([nir.Affine(np.eye(2), np.zeros(2))], "no node of the graph has a time constant"),
        ([lif(2, r=-10.0)], "a gain r is not above 0"),
    ],
)
def test_a_timestep_that_cannot_be_inferred_must_be_given(path, nodes, reason):
    foreign(path, chain(*nodes, width=2, act=2))
    with pytest.raises(ArtifactError, match=f"cannot be inferred: {reason}.* Give the dt"):
        load(path)
    assert load(path, dt=1e-4).convention.dt == 1e-4


def test_a_timestep_longer_than_a_time_constant_is_refused(artifact, path):
    with pytest.raises(ConventionError, match=r"'n2': dt = 0\.1 s is longer than tau_mem = 0\.005"):
        load(foreign(path, artifact.graph), dt=0.1)


# files that are not what they should be


def test_a_file_that_is_no_graph_is_refused(artifact, path, tmp_path):
    save(artifact, path)
    half = path.read_bytes()[: path.stat().st_size // 2]
    for content in (b"", b"x" * 10_000, half):
        path.write_bytes(content)
        with pytest.raises(ArtifactError):
            load(path)
    nir.write(path, cuba(3))  # a node alone
    (tmp_path / "net.pt").write_bytes(b"PK")
    with h5py.File(tmp_path / "other.nir", "w") as file:
        file["weights"] = np.zeros(3)
    told = {"net.pt": r"spikedeploy\.export", "other.nir": "NIR graph", path.name: "NIR graph"}
    for name, message in told.items():
        with pytest.raises(ArtifactError, match=message):
            load(tmp_path / name)


def test_a_damaged_file_never_passes_for_the_policy(artifact, path):
    save(artifact, path)
    whole, sha = path.read_bytes(), digest(artifact)
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(whole), 60):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        with contextlib.suppress(SpikedeployError):
            assert digest(load(path)) == sha


@pytest.mark.parametrize("shape", [[0], [-2], [2.0], [np.nan], "wide"])
def test_an_input_without_a_shape_is_refused(path, shape):
    foreign(path, chain(nir.Linear(np.eye(2)), width=2, act=2))
    with pytest.raises(ArtifactError, match=r"'input': shape is .* whole numbers above 0"):
        load(edited(path, "node/nodes/input/shape", shape), dt=1e-3)


# metadata that cannot be true


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("convention/dt", 2e-3, r"state dt = 0\.002 s, the nodes 0\.001 s"),
        ("convention/reset", "soft", "reset 'soft' is unknown"),
        ("schema", 99, "schema is 99; this version reads 1"),
        ("codec/encoder/threshold", 0.9, "not the one that was exported"),
        ("origin/sha256", "0" * 64, "not the one that was exported"),
    ],
)
def test_metadata_that_cannot_be_true_are_refused(field, value, message, artifact, path):
    save(artifact, path)
    with pytest.raises(ArtifactError, match=message):
        load(edited(path, f"node/metadata/spikedeploy/{field}", value))


def test_a_codec_for_another_input_is_refused(artifact):
    with pytest.raises(ArtifactError, match="makes 40 spike trains, node 'input' takes 30"):
        Artifact(artifact.graph, codec(4), artifact.convention)


# a batch axis of one


def batched(graph, axes):
    """The graph with leading axes of 1 at its ports and neurons."""
    nodes = dict(graph.nodes)
    for name, node in graph.nodes.items():
        if isinstance(node, (nir.Input, nir.Output)):
            shape = [1] * axes + [int(n) for n in node.output_type["output"]]
            nodes[name] = type(node)(np.array(shape))
        elif isinstance(node, nir.CubaLIF):
            fields = ("tau_syn", "tau_mem", "r", "v_leak", "v_threshold", "v_reset", "w_in")
            nodes[name] = nir.CubaLIF(**{f: getattr(node, f)[(None,) * axes] for f in fields})
    return nir.NIRGraph(nodes, graph.edges, type_check=False)


@pytest.mark.parametrize("axes", [1, 2])
def test_a_batch_axis_of_one_is_taken_off(path, artifact, axes):
    plain, back = artifact.graph, load(foreign(path, batched(artifact.graph, axes))).graph
    for name, node in back.nodes.items():
        for field, value in vars(node).items():
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(value, getattr(plain.nodes[name], field))


def test_a_single_channel_is_no_batch(path):
    conv = nir.Conv1d(8, np.ones((1, 1, 3)), 1, 0, 1, 1, np.zeros(1))
    neurons = nir.IF(*(np.ones((1, 6)) for _ in range(2)))
    edges = [("input", "c"), ("c", "n"), ("n", "output")]
    network = nir.NIRGraph({**ends([1, 8], [1, 6]), "c": conv, "n": neurons}, edges)
    assert load(foreign(path, network), dt=1.0).graph.nodes["n"].r.shape == (1, 6)
