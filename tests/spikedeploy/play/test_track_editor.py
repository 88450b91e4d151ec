"""Drawing tracks: what clicks and keys make of a draft, its files, and its window."""

import json

import numpy as np
import pygame
import pytest

from spikedeploy.envs.kart.track import load
from spikedeploy.play import window
from spikedeploy.play.draft import (
    History,
    TrackDraft,
    as_text,
    draft_of,
    open_draft,
    save,
    save_draft,
)
from spikedeploy.play.draw import TrackEditor
from spikedeploy.play.theme import HEIGHT
from spikedeploy.runtime.errors import ConfigError, EnvError
from tests.windows import play, press

BOX = ((0.0, 0.0), (400.0, 0.0), (400.0, 100.0), (0.0, 100.0), (0.0, 0.0))
GATES = (((200.0, 0.0), (200.0, 100.0)), ((380.0, 0.0), (380.0, 100.0)))
LANE = TrackDraft("lane", (BOX,), GATES, start=(60.0, 50.0))


def drawn(*points, draft=None):
    draft = draft or TrackDraft("a")
    for point in points:
        draft = draft.with_point(point)
    return draft


# the draft


def test_two_points_are_a_gate_and_the_next_begins_another():
    draft = drawn((0, 0), (0, 9), (5, 0), draft=TrackDraft("a").new_gate())
    assert draft.gates == (((0, 0), (0, 9)), ((5, 0),))
    assert draft.with_point((5, 9)).open_line == ()


def test_the_ends_of_gates_mean_the_wall_nearby():
    draft = drawn((10.0, 10.0), (90.0, 10.0)).new_gate()
    assert draft.snap((50.4, 12.3), 5.0) == (50.0, 10.0)
    assert draft.snap((50.4, 20.0), 5.0) == (50.0, 20.0)


def test_a_removed_point_takes_lines_of_no_length_with_it():
    draft = drawn((0, 0), (9, 0)).new_wall().without((9, 0))
    assert draft.walls == ((),)
    assert LANE.without((200.0, 0.0)).gates == GATES[1:]
    assert LANE.without((380.0, 0.0)).open_line == BOX
    assert LANE.without((380.0, 0.0)).new_gate().open_line == ((380.0, 100.0),)
    assert LANE.without((60.0, 50.0)).start is None


def test_undo_goes_back_to_the_beginning_past_choices_and_redo_to_the_end():
    history = History(TrackDraft("a"))
    for number in range(50):
        history = history.record(history.now.with_point((number, 0)))
    end = history.now
    history = history.replace_now(history.now.new_gate())
    for _ in range(60):
        history = history.undo()
    assert history.now == TrackDraft("a")
    for _ in range(60):
        history = history.redo()
    assert history.now.walls == end.walls


# files


def test_a_sketch_that_the_validator_agrees_to_is_a_track(tmp_path):
    save_draft(LANE, tmp_path / "lane.json")
    save(LANE, tmp_path / "lane.json")
    track = load(tmp_path / "lane.json")
    np.testing.assert_array_equal(track.polylines[0], BOX)
    np.testing.assert_array_equal(track.gates, GATES)
    assert (track.name, track.heading, track.start.tolist()) == ("lane", (-0.3, 0.3), [60, 50])
    assert [path.name for path in tmp_path.iterdir()] == ["lane.json"]


@pytest.mark.parametrize(
    ("draft", "line"),
    [
        (TrackDraft("a"), "there is no start; S places it"),
        (LANE.without((0.0, 0.0)), "the walls are open"),
        (LANE.new_gate().with_point((60.0, 0.0)), "gate 3: 1 point; a line needs two"),
        (LANE.with_start((5.0, 50.0)), "can start 5.0 px from a wall"),
    ],
)
def test_what_is_no_track_is_refused_with_the_validators_words(draft, line, tmp_path):
    with pytest.raises(EnvError, match=line):
        save(draft, tmp_path / "a.json")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["big_S", "small_S", "room_1", "circuit"])
