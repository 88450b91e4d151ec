"""Damaged files raise only errors of ours; benchmarks/fuzz.py tries ten thousand a format."""

import json
from pathlib import Path

import h5py
import nir
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.fuzz_corpus import chain, lif, write_corpus
from benchmarks.fuzz_formats import FORMATS
from benchmarks.fuzz_readers import READERS
from benchmarks.fuzz_runs import fuzz, recorded, resumed, summary, table
from benchmarks.fuzz_trials import attempt
from spikedeploy.envs.errors import EnvError
from spikedeploy.envs.kart import track_file
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.errors import ArtifactError, SpikedeployError, TraceError
from spikedeploy.runtime.traces.verify import verify

FILES = 300


def test_damaged_files_raise_only_errors_of_ours(tmp_path):
    outcomes = list(fuzz(range(FILES), 1, tmp_path))
    assert not any(outcome.violation for outcome in outcomes), summary(outcomes)
    reasons = {name for outcome in outcomes for name in outcome.refused}
    assert {"ArtifactError", "TraceError", "ObservationError"} <= reasons


def test_the_files_that_fuzzing_starts_from_are_valid(tmp_path):
    rng = np.random.default_rng(0)
    corpus = write_corpus(tmp_path / "corpus")
    assert {each.suffix for each in FORMATS.values()} == {path.suffix for path in corpus}
    for path in corpus:
        read, refused = attempt(path, rng)
        assert read, (path, refused)
        if path.suffix == ".nir":  # chips refuse by their rules
            assert set(refused) <= {"RuleError", "ArtifactError", "ConventionError"}, path
            assert load(path, dt=1e-3).graph.nodes
        else:  # a file of a format may be for one of its readers alone
            assert len(refused) < len(READERS[path.suffix])


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_is_fuzzed_by_itself(name, tmp_path):
    outcomes = list(fuzz(range(8), 3, tmp_path, name=name))
    assert {Path(outcome.source).suffix for outcome in outcomes} == {FORMATS[name].suffix}
    assert not any(outcome.violation for outcome in outcomes), summary(outcomes)


def test_fuzzing_goes_on_where_it_was_cut_off(tmp_path):
    record, whole = tmp_path / "toml.jsonl", tmp_path / "whole.jsonl"
    for file, counts in ((record, (3, 6)), (whole, (6,))):
        for count in counts:
            folder = tmp_path / f"{file.stem}-{count}"
            folder.mkdir()
            resumed(file, count, 5, None, "toml", folder)
        with file.open("a") as cut:
            cut.write('{"number": 6, "sou')
    found, wanted = recorded(record), recorded(whole)
    assert [(o.number, o.damage, o.refused) for o in found] == [
        (o.number, o.damage, o.refused) for o in wanted
    ]
    assert f"toml{6:>15}" in table({"toml": found})


@pytest.fixture
def damaged(tmp_path):
    """Write a valid file, damage it with h5py, and load it; the error."""

    def attempt_to_load(damage):
        path = tmp_path / "a.nir"
        nir.write(path, chain([2], [2], weights=nir.Linear(np.eye(2)), cells=lif(2)))
        with h5py.File(path, "r+") as file:
            damage(file, file["node/nodes"])
        with pytest.raises(ArtifactError) as caught:
            load(path)
        return str(caught.value)

    return attempt_to_load


def into(nodes, name, make):
    del nodes[name]
    make(nodes)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f, n: n.__setitem__("x", h5py.SoftLink("/node")), "nodes/x is a SoftLink"),
        (lambda f, n: n.__setitem__("x", h5py.ExternalLink("b.nir", "/")), "is a ExternalLink"),
        (lambda f, n: n.__setitem__("x", f["node"]), "there under another name too"),
        (
            lambda f, n: into(
                n,
                "cells/r",
                lambda m: m.create_dataset(
                    "cells/r", (2,), "f8", external=[("/etc/passwd", 0, 16)]
                ),
            ),
            "has its numbers in another file",
        ),
        (lambda f, n: n.create_group("/".join("x" * 70)), "is deeper than 64 groups"),
        (
            lambda f, n: into(
                n, "cells/r", lambda m: m.create_dataset("cells/r", (1 << 20, 1 << 12), "f8")
            ),
            "for which too few are in the file",
        ),
        (
            # HDF5 crashed on one that a flipped bit had made of a text
            lambda f, n: into(
                n, "cells/type", lambda m: m.create_dataset("cells/type", (), h5py.vlen_dtype("i8"))
            ),
            "nodes/cells/type holds neither numbers nor texts",
        ),
        (
            lambda f, n: into(n, "cells/r", lambda m: m.create_dataset("cells/r", data=f.ref)),
            "nodes/cells/r holds neither numbers nor texts",
        ),
    ],
    ids=["soft", "external link", "circle", "elsewhere", "deep", "claim", "type", "reference"],
)
def test_links_and_storage_outside_the_file_are_refused_by_name(damage, message, damaged):
    assert message in damaged(damage)


flat = nir.Flatten({"input": np.array([3000, 3000])}, 0, -1)


def sized(kernel, shape, padding=0):
    weight = np.ones((1, shape[0], *kernel))
    conv = nir.Conv2d(shape[1:], weight, 1, padding, 1, 1, np.zeros(1))
    return chain(list(shape), [1, 1, 1], c=conv)


@pytest.mark.parametrize(
    ("network", "message"),
    [
        (chain([3000, 3000], [9000000], a=flat), "put out 18000000"),
        (sized((300, 300), (1, 600, 600)), "windows hold 8154090000 values; at most 67108864"),
        (sized((999, 999), (1, 1100, 1100), 500), "multiplications in a timestep; at most"),
    ],
    ids=["numbers", "windows", "multiplications"],
)
def test_a_timestep_that_would_take_minutes_is_refused_at_load(network, message, tmp_path):
    nir.write(tmp_path / "a.nir", network)
    with pytest.raises(ArtifactError, match=message):
        load(tmp_path / "a.nir")


trees = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=12,
)
FIELDS = ("weights", "input_spikes", "du", "dv", "vth", "u", "v", "s", "layers", "params", "bias")


@settings(max_examples=200, deadline=None)
@given(
    st.dictionaries(st.sampled_from(FIELDS), trees, min_size=1), st.sampled_from(["lava", "xylo"])
)
def test_any_values_in_a_trace_are_refused_by_an_error_of_ours(tmp_path_factory, fields, source):
    path = Path(tmp_path_factory.mktemp("traces")) / "a.json"
    sound = {"input_spikes": [[1]], "weights": [[1]], "dv": 0, "vth": 1, "s": [[0]]}
    path.write_text(json.dumps({**sound, **fields, "source": source}))
    try:
        verify(path)
    except SpikedeployError as error:
        assert isinstance(error, TraceError)  # noqa: PT017


def test_a_track_of_a_million_pixels_is_refused(tmp_path):
    record = json.loads((Path(track_file.__file__).parent / "tracks" / "small_S.json").read_text())
    record["walls"][0][0][0] = 1e9
    (tmp_path / "a.json").write_text(json.dumps(record))
    with pytest.raises(EnvError, match="px wide; at most 20000"):
        track_file.load(tmp_path / "a.json")
    (tmp_path / "b.json").write_text("[" * 100_000)
    with pytest.raises(EnvError, match="not a JSON file"):
        track_file.load(tmp_path / "b.json")
