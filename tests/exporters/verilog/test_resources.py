"""What a core takes of an FPGA, as predicted, is what builds take."""

import json
from dataclasses import replace

import numpy as np
import pytest

from spikedeploy import zoo
from spikedeploy.exporters.verilog.board_files import board_files
from spikedeploy.exporters.verilog.boards import board
from spikedeploy.exporters.verilog.resources import Buffer, CoreMemory, Use, predict
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.errors import RuleError
from tests.board_designs import export, image_of, make, needs, walk
from tests.networks import event_driven, popsan

UP5K, ECP5 = board("icebreaker").device, board("ulx3s").device


@pytest.mark.parametrize(
    ("words", "bits", "constant", "on", "place"),
    [
        (256, 16, False, UP5K, ("blocks", 1)),
        (512, 14, False, UP5K, ("blocks", 2)),  # 512 x 8 each
        (462, 11, True, UP5K, ("blocks", 2)),
        (5575, 16, True, UP5K, ("blocks", 22)),  # 512 x 8
        (5873, 16, True, UP5K, ("blocks", 24)),  # 2048 x 2: fewer multiplexers than 23 of 256 x 16
        (1149, 11, True, UP5K, ("blocks", 4)),  # 5 words side by side, 256 deep
        (5575, 16, True, ECP5, ("blocks", 5)),  # 11 words side by side, 512 deep
        (26, 38, True, UP5K, ("logic", 988)),
        (64, 14, False, UP5K, ("blocks", 1)),
        (64, 14, False, ECP5, ("small", 16)),
        (64, 25, False, ECP5, ("blocks", 1)),
        (32, 25, False, ECP5, ("small", 14)),
        (146, 41, True, ECP5, ("blocks", 2)),
    ],
)
def test_memories_are_placed_as_yosys_places_them(words, bits, constant, on, place):
    found = CoreMemory("m", words, bits, constant).place(on)
    assert (found.kind, found.count) == place


# cells, block RAMs and large RAMs of builds: yosys 0.23, nextpnr 0.4 and, for the ULX3S, 0.11
BUILT = {
    "icebreaker": {
        "hexapod/sparse": (887, 9, 0),
        "hexapod-command/sparse": (949, 30, 2),
        "hexapod-command/sparse-gated": (945, 29, 2),
        "kart-gazebo/sparse-gated": (837, 7, 0),
        "kart-grid/sparse": (862, 9, 0),
        "kart-steer/sparse": (874, 8, 0),
    },
    "ulx3s": {
        "hexapod/sparse": (1434, 4, 0),
        "hexapod-command/sparse-gated": (1281, 11, 0),
        "kart-gazebo/sparse-gated": (1391, 2, 0),
        "kart-grid/sparse": (1281, 3, 0),
        "kart-steer/sparse-gated": (1190, 3, 0),
    },
}


@pytest.mark.parametrize(("on", "name"), [(on, name) for on in BUILT for name in BUILT[on]])
def test_predictions_are_within_a_tenth_of_builds(on, name):
    cells, blocks, large = BUILT[on][name]
    use = predict(image_of(load(zoo.path(name))), board(on))
    assert (use.block_rams, use.large_rams) == (blocks, large)
    assert abs(use.cells / cells - 1) < 0.1
    assert use.fits


def test_each_shipped_sparse_policy_fits_each_board_but_the_command_ones_on_an_hx():
    names = [name for name in zoo.names() if "sparse" in name and zoo.path(name).suffix == ".nir"]
    images = {name: image_of(load(zoo.path(name))) for name in names}
    for on in ("icebreaker", "upduino", "ulx3s"):
        assert all(predict(image, board(on)).fits for image in images.values())
    for on in ("icestick", "ice40-hx8k"):
        full = {name: predict(image, board(on)).full for name, image in images.items()}
        command = {name for name in names if name.startswith("hexapod-command")}
        assert {name for name, what in full.items() if what} == command


def test_states_and_then_the_buffer_move_where_block_ram_is_short():
    image, on = image_of(load(zoo.path("hexapod/sparse"))), board("icebreaker")

    def with_blocks(count):
        return predict(image, replace(on, device=replace(on.device, block_rams=count)))

    found = [
        (use.block_rams, use.large_rams, use.states_in_large_ram, use.buffer_in_large_ram, use.fits)
        for use in map(with_blocks, (9, 8, 6, 5))
    ]
    assert found == [
        (9, 0, False, False, True),
        (7, 2, True, False, True),
        (6, 3, True, True, True),
        (6, 3, True, True, False),
    ]
    assert predict(image_of(load(zoo.path("hexapod-command/sparse"))), on).states_in_large_ram


def test_a_design_that_does_not_fit_is_refused_by_what_is_full():
    use = Use(board("icestick"), cells=1300, block_rams=9, large_rams=0, multipliers=0)
    assert use.full == ("cells",)
    with pytest.raises(
        RuleError, match=r"rule cells: the policy takes about 1,300 cells; the .*1,2"
    ):
        use.check()
    with pytest.raises(
        RuleError, match="rule memory: the policy takes about 17 block RAMs of 4096"
    ):
        replace(use, cells=1000, block_rams=17).check()
    assert use.lines()[0].split() == ["cells", "1,300", "of", "1,280", "(102%),", "too", "few"]
    assert not use.record()["fits"]


def test_a_policy_too_large_for_the_board_is_refused_before_a_file_is_written():
    artifact = popsan(obs=12, hidden=(128, 128))
    with pytest.raises(RuleError, match="rule memory"):
        board_files(
            image_of(artifact), artifact.codec, board("icestick"), "x", walk(artifact.codec, 2)
        )


@pytest.mark.parametrize(("words", "bits"), [(1, 8), (64, 8), (65, 9), (128, 9), (255, 10)])
def test_the_buffer_of_the_link_has_room_for_the_words_of_a_timestep(words, bits):
    buffer = Buffer(words)
    assert buffer.address_bits == bits
    assert buffer.words_most >= words
    assert buffer.tokens_most >= 128
    buffer.check()
    with pytest.raises(RuleError, match="rule link"):
        Buffer(256).check()


@pytest.mark.fpga
@needs("yosys", "nextpnr-ice40", "icepack", "make")
@pytest.mark.parametrize("name", ["icebreaker", "icestick"])
@pytest.mark.parametrize("seed", [0, 1])
def test_predictions_are_within_a_tenth_of_a_new_build(name, seed, tmp_path):
    rng = np.random.default_rng(seed)
    artifact = event_driven(
        obs=int(rng.integers(4, 12)), hidden=int(rng.integers(8, 30)), act=3, seed=seed
    )
    export(artifact, name, tmp_path)
    make(tmp_path, "bit")
    costs = json.loads((tmp_path / "costs.json").read_text())
    built, predicted = costs["built"][0], costs["predicted"]
    assert built["block_rams"] == predicted["block_rams"]
    assert abs(predicted["cells"] / built["cells"] - 1) < 0.1
    assert built["mhz"] > 12
