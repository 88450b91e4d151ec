"""The synapses of a projection in C: rows of weights that the events of a timestep add up."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import Declarations, bytes_of, literal, narrowest_of
from spikedeploy.exporters.c.templates import filled, template
from spikedeploy.runtime.chips.layer import Layer

Integers = NDArray[np.int64]

# a row with gaps is kept whole where that takes no more than so many times the bytes
_WHOLE = 1.4
# and where at least this part of it is not 0: a synapse of a list takes more instructions
_DENSE = 0.5
# synapses of a projection that are written as statements, which take half the instructions of lists
# and twice the memory
_STATEMENTS = 2048
# rows that are added at a time
_TOGETHER = 8


@dataclass(frozen=True, eq=False)
class Rows:
    """The weights of a projection, divided by what all weights of the layer share.

    name: of its function in C.
    weight: (M, N).
    """

    name: str
    weight: Integers

    @property
    def whole(self) -> bool:
        """Whether rows are stored with their zeros."""
        axons, neurons = self.weight.shape
        each = bytes_of(narrowest_of(self.weight))
        synapses = np.count_nonzero(self.weight)
        lists = synapses * (each + bytes_of("uint8_t" if neurons <= 256 else "uint16_t"))
        lists += (axons + 1) * (2 if synapses < 2**16 else 4)
        dense = synapses >= _DENSE * axons * neurons
        return bool(dense and axons * neurons * each <= _WHOLE * lists)

    def function(self, kind: str, several: bool, out: Declarations) -> str:
        """The function that adds one row to the sums, and its tables.

        several: whether a neuron can spike several times in a timestep.
        """
        times = ", uint32_t times" if several else ""
        body = self._whole_row(kind, several, out) if self.whole else self._list(kind, several, out)
        return (
            f"static void {self.name}(uint32_t axon{times})\n{{\n"
            + "\n".join(f"    {line}" for line in body)
            + "\n}\n"
        )

    def together(self, id_kind: str, out: Declarations) -> str:
        """A function that adds the rows of a list of events, eight at a time.

        For rows that are whole, of neurons that spike once in a timestep.
        """
        neurons, stored = self.weight.shape[1], narrowest_of(self.weight)
        table = out.constant(f"{self.name}_weight", self.weight)
        # eight numbers of 8 bits fit in 16
        sum_kind = "int16_t" if stored in ("int8_t", "uint8_t") else "int32_t"
        rows = [f"row[{k}][n]" for k in range(_TOGETHER)]
        gaps = {
            "name": self.name,
            "id_kind": id_kind,
            "stored": stored,
            "table": table,
            "neurons": str(neurons),
            "together": str(_TOGETHER),
            "sum_kind": sum_kind,
            "rows": " + ".join(rows),
        }
        return filled(template("add_rows.c"), gaps)

    def _whole_row(self, kind: str, several: bool, out: Declarations) -> list[str]:
        neurons, table = self.weight.shape[1], out.constant(f"{self.name}_weight", self.weight)
        stored = narrowest_of(self.weight)
        value = f"({kind})times * row[n]" if several else "row[n]"
        return [
            f"const {stored} *row = &{table}[axon * {neurons}u];",
            "uint32_t n;",
            f"for (n = 0u; n < {neurons}u; n++) {{",
            f"    sums[n] += {value};",
            "}",
        ]

    def _list(self, kind: str, several: bool, out: Declarations) -> list[str]:
        axons, neurons = np.nonzero(self.weight)
        if not axons.size:
            return ["(void)axon;", *(["(void)times;"] if several else [])]
        if axons.size <= _STATEMENTS and not several:
            return self._statements()
        first = np.searchsorted(axons, np.arange(len(self.weight) + 1))
        start = out.constant(f"{self.name}_first", first)
        target = out.constant(f"{self.name}_neuron", neurons)
        weight = out.constant(f"{self.name}_weight", self.weight[axons, neurons])
        value = f"({kind})times * {weight}[k]" if several else f"{weight}[k]"
        return [
            f"const uint32_t end = {start}[axon + 1u];",
            "uint32_t k;",
            f"for (k = {start}[axon]; k < end; k++) {{",
            f"    sums[{target}[k]] += {value};",
            "}",
        ]

    def _statements(self) -> list[str]:
        """A list as statements, those of an axon behind its number."""
        lines = ["switch (axon) {"]
        for axon in np.flatnonzero(self.weight.any(axis=1)):
            lines.append(f"case {axon}u:")
            row = self.weight[axon]
            lines += [f"    sums[{n}] += {row[n]};" for n in np.flatnonzero(row)]
            lines.append("    break;")
        return [*lines, "default:", "    break;", "}"]


def unit_of(layer: Layer, bias: Integers) -> int:
    """The largest power of two that divides all weights of a layer, and its bias."""
    every = np.concatenate([*(s.weight.ravel() for s in layer.synapses), bias]).astype(np.int64)
    merged = int(np.bitwise_or.reduce(np.abs(every)))
    return (merged & -merged) if merged else 1


def cleared(bias: Integers, name: str, kind: str, out: Declarations) -> str:
    """C that sets the sums to the bias."""
    value = out.per_neuron(f"{name}_bias", bias, "n", kind) if bias.any() else literal(0, kind)
    return f"for (n = 0u; n < {bias.size}u; n++) {{\n    sums[n] = {value};\n}}"
