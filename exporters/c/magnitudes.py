"""How large the numbers of a layer can get, whatever the spikes: which integers of C hold them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters
from spikedeploy.runtime.families.integrate_and_fire.rules import IntegrateAndFireRules

_INT32 = 2**31 - 1
# room for a product with a decay factor, and for one more addition
_INT64 = 2**62


@dataclass(frozen=True)
class Magnitudes:
    """Largest magnitudes of a layer.

    arriving: of any partial sum of the weights, the bias included [units of the sums].
    states: of any number in the update [state units].
    """

    arriving: int
    states: int

    @property
    def kind(self) -> str:
        """The C type that holds all of them."""
        return "int32_t" if max(self.arriving, self.states) <= _INT32 else "int64_t"


def arriving(layer: Layer, most: dict[str, int]) -> int:
    """Largest magnitude of a sum of weights of a timestep, in any order.

    most: spikes of a neuron of each source in a timestep.
    """
    total: NDArray[np.int64] = np.abs(layer.bias.astype(np.int64))
    for synapses in layer.synapses:
        weight = np.abs(synapses.weight.astype(np.int64))
        total = total + weight.sum(axis=0) * most[synapses.source]
    return int(total.max(initial=0))


@dataclass(frozen=True)
class CubaLargest:
    """Largest magnitudes that reach the registers of CuBa-LIF neurons, before they are held.

    drive, current, pushed, membrane: into the accumulator, the current, the push, the membrane.
    """

    drive: int
    current: int
    pushed: int
    membrane: int


def of_cuba(
    layer: Layer, registers: CubaRegisters, weights: int, timesteps: int | None
) -> Magnitudes:
    """Of CuBa-LIF neurons; weights: what `arriving` says; timesteps: T where states are reset."""
    return _of_cuba(layer, registers, weights, timesteps)[0]


def cuba_largest(
    layer: Layer, registers: CubaRegisters, weights: int, timesteps: int | None
) -> CubaLargest:
    """What reaches the registers; parameters as of `of_cuba`."""
    return _of_cuba(layer, registers, weights, timesteps)[1]


def _of_cuba(
    layer: Layer, registers: CubaRegisters, weights: int, timesteps: int | None
) -> tuple[Magnitudes, CubaLargest]:
    one = registers.decay_one
    summed = weights << registers.mantissa_shift
    drive = _held(registers.accumulator, summed, 0, 0)
    keeps = int(layer.current_decay.max(initial=0)), int(layer.membrane_decay.max(initial=0))
    current = _state(layer, registers.current, drive, keeps[0] / one, timesteps)
    unheld = _unheld(drive, keeps[0] / one, current)
    pushed = current + int(np.abs(layer.voltage_bias).max(initial=0))
    push = _held(registers.push, pushed, 0, 0)
    membrane = _state(layer, registers.membrane, push, keeps[1] / one, timesteps)
    threshold = int(layer.threshold.max(initial=0)) if layer.spiking else 0
    states = max(summed, current + drive, pushed, membrane + push, membrane + threshold)
    if max(states, (membrane + current) * one) > _INT64:
        raise _unbounded(layer)
    largest = CubaLargest(summed, unheld, pushed, _unheld(push, keeps[1] / one, membrane))
    return Magnitudes(weights, states), largest


def of_integrate(layer: Layer, rules: IntegrateAndFireRules, weights: int) -> Magnitudes:
    """Of integrate-and-fire neurons; weights: what `arriving` says."""
    weights += int(np.abs(layer.voltage_bias).max(initial=0))
    held = _bound(rules.membrane)
    if held is None:
        raise _unbounded(layer)
    leak = int(layer.membrane_decay.max(initial=0)) if rules.leak != "shift" else 0
    threshold = int(layer.threshold.max(initial=0)) if layer.spiking else 0
    return Magnitudes(weights, max(held, threshold) + weights + leak + threshold)


def _bound(register: Register) -> int | None:
    """Largest magnitude that a register lets pass; None where it lets all pass, or wraps once."""
    if register.between is not None:
        return max(map(abs, register.between))
    half = 1 << (register.bits - 1)
    return None if register.overflow in ("none", "wrap-once") else half


def _held(register: Register, before: int, keeps: float, added: int) -> int:
    """Largest magnitude after a register that gets at most `before`."""
    half = 1 << (register.bits - 1)
    if register.overflow == "wrap-once" and register.between is None and before > half:
        return max(half, before - 2 * half)
    bound = _bound(register)
    return before if bound is None else min(before, bound)


def _state(
    layer: Layer, register: Register, added: int, keeps: float, timesteps: int | None
) -> int:
    """Largest magnitude of a state that keeps this part of itself, and gets `added`."""
    bound, half = _bound(register), 1 << (register.bits - 1)
    if bound is not None:
        return bound
    if register.overflow == "wrap-once" and added <= 2 * half:
        return half
    reached = [added / (1 - keeps)] if keeps < 1 else []
    reached += [float(added) * timesteps] if timesteps is not None else []
    if not reached:
        raise _unbounded(layer)
    return int(min(reached)) + 1


def _unheld(added: int, keeps: float, state: int) -> int:
    """Largest magnitude that a state reaches before its register holds it.

    added: to what is left of it; state: its largest magnitude as held.
    """
    # rounded toward zero, what is left is no more than its part, so that the sum of the geometric
    # series bounds the state even if nothing holds it
    free = int(added / (1 - keeps)) + 1 if keeps < 1 else state + added
    return min(free, state + added)


def _unbounded(layer: Layer) -> ConfigError:
    return ConfigError(
        f"--to c: layer {layer.name!r}: nothing bounds its states to 62 bits, so that integers of "
        "C could overflow. Choose registers that saturate or wrap, or another model of the chip."
    )