def test_a_shipped_track_is_copied_and_written_as_it_is(name, tmp_path):
    path = tmp_path / f"{name}.json"
    save(open_draft(path, name), path)
    copied, shipped = load(path), load(name)
    for field in ("walls", "gates", "start"):
        np.testing.assert_array_equal(getattr(copied, field), getattr(shipped, field))
    for field in ("name", "spread", "heading", "sway"):
        assert getattr(copied, field) == getattr(shipped, field)
    assert as_text(open_draft(path)) == path.read_text()


@pytest.mark.parametrize("draft", [
    TrackDraft("a"), drawn((1.5, 2)), drawn((1, 2), draft=LANE.new_gate()), LANE.with_turn(1.0),
])  # fmt: skip
def test_a_draft_loses_nothing(draft, tmp_path):
    save_draft(draft, tmp_path / "a.json")
    assert as_text(open_draft(tmp_path / "a.json")) == as_text(draft)


HUGE = as_text(TrackDraft("a", (((0.0, 0.0), (7.0, 7.0)), ()))).replace("7", "7" * 400)


@pytest.mark.parametrize(
    ("name", "opened", "text", "line"),
    [
        ("a.txt", "a.txt", "", r"ends in \.json"),
        ("a.draft.json", "a.draft.json", "{}", r"its \.draft\.json opens itself"),
        ("a.json", "a.json", "nonsense", "not a JSON file"),
        ("a.json", "a.json", "{}", "'name' is missing"),
        ("a.draft.json", "a.json", '{"walls": [[[1]]]}', r"not a draft that `draw` left"),
        ("a.draft.json", "a.json", HUGE, r"not a draft that `draw` left"),
    ],
)
def test_files_that_cannot_be_drawn_in_are_named(name, opened, text, line, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises((ConfigError, EnvError), match=line):
        open_draft(tmp_path / opened)


def test_a_copy_overwrites_nothing(tmp_path):
    save(LANE, tmp_path / "lane.json")
    with pytest.raises(ConfigError, match=r"--copy big_S: .*lane\.json exists"):
        open_draft(tmp_path / "lane.json", "big_S")


# the window


def move(app, place):
    pos = tuple(app._view.at(place).tolist())
    return pygame.Event(pygame.MOUSEMOTION, pos=pos, rel=(0, 0), buttons=(0, 0, 0))


def click(app, place, button=1):
    pos = tuple(app._view.at(place).tolist())
    return pygame.Event(pygame.MOUSEBUTTONDOWN, pos=pos, button=button)


def lane(app):
    """Every event that draws LANE."""
    corners = [click(app, place) for place in BOX[:4]]
    closing = [click(app, (3.0, 2.0))]  # snaps to the first point
    gates = [click(app, (x, y + 2)) for (x, y) in (p for gate in GATES for p in gate)]
    start = [move(app, (60.0, 50.0)), press("s")]
    return [*corners, *closing, press("g"), *gates, *start]


def test_a_track_is_drawn_with_mouse_and_keys_and_saved(tmp_path):
    app = TrackEditor(tmp_path / "lane.json")
    play(app, *lane(app), press("RETURN"))
    assert app.message[1] == "lane.json is saved: a kart can drive it."
    assert app.close() is None
    start = tuple(round(each) for each in app._view.at((60.0, 50.0)))
    assert app.draw().get_at(start) != app.draw().get_at((5, 5))  # a kart stands there
    track = load(tmp_path / "lane.json")
    np.testing.assert_array_equal(track.polylines[0], BOX)
    np.testing.assert_array_equal(track.gates, GATES)
    assert track.start.tolist() == [60, 50]


def test_what_the_validator_refuses_is_shown_and_kept_as_a_draft(tmp_path):
    app = TrackEditor(tmp_path / "a.json")
    before = pygame.surfarray.array3d(app.draw())[HEIGHT:]
    play(app, click(app, (100, 100)), press("RETURN"))
    assert "there is no start" in app.message[1]
    assert "Kept as a.draft.json" in app.message[1]
    red = (pygame.surfarray.array3d(app.draw())[HEIGHT:] == app.message[0]).all(axis=2)
    assert red.sum() > 50 > (before == app.message[0]).all(axis=2).sum()
    assert [path.name for path in tmp_path.iterdir()] == ["a.draft.json"]


def test_leaving_keeps_changes_as_a_draft_that_the_next_window_goes_on_with(tmp_path):
    app = TrackEditor(tmp_path / "a.json")
    play(app, click(app, (100, 100)), press("z"))
    assert app.close() is None
    assert not list(tmp_path.iterdir())
    play(app, click(app, (100, 100)), click(app, (300, 100)))
    assert app.close() == tmp_path / "a.draft.json"
    again = TrackEditor(tmp_path / "a.json")
    assert again.draft.walls[0] == ((100, 100), (300, 100))
    assert "a.draft.json was left" in again.message[1]


def test_points_are_moved_and_removed_and_the_start_turned(tmp_path):
    app = TrackEditor(tmp_path / "lane.json")
    corner = move(app, (401, 99))
    play(app, *lane(app), corner, press("m"), click(app, (450, 120)))
    assert app.draft.walls[0][2] == (450, 120)
    app.handle(press("z"))
    assert app.draft.walls[0][2] == (400, 100)
    play(app, click(app, (401, 99), button=3))
    assert (400, 100) not in app.draft.points
    play(app, move(app, (396, 96)), press("s"), press("e"), press("e"), press("q"))
    assert app.draft.start == (396, 96)
    assert app.draft.heading == pytest.approx((-0.3 + np.pi / 12, 0.3 + np.pi / 12), abs=1e-3)


def test_the_wheel_zooms_and_clicks_still_mean_what_is_under_them(tmp_path):
    app = TrackEditor(tmp_path / "a.json")
    play(app, move(app, (500, 500)), pygame.Event(pygame.MOUSEWHEEL, x=0, y=4))
    assert app._view.scale == pytest.approx(0.8 * 1.15**4)
    play(app, click(app, (550, 450)))
    assert app.draft.points == ((550, 450),)


def test_in_a_window_of_another_size_clicks_mean_the_same_places():
    pygame.display.init()
    pygame.display.set_mode((600, 800))
    event = window._on_frame(pygame.Event(pygame.MOUSEMOTION, pos=(300, 400)), (1200, 800))
    assert event.pos == (600, 400)  # drawn at half its size, 200 px from the top
    event = window._on_frame(pygame.Event(pygame.MOUSEMOTION, pos=(0, 200)), (1200, 800))
    assert event.pos == (0, 0)


def test_a_folder_that_nothing_can_be_written_to_is_said_in_the_window(tmp_path):
    (tmp_path / "file").write_text("")
    app = TrackEditor(tmp_path / "file/a.json")
    app.point(pygame.Event(pygame.MOUSEBUTTONDOWN, pos=(HEIGHT + 50, 100), button=1))
    assert app.draft.points == ()  # it was on the panel
    app.handle(press("RETURN"))
    assert "nothing was saved" in app.message[1]


def test_the_command_says_what_it_kept(command, monkeypatch, tmp_path):
    path = tmp_path / "a.json"
    monkeypatch.setattr(window, "show", lambda app: app.point(click(app, (100, 100))))
    code, out, err = command("draw", path)
    assert (code, err) == (0, "")
    assert out == f"kept {draft_of(path)}; `spikedeploy draw {path}` goes on with it\n"
    draft_of(path).unlink()
    monkeypatch.setattr(window, "show", lambda app: app.handle(press("RETURN")))
    _, out, _ = command("draw", path, "--copy", "small_S", "--json")
    assert json.loads(out) == {"track": str(path), "draft": None}


def test_a_window_that_breaks_loses_nothing(command, monkeypatch, tmp_path):
    def show(app):
        app.point(click(app, (100, 100)))
        raise ConfigError("gone")

    monkeypatch.setattr(window, "show", show)
    assert command("draw", tmp_path / "a.json")[0] == 2
    assert draft_of(tmp_path / "a.json").is_file()
