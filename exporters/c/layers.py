"""The functions of a layer in C: the rows of its projections, and its timestep."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.cuba import CubaWriter
from spikedeploy.exporters.c.declarations import Declarations
from spikedeploy.exporters.c.integrate import IntegrateWriter
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.c.synapses import Rows, cleared, unit_of
from spikedeploy.runtime.chips.layer import Layer

Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LayerWriter:
    """Writes the layers of a plan.

    neurons: writes what neurons do.
    out: declarations of their file.
    """

    plan: Plan
    neurons: CubaWriter | IntegrateWriter
    out: Declarations

    def functions(self, layer: Layer) -> str:
        """The functions of a layer."""
        name, neurons = self.plan.names[layer.name], self.neurons
        bias = layer.bias.astype(np.int64)
        if isinstance(neurons, IntegrateWriter):
            bias = bias + layer.voltage_bias.astype(np.int64)
        unit = unit_of(layer, bias)
        rows = [
            Rows(f"{name}_row{k}", s.weight.astype(np.int64) // unit)
            for k, s in enumerate(layer.synapses)
        ]
        if isinstance(neurons, IntegrateWriter) and neurons.rules.adds == "event":
            added = [self._row(layer, k, each) for k, each in enumerate(rows)]
            added.append(_function(f"{name}_take", neurons.take(layer, name, unit, self.out)))
            body = self._by_event(layer, name, bias // unit, neurons)
        else:
            added = [
                each.together(self.plan.id_kind, self.out)
                if self._together(layer, k, each)
                else self._row(layer, k, each)
                for k, each in enumerate(rows)
            ]
            body = self._summed(layer, rows, bias // unit, unit)
        return "\n".join([*added, self._step(layer, name, body)])

    def _step(self, layer: Layer, name: str, body: str) -> str:
        """The timestep of a layer around its body."""
        slot, kind = self.plan.slot(layer.name), self.plan.count_kind(layer.name)
        if layer.spiking:
            body = f"uint32_t fired = 0u;\n{body}\n{name}_count[{slot}] = ({kind})fired;"
        remark = f"/* layer {_comment(layer.name)} */\n"
        return remark + _function(f"{name}_step", body.replace("@slot@", slot))

    def _row(self, layer: Layer, k: int, rows: Rows) -> str:
        return rows.function(self.plan.kind, self.plan.several(layer.synapses[k].source), self.out)

    def _together(self, layer: Layer, k: int, rows: Rows) -> bool:
        """Whether the rows of a projection are added several at a time."""
        return rows.whole and not self.plan.several(layer.synapses[k].source)

    def _summed(self, layer: Layer, rows: list[Rows], bias: Integers, unit: int) -> str:
        """A timestep that takes in all spikes as one sum."""
        name, neurons, out = self.plan.names[layer.name], self.neurons, self.out
        parts = [cleared(bias, name, self.plan.kind, out)]
        for k, each in enumerate(rows):
            of, slot = self._source(layer, k)
            if self._together(layer, k, each):
                parts.append(f"{each.name}({of}_id[{slot}], {of}_count[{slot}]);")
            else:
                times = f", {of}_times[{slot}][i]" if self._several(layer, k) else ""
                parts.append(_for_each(of, slot, f"{each.name}({of}_id[{slot}][i]{times});"))
        if isinstance(neurons, CubaWriter):
            largest = self.plan.cuba_largest(layer, neurons.registers)
            return "\n".join([*parts, neurons.update(layer, name, unit, largest, out)])
        first, last = neurons.begin(layer, name, out), neurons.end(layer, name, out)
        take = neurons.take(layer, name, unit, out)
        return "\n".join(filter(None, [first, *parts, take, last]))

    def _by_event(self, layer: Layer, name: str, bias: Integers, neurons: IntegrateWriter) -> str:
        """A timestep that takes in one event after another, and the bias as the last."""
        out, kind = self.out, self.plan.kind
        nothing, parts = cleared(np.zeros_like(bias), name, kind, out), []
        for k in range(len(layer.synapses)):
            of, slot = self._source(layer, k)
            several = self._several(layer, k)
            row = f"{name}_row{k}({of}_id[{slot}][i]{', 1u' if several else ''});"
            body = "\n".join([nothing, row, f"{name}_take();"])
            if several:
                loop = f"for (again = 0u; again < {of}_times[{slot}][i]; again++) {{"
                body = f"uint32_t again;\n{loop}\n{indented(body.splitlines())}\n}}"
            parts.append(_for_each(of, slot, body))
        if bias.any():
            parts += [cleared(bias, name, kind, out), f"{name}_take();"]
        first, last = neurons.begin(layer, name, out), neurons.end(layer, name, out)
        return "\n".join(filter(None, [first, *parts, last]))

    def _source(self, layer: Layer, k: int) -> tuple[str, str]:
        """The name of the source of a projection, and which of its kept spikes arrive."""
        source, names = layer.synapses[k].source, [a.name for a in self.plan.program.layers]
        lag = self.plan.program.lags[names.index(layer.name)][k]
        return self.plan.names[source], self.plan.slot(source, lag)

    def _several(self, layer: Layer, k: int) -> bool:
        return self.plan.several(layer.synapses[k].source)


def indented(lines: list[str], depth: int = 1) -> str:
    """Lines of C, each so many levels deeper."""
    return "\n".join("    " * depth + line if line else line for line in lines)


def _function(name: str, body: str) -> str:
    """A C function that takes and gives nothing, with a counter n of neurons."""
    return (
        f"static void {name}(void)\n{{\n    uint32_t n;\n" + indented(body.splitlines()) + "\n}\n"
    )


def _for_each(of: str, slot: str, body: str) -> str:
    """C that does something for each event i of a source."""
    loop = f"for (i = 0u; i < {of}_count[{slot}]; i++) {{"
    lines = ["uint32_t i;", loop, indented(body.splitlines()), "}"]
    return f"{{\n{indented(chr(10).join(lines).splitlines())}\n}}"


def _comment(text: str) -> str:
    """A name from a file as it may stand in a comment of C."""
    return re.sub(r"[^A-Za-z0-9_.-]", "?", text)[:60]
