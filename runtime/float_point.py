"""The arithmetic of chips that compute neurons in software: whole weights, states in float32."""

from dataclasses import dataclass

from runtime.errors import ChipError


@dataclass(frozen=True)
class FloatPoint:
    """CuBa-LIF neurons in float32, whose synapses hold small integers.

    weight_bits: of a weight, with the sign; the lowest number is not used.
    """

    weight_bits: int

    def __post_init__(self) -> None:
        if not 2 <= self.weight_bits <= 16:
            raise ChipError(f"weight_bits is {self.weight_bits}; choose 2 to 16.")

    @property
    def weight_max(self) -> int:
        """Largest weight of either sign."""
        return (1 << (self.weight_bits - 1)) - 1

    @property
    def state_bits(self) -> tuple[int, ...]:
        """Width of each state of a neuron [bits]: its current and its membrane."""
        return (32, 32)
