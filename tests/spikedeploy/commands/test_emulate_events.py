"""`spikedeploy emulate --events`: recordings of event cameras into networks on chips."""

import json
import re
import zlib
from base64 import b64decode
from itertools import pairwise

import nir
import numpy as np
import pytest

from spikedeploy.emulation import event_replay
from spikedeploy.emulation.event_input import EventView
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.camera_events import EVENT, write_events
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.families.integrate_and_fire.event_machine import EventMachine
from tests.packed_arrays import unpacked
from tests.paths import GOLDEN

SIZE = HEIGHT, WIDTH = 12, 16
DT = 1e-3


def write_network(path, channels=2, height=6, width=8):
    """Two convolutions and a fully connected layer of integrate-and-fire neurons."""
    rng = np.random.default_rng(1)

    def neurons(*shape):
        return nir.IF(np.full(shape, 1 / DT), np.full(shape, 1.0), np.zeros(shape))

    def convolution(outputs, inputs, shape, stride):
        weight = rng.normal(0.1, 0.5, (outputs, inputs, 3, 3))
        return nir.Conv2d(shape, weight, stride, 1, 1, 1, np.zeros(outputs))

    deep = 3 * (height // 2) * (width // 2)
    nodes = {
        "input": nir.Input(np.array([channels, height, width])),
        "conv1": convolution(4, channels, (height, width), 1),
        "if1": neurons(4, height, width),
        "conv2": convolution(3, 4, (height, width), 2),
        "if2": neurons(3, height // 2, width // 2),
        "flat": nir.Flatten({"input": np.array([3, height // 2, width // 2])}, 0, -1),
        "fc": nir.Linear(rng.normal(0.05, 0.3, (5, deep))),
        "if3": neurons(5),
        "output": nir.Output(np.array([5])),
    }
    names = list(nodes)
    nir.write(path, nir.NIRGraph(nodes, list(pairwise(names))))


def drawn(count=600, lasting=40_000, seed=0):
    rng = np.random.default_rng(seed)
    events = np.zeros(count, EVENT)
    events["x"], events["y"] = rng.integers(0, WIDTH, count), rng.integers(0, HEIGHT, count)
    events["t"] = 5_300 + np.sort(rng.integers(0, lasting, count))
    events["p"] = rng.integers(0, 2, count)
    return events


@pytest.fixture
def files(tmp_path):
    """A network and a recording of a camera twice its size; returns the recording's events."""
    write_network(tmp_path / "net.nir")
    events = drawn()
    with write_events(tmp_path / "rec.h5", SIZE) as writer:
        writer.write(events)
    return events


@pytest.fixture
def emulate(command, tmp_path):
    def run(*words, network="net.nir", recording="rec.h5"):
        files = (tmp_path / network, "--events", tmp_path / recording)
        return command("emulate", *map(str, (*files, "--dt", DT, *words)))

    return run


def counted(events, shape=(2, 6, 8), us=1000, downsample=2, x=0, y=0):
    """Events of each neuron and timestep, written as loops."""
    channels, height, width = shape
    steps = events["t"] // us
    rows = np.zeros((int(steps[-1] - steps[0]) + 1, *shape), np.int64)
    for event, step in zip(events, steps - steps[0], strict=True):
        column, row = (int(event["x"]) - x) // downsample, (int(event["y"]) - y) // downsample
        if 0 <= column < width and 0 <= row < height:
            rows[step, int(event["p"]) if channels == 2 else 0, row, column] += 1
    return rows


@pytest.mark.parametrize("chip", ["speck2f", "loihi1", "int", "float"])
def test_spikes_are_those_of_one_inference_over_all_timesteps(
    chip, files, emulate, command, tmp_path
):
    code, _, err = emulate("--chip", chip, "--downsample", "2", "-o", str(tmp_path / "a.h5"))
    assert code == 0, err
    rows = counted(files)
    if chip != "float":
        rows = np.minimum(rows, datasheet(chip).input_spikes_max).astype(np.uint8)
    np.save(tmp_path / "rows.npy", rows)
    words = ("--input", tmp_path / "rows.npy", "--dt", DT, "-o", tmp_path / "b.npz")
    code, _, err = command("emulate", *map(str, (tmp_path / "net.nir", "--chip", chip, *words)))
    assert code == 0, err
    wanted = dict(np.load(tmp_path / "b.npz"))
    assert wanted["if3"].sum() > 10
    nodes = nir.read_data(tmp_path / "a.h5").nodes
    found = {"output": nodes["output"].observables["output"].data[0]}
    for name in ("if1", "if2", "if3"):
        data = nodes[name].observables["spikes"]
        raster = np.zeros((len(rows), data.n_neurons), np.int64)
        steps = np.rint(data.time[0] / DT).astype(int)
        np.add.at(raster, (steps, data.idx[0]), 1)
        found[name] = raster.reshape(wanted[name].shape)
    assert found.keys() == wanted.keys()
    for name, spikes in wanted.items():
        np.testing.assert_array_equal(found[name], spikes, name)


def test_counts_are_of_the_events_that_the_network_sees(files, emulate):
    region = ("--region", "3,2,8,6", "--time-step", "2ms", "--chip", "loihi1", "--json")
    code, out, err = emulate(*region)
    assert code == 0, err
    found, rows = json.loads(out), counted(files, us=2000, downsample=1, x=3, y=2)
    assert (found["events"], found["events_seen"]) == (len(files), rows.sum())
    assert found["events_clipped"] == (rows - np.minimum(rows, 1)).sum() > 0
    assert (found["timesteps"], found["seconds"]) == (len(rows), 2e-3 * len(rows))
    energies = [each["energy_j"] for each in found["layers"].values()]
    for table, joules in found["energy_j"].items():
        assert sum(each[table] for each in energies) == pytest.approx(joules)
        assert found["power_w"][table] == pytest.approx(joules / found["seconds"])
    assert sum(each["sops"] for each in found["layers"].values()) == found["sops"] > 0
    assert any(f"{found['events_clipped']} of {rows.sum()} events" in r for r in found["remarks"])


def test_event_by_event_spikes_are_those_of_the_event_machine(files, emulate, tmp_path):
    chip, out = "speck2f:queue=on", str(tmp_path / "a.h5")
    code, printed, err = emulate(
        "--chip", chip, "--step", "event", "--downsample", "2", "-o", out, "--json"
    )
    assert code == 0, err
    artifact = load(tmp_path / "net.nir", dt=DT)
    machine = EventMachine(compile_program(artifact, datasheet(chip)), "interpreter")
    x, y = files["x"].astype(int) // 2, files["y"].astype(int) // 2
    sent = machine.process((files["p"] * 6 + y) * 8 + x)
    found, times = json.loads(printed), (files["t"] - files["t"][0]) / 1e6
    assert (found["timesteps"], found["events_clipped"]) == (None, 0)
    for name, wanted in sent.items():
        data = nir.read_data(out).nodes[name].observables["spikes"]
        np.testing.assert_array_equal(data.idx[0], wanted.neuron)  # in their order
        np.testing.assert_allclose(data.time[0], times[wanted.cause], atol=1e-9)
        assert found["layers"][name]["spikes"] == len(wanted.neuron) > 5
    assert found["outputs"]["output"] == np.bincount(sent["if3"].neuron, minlength=5).tolist()
    assert found["sops"] == machine.ledger.total("sop")


def test_a_timestep_into_a_chip_that_goes_event_by_event_is_remarked(files, emulate):
    said = {}
    for step in ("time", "event"):
        words = ("--downsample", "2", "--step", step, "--chip", "speck2f:queue=on", "--json")
        code, out, err = emulate(*words)
        assert code == 0, err
        said[step] = " ".join(json.loads(out)["remarks"])
    assert "in the order of their neurons" in said["time"]
    assert "in the order of their neurons" not in said["event"]


def test_timesteps_as_snntorch_writes_them_are_remarked(files, tmp_path, command):
    graph = nir.read(tmp_path / "net.nir")
    for node in graph.nodes.values():
        if isinstance(node, nir.IF):
            node.r = np.full(node.r.shape, 1e4)
    nir.write(tmp_path / "mine.nir", graph)
    words = ("emulate", tmp_path / "mine.nir", "--events", tmp_path / "rec.h5", "--downsample", 2)
    for more, is_said in (((), True), (("--time-step", "1ms"), False)):
        given = ("--from", "snntorch", "--chip", "speck2f", *more, "--json")
        code, out, err = command(*words, *given)
        assert code == 0, err
        remarks = " ".join(json.loads(out)["remarks"])
        assert ("timesteps of 0.1 ms, as snnTorch writes" in remarks) == is_said
        assert "several spikes in one timestep" in remarks or more == ()


def test_polarities_that_are_merged_are_remarked(files, emulate, tmp_path):
    write_network(tmp_path / "one.nir", channels=1)
    code, out, err = emulate("--downsample", "2", "--chip", "speck2f", "--json", network="one.nir")
    assert code == 0, err
    assert "both polarities" in " ".join(json.loads(out)["remarks"])


def test_only_chips_that_go_event_by_event_take_events(files, emulate, tmp_path):
    for chip, said in (("loihi1", "does not go event by event"), ("float", "float computes")):
        code, _, err = emulate("--chip", chip, "--step", "event", "--downsample", "2")
        assert (code, said in err) == (2, True)


def test_one_channel_takes_both_polarities():
    events = drawn()
    view = EventView((1, 6, 8), downsample=2)
    neurons = np.bincount(view.neurons(events), minlength=48)
    np.testing.assert_array_equal(neurons, counted(events, (1, 6, 8)).sum(axis=0).ravel())


@pytest.mark.parametrize(("on_first", "neuron"), [(False, 49), (True, 1)])
def test_the_channel_of_rising_light_can_be_chosen(on_first, neuron):
    events = np.array([(1, 0, 0, 1)], EVENT)
    assert EventView((2, 6, 8), on_first=on_first).neurons(events).tolist() == [neuron]


def test_rows_and_columns_left_over_are_not_seen():
    events = np.array([(14, 0, 0, 1), (15, 0, 0, 1), (0, 11, 0, 1)], EVENT)
    neurons = EventView((1, 3, 5), downsample=3).neurons(events)
    assert neurons.tolist() == [4, -1, -1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "12x16 pixels .* takes 6x8. Such as --downsample 2 --region 0,0,16,12"),
        (("--region", "9,0,8,6"), "not a part of a camera of 12x16"),
        (("--region", "-1,0,8,6"), "not a part"),
        (("--region", "0,0,8"), "is no x,y,width,height"),
        (("--region", "0,0,0,6"), "at least one pixel"),
        (("--camera", "12x-16"), "least is 1x1"),
        (("--camera", "12"), "is no height x width"),
        (("--camera", "16x12"), "says that its camera has 12x16"),
        (("--downsample", "2", "--time-step", "1"), "number and its unit"),
        (("--downsample", "2", "--time-step", "0ms"), "above 0"),
        (("--downsample", "2", "--input", "rec.h5"), "two inputs"),
        (("--downsample", "2", "-o", "a.npz"), "name a .h5 file"),
        (("--downsample", "2", "--step", "event", "--time-step", "1ms"), "leave --time-step out"),
    ],
)
def test_options_that_cannot_be_are_refused_in_a_sentence(words, said, files, emulate, tmp_path):
    words = [str(tmp_path / word) if word == "rec.h5" else word for word in words]
    code, _, err = emulate("--chip", "speck2f", *words)
    assert code == 2
    assert_said(said, err)


def assert_said(said, err):
    assert re.search(said, " ".join(err.replace("│", " ").split())), err


def test_a_network_without_pixels_is_refused(files, emulate, tmp_path):
    write_network(tmp_path / "three.nir", channels=3)
    code, _, err = emulate("--chip", "speck2f", network="three.nir")
    assert code == 2
    assert_said(r"inputs 'input' \(3, 6, 8\)", err)


def test_a_page_is_bounded_and_holds_every_layer(files, emulate, tmp_path, monkeypatch):
    monkeypatch.setattr(event_replay, "_MOST_CELLS", 5000)
    for step, chip in (("time", "speck2f"), ("event", "speck2f:queue=on")):
        page = tmp_path / step
        words = ("--downsample", "2", "--step", step, "--chip", chip, "--page", str(page))
        code, out, err = emulate(*words)
        assert code == 0, err
        assert "report.html" in out
        html, found = (
            (page / "report.html").read_text(),
            json.loads((page / "report.json").read_text()),
        )
        (episode,) = json.loads(re.search(r'id="episodes-data">(.*?)</script>', html)[1])
        maps, tracks = episode["scene"]["maps"], episode["players"][0]["tracks"]
        assert [each["name"] for each in maps] == ["input", "if1", "if2", "if3"]
        assert [each["size"] for each in maps[:2]] == ["2×6×8", "4×6×8"]
        assert maps[1]["shape"] == [4, 6, 8]
        assert episode["scene"]["every"] > 1
        assert f"every {episode['scene']['every']}th of" in html
        bits = [zlib.decompress(b64decode(each["spikes"]["data"])) for each in maps]
        assert 0 < 8 * sum(map(len, bits)) <= 6000
        assert all(np.frombuffer(each, np.uint8).any() for each in bits)
        # the curves count everything
        spikes = [unpacked(each["values"]).sum() * episode["period"] for each in tracks]
        layers = [each["spikes"] for each in found["layers"].values()]
        assert spikes[1:] == pytest.approx(layers, rel=1e-3)
        assert spikes[0] == pytest.approx(found["events_seen"] - found["events_clipped"], rel=1e-3)


@pytest.fixture
def recorded(command):
    """Emulates the network of tests/golden/events on a recording; returns the JSON or the error."""

    def run(recording, *words):
        files = (GOLDEN / "events/net.nir", "--events", recording, "--chip", "loihi1")
        code, out, err = command(
            "emulate", *map(str, (*files, "--dt", DT, "--time-step", "1ms", "--json", *words))
        )
        return json.loads(out) if code == 0 else err

    return run


# as Prophesee writes them, but unpacked; beside an unrelated dataset with fields; and the other
# coding of polarity
@pytest.mark.parametrize("name", ["cd.hdf5", "comp.h5", "signed.npy", "CD.HDF5"])
def test_a_recording_gives_the_same_spikes_in_every_layout(name, recorded, tmp_path):
    path = GOLDEN / "events" / name
    if name == "signed.npy":
        events = np.load(GOLDEN / "events/p12.npy")
        kinds = [(n, "i1" if n == "p" else events.dtype[n]) for n in events.dtype.names]
        events = events.astype(kinds)
        events["p"] = 2 * events["p"] - 3
        np.save(path := tmp_path / name, events)
    if name == "CD.HDF5":
        path = tmp_path / name
        path.write_bytes((GOLDEN / "events/cd.hdf5").read_bytes())
    found = recorded(path)
    assert (found["events"], found["events_seen"]) == (400, 400)
    assert found["layers"]["n"]["spikes"] == 9
    assert all(found["events_of_channels"])
    assert not any("got no event" in each for each in found["remarks"])


def test_polarities_1_and_2_are_refused_with_what_was_found(recorded):
    said = recorded(GOLDEN / "events/p12.npy")
    assert "has the polarities 1, 2; known are 0" in said


@pytest.mark.parametrize(("words", "channel"), [((), 0), (("--channels", "on-off"), 1)])
def test_a_channel_that_no_event_reaches_is_remarked(words, channel, recorded):
    found = recorded(GOLDEN / "events/onlyon.npy", *words)
    assert found["events_of_channels"] == ([0, 400] if channel == 0 else [400, 0])
    assert f"channel {channel} of the Input got no event: all 400" in " ".join(found["remarks"])


def test_a_recording_of_which_the_network_sees_nothing_is_remarked(recorded, tmp_path):
    events = np.load(GOLDEN / "events/onlyon.npy")
    events["x"] += 20
    np.save(tmp_path / "a.npy", events)
    found = recorded(tmp_path / "a.npy", "--camera", "8x40", "--region", "0,0,8,8")
    assert "no event of the recording reaches the Input" in found["remarks"]


def test_options_of_recordings_need_one(files, command, tmp_path):
    path = str(tmp_path / "net.nir")
    for words, said in ((("--camera", "3x4"), "go with --events"), ((), "--input FILE")):
        code, _, err = command("emulate", path, "--chip", "int", *words)
        assert code == 2
        assert_said(said, err)
