"""The tables of docs/fpga.md are made of its record; every clock is counted, and bounded."""

import numpy as np

from lab import fpga
from spikedeploy import zoo
from spikedeploy.exporters.verilog.image import core_image
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.shipping.export_verilog import program_for
from tests.core_model import CoreModel
from tests.paths import ROOT


def test_the_page_has_the_tables_of_its_record():
    text = (ROOT / "docs/fpga.md").read_text("utf-8")
    made = text
    for place, table in fpga.tables(fpga.recorded()).items():
        made = fpga.put(made, place, table)
    assert made == text


def test_nothing_that_is_recorded_differs():
    rows = [row for row in fpga.recorded()["drive"].values() if "refused" not in row]
    assert rows
    assert not any(row["differing"] or row["unequal_returns"] for row in rows)
    assert max(row["residual"] for row in rows) < 1e-6  # the sum of clocks is exact


def test_a_synapse_of_a_row_takes_a_clock():
    artifact = load(zoo.path("kart-steer/sparse"))
    image = core_image(program_for(artifact, None)[1], artifact.codec)
    lengths, model = image.rows.lengths, CoreModel(image)
    assert len(lengths) == image.axons + image.neurons
    silent = model.step([]).clocks
    for axon in range(image.axons):
        model.reset()
        found = model.step([axon])
        fired = image.axons + np.flatnonzero(found.spikes)
        assert (found.clocks - silent - lengths[axon] - lengths[fired].sum()) >= 0


def test_no_timestep_takes_more_clocks_than_the_bound():
    artifact = load(zoo.path("kart-steer/sparse"))
    image = core_image(program_for(artifact, None)[1], artifact.codec)
    model, rng, encoder = CoreModel(image), np.random.default_rng(0), artifact.codec.encoder
    bound = fpga.bound_of(image, artifact, model.step([]).clocks)
    channels = np.arange(image.axons).reshape(encoder.observed, 2, encoder.most)
    most = 0
    for _ in range(100):  # observations that all move as far as they can, up or down
        moved = channels[np.arange(encoder.observed), rng.integers(0, 2, encoder.observed)]
        sent = moved.ravel() if encoder.code == "unary" else moved[:, -1]
        most = max(most, model.step(sent.tolist()).clocks)
    assert 0.8 * bound["bound"] < most <= bound["bound"]
