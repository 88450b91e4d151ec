import numpy as np

from spikedeploy.envs.hexapod.env import (
    BODY,
    COURSE,
    LOAD,
    ObservationEntry,
    layout,
    scaling,
)


def test_names_are_laid_end_to_end():
    assert layout((ObservationEntry("a", 2, 0.0, 1.0), ObservationEntry("b", 3, 0.0, 1.0))) == {
        "a": slice(0, 2),
        "b": slice(2, 5),
    }


def test_the_hexapod_observes_seventy_seven_values():
    assert sum(entry.size for entry in (*BODY, *COURSE, LOAD)) == 77


def test_one_number_scales_a_whole_entry():
    centre, spread = scaling(
        (ObservationEntry("a", 2, 0.5, (2.0, 3.0)), ObservationEntry("b", 1, 0.0, 4.0))
    )
    np.testing.assert_array_equal(centre, [0.5, 0.5, 0.0])
    np.testing.assert_array_equal(spread, [2.0, 3.0, 4.0])
