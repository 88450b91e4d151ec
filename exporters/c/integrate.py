"""One timestep of integrate-and-fire neurons in C, as their family in the runtime has it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, literal
from spikedeploy.exporters.c.registers import fit, held, shifted_down
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.families.integrate_and_fire.rules import IntegrateAndFireRules


@dataclass(frozen=True)
class IntegrateWriter:
    """Writes the functions of integrate-and-fire layers.

    program: whose layers they are.
    rules: of its chip.
    kind: C type of all numbers.
    """

    program: Program
    rules: IntegrateAndFireRules
    kind: str

    has_current = False

    def shared(self) -> str:
        """Functions that all layers use."""
        return fit("membrane", self.rules.membrane, self.kind)

    def variables(self, layer: Layer, name: str, out: Declarations) -> None:
        """Declare the states of a layer."""
        out.variable(f"{name}_membrane", "@prefix@_int_t", layer.size)
        if layer.spiking:
            out.variable(f"{name}_spikes", "uint8_t", layer.size)

    def states(self, layer: Layer, name: str) -> list[str]:
        """The states that a reset sets to 0, for each neuron n."""
        return [f"{name}_membrane", *([f"{name}_spikes"] if layer.spiking else [])]

    def begin(self, layer: Layer, name: str, out: Declarations) -> str:
        """The body of a timestep before spikes arrive."""
        lines = [f"{name}_spikes[n] = 0u;"] if layer.spiking else []
        if self.rules.leak_order == "first":
            lines += self._late_resets(layer, name, out, self._leak(layer, name, out))
            if self.rules.checks == "event":
                lines += self._fire(layer, name, out)
        return _each(layer, lines)

    def take(self, layer: Layer, name: str, unit: int, out: Declarations) -> str:
        """What the sums do to the membranes, in a step or of one event."""
        v = f"{name}_membrane[n]"
        added = f"sums[n] * {literal(unit, self.kind)}" if unit > 1 else "sums[n]"
        lines = [f"{v} = {held('membrane', self.rules.membrane, f'{v} + {added}')};"]
        floor = self._floor(layer)
        if floor is not None:
            least = out.per_neuron(f"{name}_floor", floor, "n", self.kind)
            lines += [f"if ({v} < {least}) {{", f"    {v} = {least};", "}"]
        if self.rules.checks == "event":
            lines += self._fire(layer, name, out)
        return _each(layer, lines)

    def end(self, layer: Layer, name: str, out: Declarations) -> str:
        """The body of a timestep after spikes have arrived."""
        lines = self._leak(layer, name, out) if self.rules.leak_order == "last" else []
        if self.rules.checks == "step":
            lines += self._fire(layer, name, out)
        if layer.spiking:
            several = [f"    {name}_times[@slot@][fired] = {name}_spikes[n];"]
            lines += [
                f"if ({name}_spikes[n] > 0u) {{",
                f"    {name}_id[@slot@][fired] = (@prefix@_id_t)n;",
                *(several if self.rules.spikes_max > 1 else []),
                "    fired++;",
                "}",
            ]
        return _each(layer, lines)

    def _leak(self, layer: Layer, name: str, out: Declarations) -> list[str]:
        leak = layer.membrane_decay
        if self.rules.leak == "none" or not leak.any():
            return [] if self.rules.leak != "shift" else self._shift(layer, name, out)
        if self.rules.leak == "shift":
            return self._shift(layer, name, out)
        v, lost = f"{name}_membrane[n]", out.per_neuron(f"{name}_leak", leak, "n", self.kind)
        if self.rules.leak == "crossing":
            return [f"if ({v} > 0) {{", f"    {v} -= {lost};", f"}} else if ({v} < 0) {{",
                    f"    {v} += {lost};", "}"]  # fmt: skip
        up, down = f"(({v} > {lost}) ? {lost} : {v})", f"((-{v} > {lost}) ? {lost} : -{v})"
        return [f"if ({v} > 0) {{", f"    {v} -= {up};", f"}} else if ({v} < 0) {{",
                f"    {v} += {down};", "}"]  # fmt: skip

    def _late_resets(
        self, layer: Layer, name: str, out: Declarations, leak: list[str]
    ) -> list[str]:
        """The leak, in whose place a neuron is reset that fired in the timestep before."""
        if self.rules.reset_at == "spike" or not layer.spiking:
            return leak
        test, after = self._test(layer, name, out)
        return [f"if ({test}) {{", f"    {after}", "} else {", *(f"    {a}" for a in leak), "}"]

    def _test(self, layer: Layer, name: str, out: Declarations) -> tuple[str, str]:
        """Whether a neuron fires, and its reset."""
        v = f"{name}_membrane[n]"
        threshold = out.per_neuron(f"{name}_threshold", layer.threshold, "n", self.kind)
        test = f"{v} {'>=' if self.rules.fires == 'reached' else '>'} {threshold}"
        subtract = self.program.convention.reset == "subtract"
        return test, f"{v} -= {threshold};" if subtract else f"{v} = 0;"

    def _shift(self, layer: Layer, name: str, out: Declarations) -> list[str]:
        """V - (V >> shift); a negative shift is none, and then what is taken off is 0."""
        v, leak = f"{name}_membrane[n]", layer.membrane_decay
        if (leak < 0).all():
            return []
        shift = out.per_neuron(f"{name}_leak", np.maximum(leak, 0), "n", "uint32_t")
        off = f"{v} -= {shifted_down(v, shift)};"
        if (leak >= 0).all():
            return [off]
        leaks = out.per_neuron(f"{name}_leaks", (leak >= 0).astype(np.int64), "n", "uint32_t")
        return [f"if ({leaks} != 0u) {{", f"    {off}", "}"]

    def _floor(self, layer: Layer) -> NDArray[np.int64] | None:
        """Below what membranes (N,) cannot fall; None where there is no floor."""
        floors = [np.full(layer.size, self.rules.floor)] if self.rules.floor is not None else []
        if self.program.convention.floor == "zero":
            floors.append(np.zeros(layer.size, np.int64))
        elif self.program.convention.floor == "threshold":
            floors.append(-layer.threshold)
        return np.max(floors, axis=0) if floors else None

    def _fire(self, layer: Layer, name: str, out: Declarations) -> list[str]:
        if not layer.spiking:
            return []
        rules, (test, after) = self.rules, self._test(layer, name, out)
        subtract = self.program.convention.reset == "subtract"
        reset = [f"    {after}"] if rules.reset_at == "spike" else []
        count = f"{name}_spikes[n]"
        added = [f"if ({count} < {rules.spikes_max}u) {{", f"    {count}++;", "}"]
        if subtract and rules.checks == "step" and rules.spikes_max > 1:
            most = f"({count} < {rules.spikes_max}u)"
            return [f"while (({test}) && {most}) {{", f"    {after}", f"    {count}++;", "}"]
        return [f"if ({test}) {{", *reset, *(f"    {line}" for line in added), "}"]


def _each(layer: Layer, lines: list[str]) -> str:
    """The lines for each neuron n; "" without lines."""
    if not lines:
        return ""
    body = "\n".join(f"    {line}" for line in lines)
    return f"for (n = 0u; n < {layer.size}u; n++) {{\n{body}\n}}"
