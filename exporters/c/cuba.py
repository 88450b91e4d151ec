"""One timestep of CuBa-LIF neurons in C, as runtime.families.cuba.neurons has it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, literal
from spikedeploy.exporters.c.magnitudes import CubaLargest
from spikedeploy.exporters.c.registers import decay, fit, held
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters

_REGISTERS = ("accumulator", "current", "push", "membrane")


@dataclass(frozen=True)
class CubaWriter:
    """Writes the functions of CuBa-LIF layers.

    program: whose layers they are.
    registers: of its chip.
    kind: C type of all numbers.
    largest: magnitude of a state.
    """

    program: Program
    registers: CubaRegisters
    kind: str
    largest: int
    used: set[str] = field(default_factory=set)  # registers that numbers can reach

    has_current = True

    def shared(self) -> str:
        """Functions that the layers written before use."""
        used = [name for name in _REGISTERS if name in self.used]
        fits = [fit(name, getattr(self.registers, name), self.kind) for name in used]
        decays = [
            factor
            for layer in self.program.layers
            for factor in (layer.current_decay, layer.membrane_decay)
            if self._mixed(factor)
        ]
        whole = any(int(factor.max()) >= self.registers.decay_one for factor in decays)
        rest = [decay(self.kind, self.registers.decay_bits, whole, self.largest)] if decays else []
        return "\n".join([*filter(None, fits), *rest])

    def variables(self, layer: Layer, name: str, out: Declarations) -> None:
        """Declare the states of a layer."""
        out.variable(f"{name}_current", "@prefix@_int_t", layer.size)
        out.variable(f"{name}_membrane", "@prefix@_int_t", layer.size)
        if self._refractory(layer):
            out.variable(f"{name}_refractory", "uint32_t", layer.size)

    def states(self, layer: Layer, name: str) -> list[str]:
        """The states that a reset sets to 0, for each neuron n."""
        late = [f"{name}_refractory"] if self._refractory(layer) else []
        return [f"{name}_current", f"{name}_membrane", *late]

    def update(
        self, layer: Layer, name: str, unit: int, largest: CubaLargest, out: Declarations
    ) -> str:
        """The body of a timestep, after the weights have been summed in `sums`.

        unit: by which the sums have to be multiplied.
        largest: magnitudes that reach the registers.
        """
        shift = unit << self.registers.mantissa_shift
        drive = f"sums[n] * {literal(shift, self.kind)}" if shift > 1 else "sums[n]"
        current, membrane = f"{name}_current[n]", f"{name}_membrane[n]"
        bias = layer.voltage_bias
        pushed = current
        if bias.any():
            pushed += f" + {out.per_neuron(f'{name}_bias_v', bias, 'n', self.kind)}"
        kept = self._kept(f"{name}_keep_i", current, layer.current_decay, out)
        left = self._kept(f"{name}_keep_v", membrane, layer.membrane_decay, out)
        drive = self._held("accumulator", drive, largest.drive)
        pushed = self._held("push", pushed, largest.pushed)
        lines = [
            f"for (n = 0u; n < {layer.size}u; n++) {{",
            f"    {current} = {self._held('current', f'{kept}{drive}', largest.current)};",
            f"    {membrane} = {self._held('membrane', f'{left}{pushed}', largest.membrane)};",
            *(f"    {line}" for line in (self._fire(layer, name, out) if layer.spiking else [])),
            "}",
        ]
        return "\n".join(lines)

    def _held(self, name: str, expression: str, largest: int) -> str:
        """The expression as a register holds it, which changes nothing up to its magnitude."""
        register: Register = getattr(self.registers, name)
        if register.between is None and largest < 1 << (register.bits - 1):
            return f"({expression})"
        self.used.add(name)
        return held(name, register, expression)

    def _fire(self, layer: Layer, name: str, out: Declarations) -> list[str]:
        threshold = out.per_neuron(f"{name}_threshold", layer.threshold, "n", self.kind)
        membrane = f"{name}_membrane[n]"
        subtract = self.program.convention.reset == "subtract"
        after = f"{membrane} -= {threshold};" if subtract else f"{membrane} = 0;"
        spike = [after, f"{name}_id[@slot@][fired] = (@prefix@_id_t)n;", "fired++;"]
        lines = []
        test = f"if ({membrane} > {threshold}) {{"
        if self._refractory(layer):
            waits = f"{name}_refractory[n]"
            lines += [
                f"if ({waits} > 0u) {{",
                f"    {waits}--;",
                f"    {membrane} = 0;",
            ]
            test = f"}} else {test}"
            spike.append(f"{waits} = {self.registers.refractory - 1}u;")
        tail = ["} else {", "    /* it stays below its threshold */"]
        tail = tail if self._refractory(layer) else []
        return [*lines, test, *(f"    {s}" for s in spike), *tail, "}"]

    def _refractory(self, layer: Layer) -> bool:
        return layer.spiking and self.registers.refractory > 1

    def _mixed(self, factor: NDArray[np.int64]) -> bool:
        """Whether some neuron keeps a part, and not all or nothing as all others do."""
        return bool(factor.any() and (factor != self.registers.decay_one).any())

    def _kept(self, table: str, state: str, factor: NDArray[np.int64], out: Declarations) -> str:
        """C for what is left of a state, and the plus sign behind it; "" for nothing."""
        if not factor.any():
            return ""
        if not self._mixed(factor):
            return f"{state} + "
        return f"decay({state}, {out.per_neuron(table, factor, 'n', f'u{self.kind}')}) + "
