"""Float layers as the numbers of a chip, whatever its arithmetic is."""

from collections.abc import Sequence

from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.compiler.program import Layer
from spikedeploy.runtime.compiler.quantisation import Quantisation
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.float32 import quantise_floats
from spikedeploy.runtime.families.cuba.quantise import quantise
from spikedeploy.runtime.families.cuba.spinnaker2 import CubaFloat32
from spikedeploy.runtime.families.integrate_and_fire.quantise import check_axons, quantise_steps


def quantised(
    layers: Sequence[Layer], chip: Chip, quantisation: Quantisation, limits: bool
) -> Sequence[Layer]:
    """The float layers as the chip's numbers.

    limits: False leaves out the rules that are about room and not about the arithmetic.
    """
    if chip.arithmetic is None:  # there is nothing to round
        return layers
    if chip.fixed is not None:
        return [quantise(layer, chip.fixed, quantisation) for layer in layers]
    quantisation.only(chip.name, "rounding")
    rounding = quantisation.rounding
    if chip.steps is not None:
        whole = [quantise_steps(a, chip, chip.steps, rounding, limits) for a in layers]
        if limits:
            check_axons(whole, chip, chip.steps)
        return whole
    if isinstance(chip.arithmetic, CubaFloat32):
        return [quantise_floats(a, chip.arithmetic, rounding or "nearest") for a in layers]
    raise ConfigError(f"chip {chip.name!r} quantises in its own way. Call its own function.")
