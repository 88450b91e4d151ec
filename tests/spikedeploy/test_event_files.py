"""Recordings of event cameras: the same events from every format, and what is refused."""

import importlib.util
import re

import h5py
import nir
import numpy as np
import pytest

from spikedeploy.emulation.event_files import open_recording
from spikedeploy.events import EVENT, write_events
from spikedeploy.runtime.errors import ObservationError

SIZE = HEIGHT, WIDTH = 48, 64
COUNT = 150_000  # more than is read at once


def drawn(count=COUNT, seed=0):
    rng = np.random.default_rng(seed)
    events = np.zeros(count, EVENT)
    events["x"], events["y"] = rng.integers(0, WIDTH, count), rng.integers(0, HEIGHT, count)
    events["t"] = 7 + np.cumsum(rng.integers(0, 9, count))
    events["p"] = rng.integers(0, 2, count)
    return events


def write_ours(path, events):
    with write_events(path, SIZE) as writer:
        writer.write(events)


def write_columns(path, columns, **more):
    with h5py.File(path, "w") as file:
        for name in "xytp":
            file[f"events/{name}"] = columns[name]
        for name, value in more.items():
            file[name] = value


def write_dsec(path, events):
    """The layout of DSEC, without its compression."""
    relative = (events["t"] - 7).astype(np.uint32)
    columns = {name: events[name] for name in "xyp"} | {"t": relative}
    write_columns(path, columns, t_offset=7, ms_to_idx=np.arange(3))


def write_signed(path, events):
    polarity = 2 * events["p"].astype(np.int8) - 1
    write_columns(path, {name: events[name] for name in "xyt"} | {"p": polarity})


def write_numpy(path, events):
    np.save(path, events)


def write_tonic(path, events):
    np.save(path, events.astype([("x", "<i8"), ("y", "<i8"), ("t", "<i8"), ("p", "?")]))


def write_nir(path, events):
    neuron = (events["p"].astype(int) * HEIGHT + events["y"]) * WIDTH + events["x"]
    data = nir.EventData(neuron[None], events["t"][None] * 1e-6, 2 * HEIGHT * WIDTH, 10.0)
    nir.write_data(path, nir.NIRGraphData({"eye": nir.NIRNodeData({"spikes": data})}))


def write_faery(path, events):
    faery = pytest.importorskip("faery", reason="the extra events is not installed")
    rows = np.zeros(len(events), faery.EVENTS_DTYPE)
    for name, other in zip("xytp", ("x", "y", "t", "on"), strict=True):
        rows[other] = events[name]
    faery.events_stream_from_array(rows, (WIDTH, HEIGHT)).to_file(path)


WRITERS = {
    "ours.h5": write_ours,
    "dsec.h5": write_dsec,
    "signed.h5": write_signed,
    "ours.npy": write_numpy,
    "tonic.npy": write_tonic,
    "nir.h5": write_nir,
    "a.aedat4": write_faery,
    "a.raw": write_faery,
    "a.dat": write_faery,
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_has_the_same_events(name, tmp_path):
    path, wanted = tmp_path / name, drawn()
    WRITERS[name](path, wanted)
    recording = open_recording(path, fallback=SIZE)
    parts = list(recording.events())
    assert recording.size == SIZE
    assert len(parts) > 1
    np.testing.assert_array_equal(np.concatenate(parts), wanted)
    np.testing.assert_array_equal(np.concatenate(list(recording.events())), wanted)  # once more


@pytest.mark.skipif(not importlib.util.find_spec("hdf5plugin"), reason="the extra dsec")
def test_columns_compressed_by_blosc_are_read(tmp_path):
    import hdf5plugin

    path, wanted = tmp_path / "a.h5", drawn(100)
    with h5py.File(path, "w") as file:
        for name in "xytp":
            file.create_dataset(f"events/{name}", data=wanted[name], **hdf5plugin.Blosc())
    np.testing.assert_array_equal(np.concatenate(list(open_recording(path).events())), wanted)


@pytest.mark.parametrize("kind", ["uint32", "int32"])
def test_a_counter_of_32_bits_that_wraps_goes_on(kind, tmp_path):
    path, events = tmp_path / "a.npy", drawn(8)
    events["t"] = np.iinfo(kind).max - 30 + 10 * np.arange(8)
    np.save(path, events.astype([(n, kind if n == "t" else EVENT[n]) for n in EVENT.names]))
    (found,) = open_recording(path, SIZE).events()
    np.testing.assert_array_equal(found, events)


def changed(**columns):
    """Columns of nine events, of each name one value at a place changed."""
    events = {name: drawn(9)[name].astype(np.int64) for name in "xytp"}
    for name, (place, value) in columns.items():
        events[name][place] = value
    return events


IMPOSSIBLE = {
    "out of order": (changed(t=(4, 9)), "event 4 at t = 9 us comes [0-9]+ us before"),
    "restarted": (changed(t=(slice(5), 1 << 40)), "event 5 at t = .* us before the one ahead"),
    "negative time": (changed(t=(0, -5)), "t = -5 us"),
    "outside": (changed(x=(3, WIDTH)), "event 3 is at x = 64.*48x64.*--camera"),
    "above": (changed(y=(3, -1)), "event 3 is at x = .* y = -1"),
    "seconds": (changed() | {"t": np.linspace(0, 1, 9)}, "t float64.*whole numbers"),
    "cut": (changed() | {"p": np.ones(8, int)}, "one length"),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_a_recording_that_cannot_be_is_refused_in_a_sentence(name, tmp_path):
    columns, said = IMPOSSIBLE[name]
    write_columns(tmp_path / "a.h5", columns)
    with pytest.raises(ObservationError, match=said):
        list(open_recording(tmp_path / "a.h5", SIZE).events())


def cut(path, share):
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


@pytest.mark.parametrize("name", ["ours.h5", "ours.npy", "a.aedat4"])
@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.99])
def test_a_truncated_recording_is_refused(name, share, tmp_path):
    path = tmp_path / name
    WRITERS[name](path, drawn())
    cut(path, share)
    with pytest.raises(ObservationError, match=str(path)):
        list(open_recording(path, SIZE).events())


