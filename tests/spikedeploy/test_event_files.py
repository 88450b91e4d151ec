"""Recordings of event cameras: the same events from every format, and what is refused."""

import importlib.util
import re

import h5py
import numpy as np
import pytest

from spikedeploy.emulation.event_files import open_recording
from spikedeploy.runtime.camera_events import EVENT, write_events
from spikedeploy.runtime.errors import ObservationError

SIZE = HEIGHT, WIDTH = 48, 64
COUNT = 70_000  # more than is read at once


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


def write_ours_by(*names, group="events", seconds=False, **more):
    """Columns of these names for x, y, t, p in a group; times from 0 on where in seconds."""

    def write(path, events):
        with h5py.File(path, "w") as file:
            for name, key in zip(names, "xytp", strict=True):
                column = events[key] * 1e-6 if key == "t" and seconds else events[key]
                file[f"{group}/{name}"] = column
            for name, value in more.items():
                file[name] = value

    return write


def write_table(place, order, kind):
    """A table (N, 4) of these columns; in floats, times are in seconds and polarity -1 or 1."""

    def write(path, events):
        columns = {key: events[key].astype(kind) for key in "xytp"}
        if kind == "f8":
            columns |= {"t": events["t"] * 1e-6, "p": 2.0 * events["p"] - 1}
        with h5py.File(path, "w") as file:
            file[place] = np.stack([columns[key] for key in order], 1)
            file["frame"] = np.zeros((2, 4, 4))

    return write


def write_compound(place, **names):
    """Fields of one dataset, compressed, beside others that are no events."""

    def write(path, events):
        kinds = {"x": "<u2", "y": "<u2", "p": "<i2", "t": "<i8"}
        rows = np.zeros(len(events), [(names.get(name, name), kinds[name]) for name in kinds])
        for name in "xytp":
            rows[names.get(name, name)] = events[name]
        with h5py.File(path, "w") as file:
            file.create_dataset(place, data=rows, compression="gzip")
            file["EXT_TRIGGER/events"] = np.zeros(3, [("p", "<i2"), ("t", "<i8"), ("id", "<i2")])
            file["CD/indexes"] = np.zeros(3, [("id", "<u8"), ("ts", "<i8")])
            file.attrs["geometry"] = f"{WIDTH}x{HEIGHT}"

    return write


def write_beside(path, events):
    """The plain layout beside what no reader here takes: fields, references, texts, links."""
    write_columns(path, events)
    with h5py.File(path, "r+") as file:
        file["imu"] = np.zeros(5, [("a", "<f4", 3)])
        file["texts"] = ["one", "two"]
        file.create_dataset("references", data=[file.ref], dtype=h5py.ref_dtype)
        file["more/elsewhere"] = h5py.ExternalLink("other.h5", "/x")
        file["more/here"] = file["events"]


def write_linked(path, events):
    write_compound("CD/all")(path, events)
    with h5py.File(path, "r+") as file:
        file["CD/events"] = h5py.SoftLink("/CD/all")


def write_numpy_floats(path, events):
    """Numbers in floats, times in seconds."""
    rows = events.astype([(name, "<f8") for name in EVENT.names])
    rows["t"] *= 1e-6
    np.save(path, rows)


def write_numpy(path, events):
    with path.open("wb") as file:  # a name would get an ending in small letters
        np.save(file, events)


def write_tonic(path, events):
    np.save(path, events.astype([("x", "<i8"), ("y", "<i8"), ("t", "<i8"), ("p", "?")]))


def write_faery(path, events):
    faery = pytest.importorskip("faery", reason="the extra events is not installed")
    rows = np.zeros(len(events), faery.EVENTS_DTYPE)
    for name, other in zip("xytp", ("x", "y", "t", "on"), strict=True):
        rows[other] = events[name]
    small = path.with_suffix(path.suffix.lower())  # by which faery tells them apart
    faery.events_stream_from_array(rows, (WIDTH, HEIGHT)).to_file(small)
    small.rename(path)


