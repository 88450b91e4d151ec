"""Float layers as the numbers of a chip, whatever its arithmetic is."""

from collections.abc import Sequence

from runtime.chip import Chip
from runtime.errors import ConfigError
from runtime.float_point import FloatPoint
from runtime.float_quantize import quantise_floats
from runtime.program import Layer
from runtime.quantisation import Quantisation
from runtime.quantize import quantise
from runtime.step_quantize import quantise_steps
from runtime.step_rules import check_axons


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
    if isinstance(chip.arithmetic, FloatPoint):
        return [quantise_floats(a, chip.arithmetic, rounding or "nearest") for a in layers]
    raise ConfigError(f"chip {chip.name!r} quantises in its own way. Call its own function.")