@pytest.mark.parametrize("name", ["a.raw", "a.dat"])
def test_formats_without_a_length_are_read_up_to_their_end(name, tmp_path):
    path, wanted = tmp_path / name, drawn()
    WRITERS[name](path, wanted)
    cut(path, 0.5)
    found = np.concatenate(list(open_recording(path).events()))
    assert 0.4 * COUNT < len(found) < 0.6 * COUNT
    np.testing.assert_array_equal(found, wanted[: len(found)])


@pytest.mark.parametrize("version", ["dat", "evt2", "evt3"])
def test_recordings_of_prophesee_whose_times_jump_back_are_refused(version, tmp_path):
    faery = pytest.importorskip("faery", reason="the extra events is not installed")
    path, rows = tmp_path / ("a.dat" if version == "dat" else "a.raw"), drawn(20_000)
    rows = np.rec.fromarrays([rows[n] for n in "txyp"], faery.EVENTS_DTYPE)
    format_of = {} if version == "dat" else {"version": version}
    faery.events_stream_from_array(rows, (WIDTH, HEIGHT)).to_file(path, **format_of)
    assert sum(map(len, open_recording(path).events())) == len(rows)
    header, body = re.fullmatch(rb"((?:%[^\n]*\n)+)(.*)", path.read_bytes(), re.DOTALL).groups()
    start, body = (body[:2], body[2:]) if version == "dat" else (b"", body)
    path.write_bytes(header + start + 2 * body)
    with pytest.raises(ObservationError, match=r"back|before the one ahead"):
        list(open_recording(path).events())


def test_a_dat_whose_counter_wraps_goes_on(tmp_path):
    path, wanted = tmp_path / "a.dat", drawn(1000)
    wanted["t"] += (1 << 32) - 2000
    # Prophesee, Encoding Formats, DAT: x, y and p in 14, 14 and 4 bits
    words = wanted["x"].astype("<u4") | wanted["y"].astype("<u4") << 14
    words |= wanted["p"].astype("<u4") << 28
    body = np.stack([(wanted["t"] % (1 << 32)).astype("<u4"), words], 1).tobytes()
    path.write_bytes(b"% Version 2\n% Width 64\n% Height 48\n\x0c\x08" + body)
    pytest.importorskip("faery", reason="the extra events is not installed")
    found = np.concatenate(list(open_recording(path).events()))
    np.testing.assert_array_equal(found, wanted)


def test_other_files_are_refused(tmp_path):
    h5py.File(tmp_path / "empty.h5", "w").close()
    np.save(tmp_path / "raster.npy", np.zeros((4, 2)))
    np.save(tmp_path / "objects.npy", np.array([{}], object), allow_pickle=True)
    (tmp_path / "text.csv").write_text("1,2,3,1\n")
    (tmp_path / "noise.raw").write_bytes(b"1234" * 9)
    said = {
        "empty.h5": "events/p is missing",
        "raster.npy": "--input",
        "objects.npy": "object",
        "text.csv": "no recording",
        "noise.raw": "no header",
        "absent.h5": "no file",
    }
    for name, words in said.items():
        with pytest.raises(ObservationError, match=words):
            list(open_recording(tmp_path / name).events())


def test_a_camera_other_than_the_file_says_is_refused(tmp_path):
    write_ours(tmp_path / "a.h5", drawn(9))
    with pytest.raises(ObservationError, match=r"48x64 .* --camera 64x48"):
        open_recording(tmp_path / "a.h5", (64, 48))
    write_nir(tmp_path / "b.h5", drawn(9))
    with pytest.raises(ObservationError, match="6144 neurons; a camera 34x34"):
        open_recording(tmp_path / "b.h5", (34, 34))
