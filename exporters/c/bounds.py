"""Magnitudes of the numbers of a program, whatever the spikes: no integer of C overflows."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters
from spikedeploy.runtime.families.integrate_and_fire.neurons import IntegrateAndFireRules

_INT32 = 2**31 - 1
# room for a product with a decay factor, and for one more addition
_INT64 = 2**62


@dataclass(frozen=True)
class Magnitudes:
    """Largest magnitudes of a layer, whatever the spikes.

    arriving: of any partial sum of the weights, the bias included [units of the sums].
    states: of any number in the update [state units].
    registers: of what reaches each register of CuBa-LIF neurons before it is held, by its name
        [state units]; empty for other neurons.
    held: of what each register passes on, likewise.
    """

    arriving: int
    states: int
    registers: Mapping[str, int]
    held: Mapping[str, int]

    @property
    def kind(self) -> str:
        """The C type that holds all of them."""
        return "int32_t" if max(self.arriving, self.states) <= _INT32 else "int64_t"


def bound(
    layer: Layer,
    rules: CubaRegisters | IntegrateAndFireRules,
    times_max: Mapping[str, int],
    timesteps: int | None,
) -> Magnitudes:
    """Magnitudes of a layer.

    times_max: spikes of a neuron of each source in a timestep.
    timesteps: T where states are reset after each inference; None where they are kept.
    """
    weights = int(layer.most_arriving(times_max).max(initial=0))
    if isinstance(rules, CubaRegisters):
        return _bound_cuba(layer, rules, weights, timesteps)
    return _bound_integrate(layer, rules, weights)


def _bound_cuba(
    layer: Layer, registers: CubaRegisters, weights: int, timesteps: int | None
) -> Magnitudes:
    one = registers.decay_one
    summed = weights << registers.mantissa_shift
    drive = _hold(registers.accumulator, summed)
    keeps = int(layer.current_decay.max(initial=0)), int(layer.membrane_decay.max(initial=0))
    current = _bound_state(layer, registers.current, drive, keeps[0] / one, timesteps)
    pushed = current + int(np.abs(layer.voltage_bias).max(initial=0))
    push = _hold(registers.push, pushed)
    membrane = _bound_state(layer, registers.membrane, push, keeps[1] / one, timesteps)
    threshold = int(layer.threshold.max(initial=0)) if layer.spiking else 0
    states = max(summed, current + drive, pushed, membrane + push, membrane + threshold)
    if max(states, (membrane + current) * one) > _INT64:
        raise _unbounded(layer)
    reached = {
        "accumulator": summed,
        "current": _bound_before(drive, keeps[0] / one, current),
        "push": pushed,
        "membrane": _bound_before(push, keeps[1] / one, membrane),
    }
    passed = {"accumulator": drive, "current": current, "push": push, "membrane": membrane}
    held = {name: min(reached[name], most) for name, most in passed.items()}
    return Magnitudes(weights, states, reached, held)


def _bound_integrate(layer: Layer, rules: IntegrateAndFireRules, weights: int) -> Magnitudes:
    weights += int(np.abs(layer.voltage_bias).max(initial=0))
    held = _bound(rules.membrane)
    if held is None:
        raise _unbounded(layer)
    leak = int(layer.membrane_decay.max(initial=0)) if rules.leak != "shift" else 0
    threshold = int(layer.threshold.max(initial=0)) if layer.spiking else 0
    return Magnitudes(weights, max(held, threshold) + weights + leak + threshold, {}, {})


def _bound(register: Register) -> int | None:
    """Largest magnitude that a register lets pass; None where it lets all pass, or wraps once."""
    if register.between is not None:
        return max(map(abs, register.between))
    half = 1 << (register.bits - 1)
    if register.overflow in ("none", "wrap-once"):
        return None
    return half - (register.overflow == "clip")


def _hold(register: Register, before: int) -> int:
    """Largest magnitude after a register that gets at most `before`."""
    half = 1 << (register.bits - 1)
    if register.overflow == "wrap-once" and register.between is None and before > half:
        return max(half, before - 2 * half)
    bound = _bound(register)
    return before if bound is None else min(before, bound)


def _bound_state(
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


def _bound_before(added: int, keeps: float, state: int) -> int:
    """Largest magnitude that a state reaches before its register holds it.

    added: to what is left of it; state: its largest magnitude as held.
    """
    # rounded toward zero, what is left is no more than its part, so that the sum of the geometric
    # series bounds the state even if nothing holds it
    free = int(added / (1 - keeps)) + 1 if keeps < 1 else state + added
    return min(free, state + added)


def _unbounded(layer: Layer) -> ConfigError:
    return ConfigError(
        f"layer {layer.name!r}: nothing bounds its states to 62 bits, so that integers could "
        "overflow. Choose registers that saturate or wrap, or another model of the chip."
    )
