"""README's moving picture in its smallest size."""

import numpy as np
import pytest
from PIL import Image

from lab import film


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(film, "_SECONDS", 0.3)


def test_policies_stand_side_by_side_frame_by_frame(short, tmp_path):
    path = tmp_path / "film.webp"
    size = film.write(["kart-steer/sparse@kart-steer"] * 2, path)
    assert size == path.stat().st_size
    with Image.open(path) as found:
        assert found.n_frames > 1
        assert found.width == 2 * film._WIDTH + 6


def test_spikes_pass_to_the_left_and_have_the_colour_of_their_kind():
    spikes = np.zeros((4, 3), bool)
    spikes[-1] = [True, False, True]  # an event and a hidden spike, just now
    step = film.FilmedStep(np.zeros((90, 120, 3), np.uint8), spikes, 2, 7.0, "robot")
    drawn = np.asarray(film.draw(step, 0.1))[film._HEIGHT + 22 :, -8:]
    colours = {tuple(each) for each in drawn.reshape(-1, 3).tolist()}
    assert {film._EVENTS, film._HIDDEN} <= colours
    older = film.FilmedStep(
        step.frame, np.vstack([spikes, np.zeros((10, 3), bool)]), 2, 7.0, "robot"
    )
    drawn = np.asarray(film.draw(older, 0.1))[film._HEIGHT + 22 :, -8:]
    assert film._EVENTS not in {tuple(each) for each in drawn.reshape(-1, 3).tolist()}


def test_a_row_of_many_neurons_is_as_bright_as_many_of_them_spike():
    spikes = np.zeros((2, 10), bool)
    spikes[0, :3] = True
    np.testing.assert_allclose(film.shares(spikes, 2), [[0.6, 0.0], [0.0, 0.0]])
    # a neuron may lie in several rows, and a row may begin within one
    np.testing.assert_allclose(film.shares(spikes[:1, :4], 8), [[1.0] * 6 + [0.0] * 2])
    np.testing.assert_allclose(film.shares(spikes[:1], 4), [[1.0, 0.2, 0.0, 0.0]])


@pytest.mark.parametrize(("inputs", "period"), [(3, 0.1), (2, 0.1), (2, 0.001)])
def test_a_policy_without_hidden_neurons_or_with_short_control_steps_is_drawn(inputs, period):
    step = film.FilmedStep(
        np.zeros((90, 120, 3), np.uint8), np.ones((1, 3), bool), inputs, 7.0, "robot"
    )
    assert np.asarray(film.draw(step, period))[film._HEIGHT + 24 :, -1].any()
