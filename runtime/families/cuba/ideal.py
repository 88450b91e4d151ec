"""No chip at all: the compiled path in float64, to tell compiling from rounding."""

from spikedeploy.runtime.chips.chip import Chip

IDEAL = Chip(
    name="ideal",
    summary="float64 through the compiled path: no rounding, no limits",
    arithmetic=None,
    resets=("zero", "subtract"),
    delay=0,
    delay_max=4096,
    energy_tables=(),
    sources={
        "arithmetic": "by definition",
        "resets": "by definition: both that a convention can name",
        "delay": "by definition: the convention decides",
        "delay_max": "by choice: so many timesteps of spikes fit any memory",
    },
    evidence="equal to the float graph in every spike",
)
