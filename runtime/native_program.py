"""A program as the arrays that the compiled kernels take."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime import native_kernels as kernels
from runtime.bounds import bounds, room
from runtime.chip import FixedPoint
from runtime.errors import ConfigError
from runtime.fixed import Register
from runtime.native_kernels import Constants
from runtime.program import Layer, Program
from runtime.scratch import as_aligned
from runtime.synapses import EXACT_INT16

Integers = NDArray[np.int64]

EXACT_INT8 = (1 << 7) - 1
EXACT_INT32 = (1 << 31) - 1
# bits of every whole number that float64 holds
EXACT_BITS = 53

OVERFLOWS = {
    "none": kernels.NONE,
    "wrap": kernels.WRAP,
    "wrap-once": kernels.WRAP_ONCE,
    "clip": kernels.CLIP,
}


@lru_cache(maxsize=8)
def constants(program: Program, late: tuple[tuple[int, ...], ...]) -> Constants:
    """All that does not change while the program runs; shared by its machines.

    late: rows by which each synapse of each layer delivers late.
    """
    fixed = program.chip.fixed
    if fixed is None:
        raise ConfigError(f"chip {program.chip.name!r} has no integers. Choose backend='numpy'.")
    return Constants(
        weights=_weights(program),
        fan_out=np.concatenate([s.fan_out for a in program.layers for s in a.synapses]),
        wires=_wires(program, late),
        layers=_layers(program, fixed),
        sources=_sources(program, late),
        chip=_chip(program, fixed),
        registers=_registers(fixed),
        whole=_whole(program),
        real=_real(program, fixed),
        rooms=np.array([_rooms(fixed)] * len(program.layers)),
    )


def _weights(program: Program) -> NDArray[Any]:
    """(W,) in the smallest integers that hold them."""
    weights = [s.weight.ravel() for layer in program.layers for s in layer.synapses]
    all_ = np.concatenate([*weights, *(layer.bias for layer in program.layers)])
    largest = int(np.abs(all_.astype(np.int64)).max(initial=0))
    return as_aligned(all_, np.int8 if largest <= EXACT_INT8 else _whole_type(largest))


def _whole_type(largest: int) -> Any:  # noqa: ANN401
    return np.int16 if largest <= EXACT_INT16 else np.int32 if largest <= EXACT_INT32 else np.int64


def _wires(program: Program, late: tuple[tuple[int, ...], ...]) -> Integers:
    index = {name: k for k, name in enumerate(program.sizes)}
    rows, weights, axons = [], 0, 0
    for layer, lags in zip(program.layers, late, strict=True):
        for synapses, lag in zip(layer.synapses, lags, strict=True):
            rows.append((index[synapses.source], lag, weights, axons))
            weights += synapses.weight.size
            axons += len(synapses.weight)
    return np.array(rows, np.int64)


def _layers(program: Program, fixed: FixedPoint) -> Integers:
    rows, neurons, wires = [], 0, 0
    biases = sum(s.weight.size for layer in program.layers for s in layer.synapses)
    for layer in program.layers:
        limits = bounds(program, layer, fixed, None)
        careful = fixed.refractory > 1 or _too_much(layer, fixed, limits.drive)
        bits = 8 * np.dtype(_whole_type(limits.partial)).itemsize
        end = wires + len(layer.synapses)
        output = layer.name in program.to_host
        forgets = not layer.current_keep.any()
        proven = max(limits.current, limits.above, limits.below) <= min(_rooms(fixed)[1:])
        about = (layer.start, biases + neurons, layer.bias_fan_out, output, forgets, proven)
        rows.append((layer.size, neurons, 0, wires, end, bits, careful, *about))
        neurons, wires = neurons + layer.size, end
    return np.array(rows, np.int64)


def _too_much(layer: Layer, fixed: FixedPoint, drive: float) -> bool:
    """Whether what is added in a tick could overflow the accumulator, or hide an inexact decay.

    Where it cannot, a sum that float64 may hold was made from a decay that it computed exactly.
    """
    bias = float(np.abs(layer.voltage_bias.astype(np.int64)).max(initial=0))
    return drive > room(fixed.accumulator) or max(drive, bias) > _exact(fixed)


def _sources(program: Program, late: tuple[tuple[int, ...], ...]) -> Integers:
    """Without places in memory, which depend on the timesteps."""
    remembered = dict.fromkeys(program.sizes, 0)
    for layer, lags in zip(program.layers, late, strict=True):
        for synapses, lag in zip(layer.synapses, lags, strict=True):
            remembered[synapses.source] = max(remembered[synapses.source], lag)
    lag = program.readout.lag if program.readout else 0
    remembered[program.output] = max(remembered[program.output], lag)
    return np.array([(n, remembered[name], 0, 0) for name, n in program.sizes.items()], np.int64)


def _chip(program: Program, fixed: FixedPoint) -> Integers:
    subtract = program.convention.reset == "subtract"
    return np.array([fixed.mantissa_shift, fixed.decay_bits, fixed.refractory, subtract], np.int64)


def _registers(fixed: FixedPoint) -> Integers:
    all_ = (fixed.accumulator, fixed.current, fixed.membrane)
    return np.array([(OVERFLOWS[r.overflow], r.bits) for r in all_], np.int64)


def _whole(program: Program) -> Integers:
    def order(layer: Layer) -> list[NDArray[Any]]:
        return [layer.current_keep, layer.membrane_keep, layer.threshold, layer.voltage_bias]

    return np.concatenate([np.stack(order(a)) for a in program.layers], axis=1).astype(np.int64)


def _real(program: Program, fixed: FixedPoint) -> NDArray[np.floating]:
    """(4, N) in float32 if that holds them: a layer of 512 neurons then fits the nearest cache."""
    real: NDArray[np.float64] = _whole(program) * np.array(
        [[1 / fixed.decay_one]] * 2 + [[1.0]] * 2
    )
    single = as_aligned(real, np.float32)
    return single if (single == real).all() else as_aligned(real, np.float64)


def _rooms(fixed: FixedPoint) -> tuple[float, float, float]:
    """State units per weight unit, and what float64 may hold of a current and of a membrane."""

    def held(register: Register) -> float:
        return float(min(room(register), _exact(fixed)))

    return float(1 << fixed.mantissa_shift), held(fixed.current), held(fixed.membrane)


def _exact(fixed: FixedPoint) -> int:
    """Largest magnitude of three that are added, so that float64 decays their sum exactly."""
    return 1 << (EXACT_BITS - 2 - fixed.decay_bits)
