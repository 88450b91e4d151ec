"""Chips: a datasheet, the arithmetic that it names, and the layers that it computes.

CHIPS is the table of the chips that networks can be compiled for: name -> the file of the datasheet
in datasheets/. ARITHMETICS are those that a datasheet can name: name -> "module:class".

chip             the datasheet and its limits, the look-up by name or file, options of its fields
arithmetic       the one interface to everything in which the numbers of chips differ
layer            synapses, layers and their states, and when layers start
convolution      synapses of a convolution: one kernel in place of a matrix
quantisation     the choices of how a float network becomes the numbers of a chip
registers        registers, what they do when they overflow, decays, and rounding
damage           what is broken on a chip, and the draws of what goes wrong while it runs
"""

from pathlib import Path

_NAMES = (
    "ideal", "loihi1", "loihi1-brian2", "loihi1-nengo", "loihi2", "xylo-a2", "xylo-a3", "xylo-imu",
    "spinnaker2", "spinnaker2-lif", "speck2f", "truenorth", "odin", "tinyodin", "spiker", "int",
)  # fmt: skip

CHIPS: dict[str, Path] = {
    name: Path(__file__).parent / "datasheets" / f"{name}.toml" for name in _NAMES
}

_CUBA = "spikedeploy.runtime.families.cuba.arithmetic"
_FIRE = "spikedeploy.runtime.families.integrate_and_fire.arithmetic"

ARITHMETICS: dict[str, str] = {
    "cuba-fixed-point": f"{_CUBA}:CubaFixedPoint",
    "cuba-graded-spikes": f"{_CUBA}:CubaGradedSpikes",
    "cuba-free-width": f"{_CUBA}:CubaFreeWidth",
    "cuba-float64": f"{_CUBA}:CubaFloat64",
    "cuba-float32": f"{_CUBA}:CubaFloat32",
    "xylo": "spikedeploy.runtime.families.xylo:XyloArithmetic",
    "integrate-and-fire": f"{_FIRE}:IntegrateAndFire",
}