WRITERS = {
    "ours.h5": write_ours,
    "dsec.h5": write_dsec,
    "signed.h5": write_signed,
    "cd.hdf5": write_compound("CD/events"),
    "linked.hdf5": write_linked,
    "fields.h5": write_compound("recording/all"),
    "fields-named.h5": write_compound("events", t="timestamp", p="polarity"),
    "v2e.h5": write_table("events", "txyp", "u4"),
    "esim.h5": write_ours_by("xs", "ys", "ts", "ps", seconds=True),
    "root.h5": write_ours_by("x", "y", "t", "p", group="/"),
    "beside.h5": write_beside,
    "floats.npy": write_numpy_floats,
    "UPPER.NPY": write_numpy,
    "UPPER.DAT": write_faery,
    "ours.npy": write_numpy,
    "tonic.npy": write_tonic,
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


@pytest.mark.parametrize("kind", ["uint32", "int32", "int64"])
def test_a_counter_of_32_bits_that_wraps_goes_on(kind, tmp_path):
    path, events = tmp_path / "a.npy", drawn(8)
    events["t"] = np.iinfo("int32" if kind == "int32" else "uint32").max - 30 + 10 * np.arange(8)
    stored = events["t"].astype("int32" if kind == "int32" else "uint32")
    rows = events.astype([(n, kind if n == "t" else EVENT[n]) for n in EVENT.names])
    rows["t"] = stored
    np.save(path, rows)
    if kind == "int64":
        with pytest.raises(ObservationError, match="of the one ahead of it"):
            list(open_recording(path, SIZE).events())
        return
    (found,) = open_recording(path, SIZE).events()
    np.testing.assert_array_equal(found, events)


# polarity of events -> what is said; None where it is a coding that is known
CODINGS = {
    "1 and 2": (lambda p: p + 1, "polarities 1, 2; known are 0 .* 1 .*, or -1 and 1"),
    "three": (lambda p: p - (np.arange(len(p)) % 2), "polarities -1, 0, 1"),
    "unsigned": (lambda p: 2 * p.astype("u4") - 1, "polarities 1, 4294967295"),
    "missing": (lambda p: np.where(p, 1.0, np.nan), "polarities .*nan"),
    "halves": (lambda p: 0.5 * p, "polarities 0, 0.5"),
    "signs in floats": (lambda p: 2.0 * p - 1, None),
    "booleans": (lambda p: p > 0, None),
    "falling": (lambda p: 0 * p, None),
    "negative": (lambda p: 0 * p - 1, None),
}


@pytest.mark.parametrize("how", ["npy", "h5"])
@pytest.mark.parametrize("name", CODINGS)
def test_a_polarity_of_another_coding_is_refused(name, how, tmp_path):
    code, said = CODINGS[name]
    events, path = drawn(50), tmp_path / f"a.{how}"
    columns = {key: events[key] for key in "xyt"} | {"p": code(events["p"].astype(np.int64))}
    if how == "npy":
        np.save(path, np.rec.fromarrays(list(columns.values()), names=list(columns)))
    else:
        write_columns(path, columns)
    if said is None:
        (found,) = open_recording(path, SIZE).events()
        np.testing.assert_array_equal(found["p"], columns["p"] > 0)
        return
    with pytest.raises(ObservationError, match=said):
        list(open_recording(path, SIZE).events())


def test_a_coding_is_judged_over_all_parts_of_a_recording(tmp_path):
    events = drawn()
    events["p"] = 1
    events["p"][-1] = 2
    np.save(tmp_path / "a.npy", events)
    with pytest.raises(ObservationError, match="polarities 1, 2"):
        list(open_recording(tmp_path / "a.npy", SIZE).events())


def hdf5(path, **members):
    with h5py.File(path, "w") as file:
        for name, value in members.items():
            file[name.replace("__", "/")] = value


def packed_by_ecf(path):
    """Prophesee's own, with the number of its filter and bytes that nobody here unpacks."""
    with h5py.File(path, "w") as file:
        kind = np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_chunk((64,))
        properties.set_filter(36559, h5py.h5z.FLAG_OPTIONAL, (0,))
        space = h5py.h5s.create_simple((64,))
        kind_id = h5py.h5t.py_create(kind)
        h5py.h5d.create(file.create_group("CD").id, b"events", kind_id, space, properties)


FIELDS = np.zeros(3, [("x", "<u2"), ("y", "<u2"), ("t", "<i8"), ("p", "u1")])
INTACT = {
    "ecf": (packed_by_ecf, r"filter 36559.*metavision_file_to_dat"),
    "other": (lambda path: hdf5(path, a=[1], b__c=FIELDS["x"]), r"holds a, b, b/c; known"),
    "two": (lambda path: hdf5(path, a=FIELDS, b=FIELDS), "holds a, b; known"),
    "whole seconds": (
        lambda path: hdf5(path, xs=[1, 1], ys=[1, 1], ts=[1.0, 2e6], ps=[1, 1]),
        "all of them whole; times in floats are seconds",
    ),
    "rectified": (
        lambda path: hdf5(path, xs=[1.5], ys=[1], ts=[0.1], ps=[1]),
        "at x = 1.5, .* whole pixels",
    ),
    "coarse": (
        lambda path: hdf5(path, events=np.float32([[5000.1, 1, 1, 1]])),
        "in float32, which has one number each 0.000488 s",
    ),
    "no time": (lambda path: hdf5(path, xs=[1], ys=[1], ts=[np.nan], ps=[1]), "at no time"),
    "late": (
        lambda path: hdf5(path, x=[1], y=[1], t=np.uint64([2**63]), p=[1]),
        "before t = 0 us",
    ),
    "elsewhere": (
        lambda path: hdf5(path, CD__events=h5py.ExternalLink("other.h5", "/x"), a=[1]),
        "holds|another file",
    ),
}


@pytest.mark.parametrize("name", INTACT)
def test_of_an_intact_file_it_is_never_said_that_it_is_damaged(name, tmp_path):
    write, said = INTACT[name]
    write(tmp_path / "a.hdf5")
    with pytest.raises(ObservationError, match=said) as caught:
        list(open_recording(tmp_path / "a.hdf5").events())
    assert not re.search("damaged|truncated", str(caught.value))


def changed(**columns):
    """Columns of nine events, of each name one value at a place changed."""
    events = {name: drawn(9)[name].astype(np.int64) for name in "xytp"}
    for name, (place, value) in columns.items():
        events[name][place] = value
    return events


IMPOSSIBLE = {
    "out of order": (changed(t=(4, 9)), "event 4 is at t = 9 us, before t = [0-9]+ us"),
    "restarted": (changed(t=(slice(5), 1 << 40)), "event 5 is at t = .* us of the one ahead"),
    "negative time": (changed(t=(0, -5)), "t = -5 us"),
    "outside": (changed(x=(3, WIDTH)), "event 3 is at x = 64.*48x64.*--camera"),
    "above": (changed(y=(3, -1)), "event 3 is at x = .* y = -1"),
    "texts": (changed() | {"t": [b"1"] * 9}, "must be columns of numbers"),
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


def dat_words(events):
    """Prophesee, Encoding Formats, DAT: x, y and p in 14, 14 and 4 bits behind the time."""
    words = events["x"].astype("<u4") | events["y"].astype("<u4") << 14
    words |= events["p"].astype("<u4") << 28
    return np.stack([(events["t"] % (1 << 32)).astype("<u4"), words], 1).tobytes()


def write_dat(path, events, header=b"% Version 2\n% Width 64\n% Height 48\n\x0c\x08"):
    path.write_bytes(header + dat_words(events))


def test_a_dat_is_read_without_faery(tmp_path):
    path, wanted = tmp_path / "a.dat", drawn(1000)
    wanted["t"] += (1 << 32) - 2000  # its counter of 32 bits wraps
    write_dat(path, wanted)
    recording = open_recording(path)
    assert recording.size == SIZE
    np.testing.assert_array_equal(np.concatenate(list(recording.events())), wanted)
    write_dat(path, wanted[::-1])
    with pytest.raises(ObservationError, match="before t = "):
        list(open_recording(path).events())
    wanted["p"] += 1
    write_dat(path, wanted)
    with pytest.raises(ObservationError, match="polarities 1, 2"):
        list(open_recording(path).events())
    write_dat(path, wanted, b"% Version 2\n\x0e\x08")  # triggers
    with pytest.raises(ObservationError, match="no events"):
        open_recording(path)
    write_dat(path, wanted)
    path.write_bytes(path.read_bytes()[:-3])
    assert "cut within" in open_recording(path).remarks[0]
    write_dat(path, wanted, b"% Version 1\n\x0c\x08")
    with pytest.raises(ObservationError, match="version 2"):
        open_recording(path)


def test_other_files_are_refused(tmp_path):
    h5py.File(tmp_path / "empty.h5", "w").close()
    np.save(tmp_path / "raster.npy", np.zeros((4, 2)))
    np.save(tmp_path / "objects.npy", np.array([{}], object), allow_pickle=True)
    (tmp_path / "text.csv").write_text("1,2,3,1\n")
    (tmp_path / "noise.raw").write_bytes(b"1234" * 9)
    said = {
        "empty.h5": "holds nothing; known are",
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


def test_names_and_units_that_may_be_meant_otherwise_are_said(tmp_path):
    path = tmp_path / "a.npy"
    fields = [("x", "u2"), ("y", "u2"), ("t", "f8"), ("p", "u1")]
    np.save(path, np.array([(1, 2, 0.001, 0), (1, 2, 0.0025, 1)], fields))
    assert open_recording(path, (4, 4)).remarks == ("times are floats, and read as seconds",)
    np.save(path, np.zeros(2, [*fields, ("timestamp", "u8")]))
    with pytest.raises(ObservationError, match="t and timestamp"):
        open_recording(path, (4, 4))


def test_a_raw_whose_times_jump_back_is_refused(tmp_path):
    path, words = tmp_path / "a.raw", []
    for high in (10, 12, 5, 13):  # EVT3: TIME_HIGH, TIME_LOW, a row, a column
        words += [0x8000 | high, 0x6005, 0x0003, 0x2804]
    path.write_bytes(b"% evt 3.0\n% end\n" + np.array(words, "<u2").tobytes())
    with pytest.raises(ObservationError, match="jump back"):
        list(open_recording(path, (64, 64)).events())


def test_of_two_recordings_in_a_file_the_other_is_named(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for place in ("CD/events", "events"):
            for name in "xytp":
                file[f"{place}/{name}"] = np.array([1])
    assert open_recording(path, (4, 4)).remarks == ("read is CD/events; events is there too",)
