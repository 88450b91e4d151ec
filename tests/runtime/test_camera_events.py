"""The file that recordings of events are written to."""

import h5py
import numpy as np
import pytest

from spikedeploy.runtime.camera_events import EVENT, write_events
from spikedeploy.runtime.errors import ConfigError

SIZE = (6, 8)


def events(*rows):
    return np.array(list(rows), EVENT)


def test_a_recording_is_four_columns_and_the_size_of_the_camera(tmp_path):
    path = tmp_path / "a.h5"
    with write_events(path, SIZE) as writer:
        writer.write(events((7, 5, 0, 1), (0, 0, 3, 0)))
        assert not path.exists()  # until all of it is there
        writer.write(events())
        writer.write(events((1, 2, 3, 1)))
    with h5py.File(path) as file:
        found = {name: file["events"][name][:].tolist() for name in file["events"]}
        assert dict(file["events"].attrs) == {"height": 6, "width": 8}
    assert found == {"x": [7, 0, 1], "y": [5, 0, 2], "t": [0, 3, 3], "p": [1, 0, 1]}


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ((8, 0, 9, 1), "x = 8"),
        ((0, 6, 9, 1), "y = 6"),
        ((0, 0, 4, 1), "the one ahead was at 5 us"),
        ((0, 0, -1, 1), "t = -1 us"),
    ],
)
def test_an_event_that_the_camera_cannot_have_sent_leaves_no_file(tmp_path, wrong, said):
    def record():
        with write_events(tmp_path / "a.h5", SIZE) as writer:
            writer.write(events((0, 0, 5, 1)))
            writer.write(events(wrong))

    with pytest.raises(ConfigError, match=said):
        record()
    assert not list(tmp_path.iterdir())


def test_a_camera_without_pixels_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="0x8"), write_events(tmp_path / "a.h5", (0, 8)):
        pass


def test_a_recording_replaces_one_of_its_own_and_nothing_else(tmp_path):
    mine, foreign, text = (tmp_path / name for name in ("mine.h5", "foreign.h5", "notes.h5"))
    for _ in range(2):
        with write_events(mine, SIZE) as writer:
            writer.write(np.zeros(1, EVENT))
    with h5py.File(foreign, "w") as file:
        file.create_group("events").attrs["height"] = SIZE[0]
        file.attrs["by"] = np.arange(3)
    text.write_text("what nobody has twice")
    broken = tmp_path / "broken.h5"
    broken.write_bytes(mine.read_bytes()[:-100])
    for path in (foreign, text, broken, tmp_path):
        with pytest.raises(ConfigError, match="exists"), write_events(path, SIZE):
            pass
    assert text.read_text() == "what nobody has twice"
    with h5py.File(foreign) as file:
        assert list(file["events"]) == []


def test_what_appears_while_a_recording_is_made_stays(tmp_path):
    path = tmp_path / "a.h5"
    with pytest.raises(ConfigError, match="exists"), write_events(path, SIZE):
        path.write_text("somebody else's")
    assert path.read_text() == "somebody else's"
    (kept,) = set(tmp_path.iterdir()) - {path}
    with h5py.File(kept) as file:
        assert list(file["events"]) == sorted("ptxy")
