"""What runs in the Python of another tool, where that tool is installed: `./spike test --peers`."""

import json
from importlib.metadata import PackageNotFoundError, version

import nir
import numpy as np
import pytest

from lab.interop import peer_process

RELEASES = ("1.0.1", "1.0.4", "1.0.5", "1.0.6", "1.0.7", "1.0.8")


def installed(name):
    try:
        return version(name)
    except PackageNotFoundError:
        pytest.skip(f"{name} is not installed; ./spike test --peers installs it")


def network(folder, neurons):
    """A file of two layers, 10 -> 12 -> 5, and a job for it."""
    rng, nodes, names = np.random.default_rng(0), {}, ["input"]
    for fan_in, size in ((10, 12), (12, 5)):
        nodes[f"fc{size}"] = nir.Linear(2 * rng.normal(size=(size, fan_in)) / fan_in**0.5)
        nodes[f"lif{size}"] = neurons(size)
        names += [f"fc{size}", f"lif{size}"]
    ends = {"input": nir.Input(np.array([10])), "output": nir.Output(np.array([5]))}
    edges = list(zip(names, [*names[1:], "output"], strict=True))
    nir.write(folder / "net.nir", nir.NIRGraph({**ends, **nodes}, edges))
    np.save(folder / "raster.npy", (rng.random((60, 10)) < 0.3).astype(np.uint8))
    return {
        "file": str(folder / "net.nir"),
        "raster": str(folder / "raster.npy"),
        "out": str(folder / "spikes.npz"),
    }


def cuba(size, dt=1e-4):
    """CuBa-LIF with the gains that all importers take."""
    full = [np.full(size, v) for v in (5 * dt, 10 * dt, 10.0, 0.0, 1.0)]
    return nir.CubaLIF(*full, w_in=np.full(size, 5.0))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("tool", ["norse", "rockpool", "snntorch", "spikingjelly"])
def test_a_tool_runs_a_file_and_all_layers_are_recorded(tool, tmp_path):
    assert installed("nirtorch") == peer_process.packages(tool)["nirtorch"]
    installed(tool)
    job = network(tmp_path, cuba)
    answer = peer_process.done(tool, job)
    assert answer["opens"], answer
    with np.load(job["out"]) as spikes:
        shapes = {name: spikes[name].shape for name in spikes.files}
        assert spikes["lif12"].sum() > 10
    assert shapes == {"lif12": (60, 12), "lif5": (60, 5), "output": (60, 5)}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("tool", ["norse", "snntorch", "spikingjelly"])
def test_what_is_written_for_a_tool_has_the_same_spikes_there(tool, tmp_path):
    """Every spike of both layers, of networks that the tool refuses or reads as others."""
    installed("nirtorch")
    installed(tool)
    from lab.interop.cases import compare, intended
    from spikedeploy.runtime.artifact.artifact import Artifact, for_importer, load, save
    from spikedeploy.runtime.convention import Convention
    from tests.networks import lif

    for neurons in (lambda n: cuba(n, 1e-3), lambda n: lif(n, tau=0.01, r=4.0, v_leak=0.1)):
        job = network(tmp_path, neurons)
        own = Artifact(nir.read(job["file"]), None, Convention(1e-3))
        save(own, tmp_path / "own.nir")
        save(for_importer(load(tmp_path / "own.nir"), tool), job["file"])
        assert peer_process.done(tool, job)["opens"]
        wanted = intended(tmp_path / "own.nir", np.load(job["raster"]))
        with np.load(job["out"]) as file:
            found = compare({name: file[name] for name in wanted}, wanted)
        assert (found["differ"], found["output"], found["compared"]) == (0, "equal", 60 * 17)


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: f"nir-{release}")
def test_a_release_of_nir_reads_what_it_writes(release, tmp_path):
    if installed("nir") != release:
        pytest.skip(f"nir {release} is not installed; ./spike test --peers installs it")
    job = network(tmp_path, cuba)
    said = "6 nodes, the same after write and read"
    assert peer_process.done("nir", job) == {"opens": True, "message": said}


def test_snn_mlir_says_what_it_does_not_take(tmp_path):
    installed("snn-mlir")
    assert peer_process.done("snn-mlir", network(tmp_path, cuba)) == {
        "opens": True,
        "message": "check: OK",
    }
    answer = peer_process.done("snn-mlir", network(tmp_path, lambda n: nir.LI(*np.ones((3, n)))))
    assert not answer["opens"]
    assert "node 'lif" in answer["message"]


def test_a_file_that_does_not_open_is_an_answer(tmp_path):
    answer = peer_process.done("nir", {"file": str(tmp_path / "none"), "out": ""})
    assert not answer["opens"]
    assert answer["message"].startswith("FileNotFoundError")
    json.dumps(answer)
