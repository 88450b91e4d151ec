"""NIRData in place of .npy and .npz in `emulate`."""

import nir
import numpy as np
import pytest
from typer.testing import CliRunner

from spikedeploy.cli import app
from tests.paths import ROOT

EXPORTS = ROOT / "tests/golden/exports"


def emulate(raster, out):
    words = ["emulate", EXPORTS / "snntorch_leaky.nir", "--from", "snntorch", "--chip", "float"]
    words += ["--input", raster, "-o", out]
    return CliRunner().invoke(app, list(map(str, words)))


def recorded():
    with np.load(EXPORTS / "snntorch_leaky_default.npz") as arrays:
        return arrays["input"], arrays["output"]


def written(path, data, node="input"):
    nir.write_data(path, nir.NIRGraphData({node: nir.NIRNodeData({"spikes": data})}))
    return path


def grid(dt=1e-4):
    return nir.TimeGriddedData(recorded()[0][None].astype(bool), dt)


def events():
    # k dt / dt may round to below k
    return grid().to_event(10_000)


def valued():
    found = events()
    ones = np.ones(found.idx.shape)
    return nir.ValuedEventData(found.idx, found.time, found.n_neurons, found.t_max, ones)


@pytest.mark.parametrize("data", [grid, events, valued])
@pytest.mark.parametrize("node", ["input", "retina"])
def test_data_of_each_kind_is_read_and_written_without_losing_a_spike(data, node, tmp_path):
    out = tmp_path / "out.h5"
    found = emulate(written(tmp_path / "in.h5", data(), node), out)
    assert found.exit_code == 0, found.exception
    back = nir.read_data(out).nodes["output"].observables
    (rows,) = (each.data for each in back.values())
    np.testing.assert_array_equal(rows[0], recorded()[1])


def test_a_grid_of_another_dt_is_refused(tmp_path):
    found = emulate(written(tmp_path / "in.h5", grid(1e-3)), tmp_path / "out.npz")
    assert "a grid of dt = 0.001 s, the network 0.0001 s" in str(found.exception)


def test_a_file_of_another_kind_is_refused(tmp_path):
    found = emulate(EXPORTS / "snntorch_leaky.nir", tmp_path / "out.npz")
    assert "is HDF5 and no NIRData: Root object is not NIRGraphData" in str(found.exception)
