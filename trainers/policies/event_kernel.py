"""Neurons that look at their threshold after every event, as loops that Numba compiles.

They compute what `runtime.families.integrate_and_fire.neurons.update` computes with NumPy, for
chains of layers without biases whose spikes reset to 0 (ODIN, tinyODIN), with the same integers:
the interpreter takes a hundred microseconds for each event, too long for training.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.interpreter import LayerTrace, trace
from spikedeploy.runtime.families.cuba.numba_kernels import jit
from spikedeploy.runtime.families.integrate_and_fire.neurons import IntegrateAndFireRules

Integers = NDArray[np.integer[Any]]


def recorded(program: Program, raster: NDArray[np.uint8]) -> Mapping[str, LayerTrace]:
    """What every layer does with the raster (B, T, M) from zero states, as the interpreter has it.

    Where the compiled loops compute it, overflows and activity are left out.
    """
    return (
        _by_events(program, raster) if _COMPILED and _computes(program) else trace(program, raster)
    )


def _computes(program: Program) -> bool:
    """Whether the loops compute the program: a chain of layers, event by event, reset to 0."""
    rules, convention = program.chip.arithmetic, program.convention
    if not isinstance(rules, IntegrateAndFireRules) or rules.queue == "on":
        return False
    ways = rules.checks, rules.leak, rules.leak_order, rules.reset_at, rules.fires
    return (
        ways == ("event", "linear", "first", "spike", "reached")
        and convention.reset == "zero"
        and convention.floor in ("none", "zero")
        and all(map(_is_plain, program.layers))
        and not any(lag for lags in program.lags for lag in lags)
    )


def _is_plain(layer: Layer) -> bool:
    """Whether a layer has one source, no bias, and a reset to 0."""
    biased = layer.bias.any() or layer.voltage_bias.any()
    return layer.spiking and len(layer.synapses) == 1 and not biased and not np.any(layer.v_reset)


def _by_events(program: Program, raster: NDArray[np.uint8]) -> dict[str, LayerTrace]:
    rules = program.chip.arithmetic
    assert isinstance(rules, IntegrateAndFireRules)
    low, high = rules.membrane.fit(np.array([-(1 << 40), 1 << 40])).tolist()
    if program.convention.floor == "zero":
        low = 0
    low = low if rules.floor is None else max(low, rules.floor)
    spikes: dict[str, Integers] = {program.input: raster}
    found: dict[str, LayerTrace] = {}
    for layer in program.layers:
        (synapses,) = layer.synapses
        counts = np.ascontiguousarray(spikes[synapses.source], np.int64)
        membrane = np.zeros((*counts.shape[:2], layer.size), np.int64)
        fired = np.zeros_like(membrane)
        weight = np.ascontiguousarray(synapses.weight, np.int64)
        held = np.array([low, high, rules.spikes_max], np.int64)
        each = np.stack([layer.threshold, layer.membrane_decay]).astype(np.int64)
        _integrate_events(counts, weight, each, held, membrane, fired)
        spikes[layer.name] = fired
        none = np.zeros_like(membrane)
        found[layer.name] = LayerTrace(none, membrane, fired, none.astype(np.bool_), none)
    return found


@jit
def _integrate_events(
    counts: Integers,
    weight: Integers,
    each: Integers,
    held: Integers,
    membrane: Integers,
    spikes: Integers,
) -> None:
    """Write membranes and spikes (B, T, N) for counts of events (B, T, M).

    each: (2, N) thresholds, and what a time reference takes away
    held: least and largest membrane, most spikes of a timestep
    """
    neurons = weight.shape[1]
    for b in range(counts.shape[0]):
        for t in range(counts.shape[1]):
            v, s = membrane[b, t], spikes[b, t]
            for n in range(neurons):
                x = membrane[b, t - 1, n] if t else 0
                # V = V - sign(V) min(|V|, leak), an event as well
                taken = min(abs(x), each[1, n])
                x = x - taken if x > 0 else x + taken
                if x >= each[0, n]:
                    s[n] += 1
                    x = 0
                v[n] = x
            for m in range(counts.shape[2]):
                for _ in range(counts[b, t, m]):
                    for n in range(neurons):
                        x = min(max(v[n] + weight[m, n], held[0]), held[1])
                        if x >= each[0, n]:
                            s[n] = min(s[n] + 1, held[2])
                            x = 0
                        v[n] = x


_COMPILED = hasattr(_integrate_events, "py_func")  # without Numba, the loops stay Python
