"""policy.h and policy.c: the chip's integers, one timestep after another."""

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spikedeploy.exporters.c.declarations import (
    Declarations,
    bytes_of,
    decay,
    fit,
    hold,
    literal,
    narrowest_of,
    shifted_down,
)
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.c.templates import fill, template
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.chips.registers import Register
from spikedeploy.runtime.families.cuba.arithmetic import CubaFixedPoint
from spikedeploy.runtime.families.cuba.neurons import CubaRegisters
from spikedeploy.runtime.families.integrate_and_fire.neurons import IntegrateAndFireRules

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
    def is_whole(self) -> bool:
        """True if rows are stored with their zeros."""
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
        body = (
            self._whole_row(kind, several, out) if self.is_whole else self._list(kind, several, out)
        )
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
        return fill(template("add_rows.c"), gaps)

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


def clear_sums(bias: Integers, name: str, kind: str, out: Declarations) -> str:
    """C that sets the sums to the bias."""
    value = out.per_neuron(f"{name}_bias", bias, "n", kind) if bias.any() else literal(0, kind)
    return f"for (n = 0u; n < {bias.size}u; n++) {{\n    sums[n] = {value};\n}}"


_REGISTERS = ("accumulator", "current", "push", "membrane")


@dataclass(frozen=True)
class CubaWriter:
    """Functions of CuBa-LIF layers, as runtime.families.cuba.neurons has them."""

    plan: Plan
    registers: CubaRegisters
    out: Declarations
    used: set[str] = field(default_factory=set)  # registers that numbers can reach

    has_current = True

    @property
    def kind(self) -> str:
        """The C type of all numbers."""
        return self.plan.kind

    def shared(self) -> str:
        """Functions that the layers written before use."""
        used = [name for name in _REGISTERS if name in self.used]
        fits = [fit(name, getattr(self.registers, name), self.kind) for name in used]
        decays = [
            factor
            for layer in self.plan.program.layers
            for factor in (layer.current_decay, layer.membrane_decay)
            if self._decays(factor)
        ]
        whole = any(int(factor.max()) >= self.registers.decay_one for factor in decays)
        rest = (
            [decay(self.kind, self.registers.decay_bits, whole, self.plan.largest)]
            if decays
            else []
        )
        return "\n".join([*filter(None, fits), *rest])

    def variables(self, layer: Layer, name: str) -> None:
        """Declare the states of a layer."""
        self.out.variable(f"{name}_current", "@prefix@_int_t", layer.size)
        self.out.variable(f"{name}_membrane", "@prefix@_int_t", layer.size)
        if self._refractory(layer):
            self.out.variable(f"{name}_refractory", "uint32_t", layer.size)

    def states(self, layer: Layer, name: str) -> list[str]:
        """The states that a reset sets to 0, for each neuron n."""
        late = [f"{name}_refractory"] if self._refractory(layer) else []
        return [f"{name}_current", f"{name}_membrane", *late]

    def update(self, layer: Layer, name: str, unit: int) -> str:
        """The body of a timestep, after the weights have been summed in `sums`.

        unit: by which the sums have to be multiplied.
        """
        shift = unit << self.registers.mantissa_shift
        largest = self.plan.magnitudes[layer.name].registers
        drive = f"sums[n] * {literal(shift, self.kind)}" if shift > 1 else "sums[n]"
        current, membrane = f"{name}_current[n]", f"{name}_membrane[n]"
        bias = layer.voltage_bias
        pushed = current
        if bias.any():
            pushed += f" + {self.out.per_neuron(f'{name}_bias_v', bias, 'n', self.kind)}"
        kept = self._keep(f"{name}_keep_i", current, layer.current_decay)
        left = self._keep(f"{name}_keep_v", membrane, layer.membrane_decay)
        drive = self._hold("accumulator", drive, largest["accumulator"])
        pushed = self._hold("push", pushed, largest["push"])
        current_next = self._hold("current", f"{kept}{drive}", largest["current"])
        membrane_next = self._hold("membrane", f"{left}{pushed}", largest["membrane"])
        fire = self._fire(layer, name) if layer.spiking else []
        lines = [f"{current} = {current_next};", f"{membrane} = {membrane_next};", *fire]
        return "\n".join(_loop(layer.size, lines))

    def _hold(self, name: str, expression: str, largest: int) -> str:
        """The expression as a register holds it, which changes nothing up to its magnitude."""
        register: Register = getattr(self.registers, name)
        if register.between is None and largest < 1 << (register.bits - 1):
            return f"({expression})"
        self.used.add(name)
        return hold(name, register, expression)

    def _fire(self, layer: Layer, name: str) -> list[str]:
        threshold = self.out.per_neuron(f"{name}_threshold", layer.threshold, "n", self.kind)
        membrane = f"{name}_membrane[n]"
        subtract = self.plan.program.convention.reset == "subtract"
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

    def _decays(self, factor: NDArray[np.int64]) -> bool:
        """Return True if some neuron keeps a part of a state, and not all or nothing."""
        return bool(factor.any() and (factor != self.registers.decay_one).any())

    def _keep(self, table: str, state: str, factor: NDArray[np.int64]) -> str:
        """C for what is left of a state, and the plus sign behind it; "" for nothing."""
        if not factor.any():
            return ""
        if not self._decays(factor):
            return f"{state} + "
        return f"decay({state}, {self.out.per_neuron(table, factor, 'n', f'u{self.kind}')}) + "


@dataclass(frozen=True)
class IntegrateWriter:
    """Functions of integrate-and-fire layers, as their family in the runtime has them."""

    plan: Plan
    rules: IntegrateAndFireRules
    out: Declarations

    has_current = False

    @property
    def kind(self) -> str:
        """The C type of all numbers."""
        return self.plan.kind

    def shared(self) -> str:
        """Functions that all layers use."""
        return fit("membrane", self.rules.membrane, self.kind)

    def variables(self, layer: Layer, name: str) -> None:
        """Declare the states of a layer."""
        self.out.variable(f"{name}_membrane", "@prefix@_int_t", layer.size)
        if layer.spiking:
            self.out.variable(f"{name}_spikes", "uint8_t", layer.size)

    def states(self, layer: Layer, name: str) -> list[str]:
        """The states that a reset sets to 0, for each neuron n."""
        return [f"{name}_membrane", *([f"{name}_spikes"] if layer.spiking else [])]

    def begin(self, layer: Layer, name: str) -> str:
        """The body of a timestep before spikes arrive."""
        lines = [f"{name}_spikes[n] = 0u;"] if layer.spiking else []
        if self.rules.leak_order == "first":
            lines += self._late_resets(layer, name, self._leak(layer, name))
            if self.rules.checks == "event":
                lines += self._fire(layer, name)
        return "\n".join(_loop(layer.size, lines))

    def take(self, layer: Layer, name: str, unit: int) -> str:
        """Add the sums to the membranes, in a step or for one event."""
        v = f"{name}_membrane[n]"
        added = f"sums[n] * {literal(unit, self.kind)}" if unit > 1 else "sums[n]"
        lines = [f"{v} = {hold('membrane', self.rules.membrane, f'{v} + {added}')};"]
        floor = self._floor(layer)
        if floor is not None:
            least = self.out.per_neuron(f"{name}_floor", floor, "n", self.kind)
            lines += [f"if ({v} < {least}) {{", f"    {v} = {least};", "}"]
        if self.rules.checks == "event":
            lines += self._fire(layer, name)
        return "\n".join(_loop(layer.size, lines))

    def end(self, layer: Layer, name: str) -> str:
        """The body of a timestep after spikes have arrived."""
        lines = self._leak(layer, name) if self.rules.leak_order == "last" else []
        if self.rules.checks == "step":
            lines += self._fire(layer, name)
        if layer.spiking:
            several = [f"    {name}_times[@slot@][fired] = {name}_spikes[n];"]
            lines += [
                f"if ({name}_spikes[n] > 0u) {{",
                f"    {name}_id[@slot@][fired] = (@prefix@_id_t)n;",
                *(several if self.rules.spikes_max > 1 else []),
                "    fired++;",
                "}",
            ]
        return "\n".join(_loop(layer.size, lines))

    def _leak(self, layer: Layer, name: str) -> list[str]:
        leak = layer.membrane_decay
        if self.rules.leak == "none" or not leak.any():
            return [] if self.rules.leak != "shift" else self._shift(layer, name)
        if self.rules.leak == "shift":
            return self._shift(layer, name)
        v, lost = f"{name}_membrane[n]", self.out.per_neuron(f"{name}_leak", leak, "n", self.kind)
        if self.rules.leak == "crossing":
            return [f"if ({v} > 0) {{", f"    {v} -= {lost};", f"}} else if ({v} < 0) {{",
                    f"    {v} += {lost};", "}"]  # fmt: skip
        up, down = f"(({v} > {lost}) ? {lost} : {v})", f"((-{v} > {lost}) ? {lost} : -{v})"
        return [f"if ({v} > 0) {{", f"    {v} -= {up};", f"}} else if ({v} < 0) {{",
                f"    {v} += {down};", "}"]  # fmt: skip

    def _late_resets(self, layer: Layer, name: str, leak: list[str]) -> list[str]:
        """The leak, in whose place a neuron is reset that fired in the timestep before."""
        if self.rules.reset_at == "spike" or not layer.spiking:
            return leak
        test, after = self._test(layer, name)
        return [f"if ({test}) {{", f"    {after}", "} else {", *(f"    {a}" for a in leak), "}"]

    def _test(self, layer: Layer, name: str) -> tuple[str, str]:
        """Return C of the test whether a neuron fires, and of its reset."""
        v = f"{name}_membrane[n]"
        threshold = self.out.per_neuron(f"{name}_threshold", layer.threshold, "n", self.kind)
        test = f"{v} {'>=' if self.rules.fires == 'reached' else '>'} {threshold}"
        subtract = self.plan.program.convention.reset == "subtract"
        return test, f"{v} -= {threshold};" if subtract else f"{v} = 0;"

    def _shift(self, layer: Layer, name: str) -> list[str]:
        """V - (V >> shift); a negative shift is none, and then what is taken off is 0."""
        v, leak = f"{name}_membrane[n]", layer.membrane_decay
        if (leak < 0).all():
            return []
        shift = self.out.per_neuron(f"{name}_leak", np.maximum(leak, 0), "n", "uint32_t")
        off = f"{v} -= {shifted_down(v, shift)};"
        if (leak >= 0).all():
            return [off]
        leaks = self.out.per_neuron(f"{name}_leaks", (leak >= 0).astype(np.int64), "n", "uint32_t")
        return [f"if ({leaks} != 0u) {{", f"    {off}", "}"]

    def _floor(self, layer: Layer) -> NDArray[np.int64] | None:
        """Below what membranes (N,) cannot fall; None where there is no floor."""
        floors = [np.full(layer.size, self.rules.floor)] if self.rules.floor is not None else []
        if self.plan.program.convention.floor == "zero":
            floors.append(np.zeros(layer.size, np.int64))
        elif self.plan.program.convention.floor == "threshold":
            floors.append(-layer.threshold)
        return np.max(floors, axis=0) if floors else None

    def _fire(self, layer: Layer, name: str) -> list[str]:
        if not layer.spiking:
            return []
        rules, (test, after) = self.rules, self._test(layer, name)
        subtract = self.plan.program.convention.reset == "subtract"
        reset = [f"    {after}"] if rules.reset_at == "spike" else []
        count = f"{name}_spikes[n]"
        added = [f"if ({count} < {rules.spikes_max}u) {{", f"    {count}++;", "}"]
        if subtract and rules.checks == "step" and rules.spikes_max > 1:
            most = f"({count} < {rules.spikes_max}u)"
            return [f"while (({test}) && {most}) {{", f"    {after}", f"    {count}++;", "}"]
        return [f"if ({test}) {{", *reset, *(f"    {line}" for line in added), "}"]


class NetworkWriter:
    """policy.h and policy.c of a plan.

    out: declarations, complete once `gaps` was called.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.out = Declarations(bytes_of(plan.kind), bytes_of(plan.id_kind))
        arithmetic = plan.program.chip.arithmetic
        self._neurons: CubaWriter | IntegrateWriter
        if isinstance(arithmetic, CubaFixedPoint):
            self._neurons = CubaWriter(plan, arithmetic, self.out)
        else:
            self._neurons = IntegrateWriter(plan, arithmetic, self.out)  # type: ignore[arg-type]
        self._declare()

    def gaps(self) -> dict[str, str]:
        """Gaps of the template of policy.c."""
        program, plan = self.plan.program, self.plan
        layers = [self._layer(layer) for layer in program.layers]
        steps = [f"{plan.names[layer.name]}_step();" for layer in program.layers]
        return {
            "functions": "\n".join(filter(None, [self._neurons.shared(), *layers])),
            "declarations": self.out.text,
            "reset": indent(self._reset()),
            "advance": indent(self._advance()),
            "begin_slot": plan.slot(program.input),
            "input_times": "in_times[@begin_slot@]" if plan.several(program.input) else "0",
            "steps": indent(steps),
            "views": indent(self._views(), 2),
        }

    # states and spikes

    def _declare(self) -> None:
        plan, out = self.plan, self.out
        out.variable("sums", "@prefix@_int_t", max(layer.size for layer in plan.program.layers))
        for source, name in plan.names.items():
            if source != plan.program.input:
                self._neurons.variables(plan.program.layer(source), name)
            if source in self._sources():
                self._declare_spikes(source, name)

    def _declare_spikes(self, source: str, name: str) -> None:
        plan, out, slots = self.plan, self.out, self.plan.slots[source]
        out.variable(f"{name}_id", "@prefix@_id_t", slots, plan.capacity(source))
        out.variable(f"{name}_count", plan.count_kind(source), slots)
        if plan.several(source):
            out.variable(f"{name}_times", "uint8_t", slots, plan.capacity(source))
        if slots > 1:
            out.variable(f"{name}_head", "uint32_t")

    def _sources(self) -> list[str]:
        """Names of all that spikes."""
        program = self.plan.program
        return [n for n in self.plan.names if n == program.input or program.layer(n).spiking]

    def _reset(self) -> list[str]:
        lines = []
        for layer in self.plan.program.layers:
            states = self._neurons.states(layer, self.plan.names[layer.name])
            lines += _loop(layer.size, [f"{s}[n] = 0{_suffix(s)};" for s in states])
        for source in self._sources():
            name, slots = self.plan.names[source], self.plan.slots[source]
            lines += _loop(slots, [f"{name}_count[n] = 0u;"])
            lines += [f"{name}_head = 0u;"] if slots > 1 else []
        return lines

    def _advance(self) -> list[str]:
        """Room for the spikes of the timestep that begins."""
        named = [(self.plan.names[source], self.plan.slots[source]) for source in self._sources()]
        return [f"{n}_head = ({n}_head + 1u) % {slots}u;" for n, slots in named if slots > 1]

    def _views(self) -> list[str]:
        lines = []
        for k, layer in enumerate(self.plan.program.layers):
            name, slots = self.plan.names[layer.name], self.plan.slots[layer.name]
            current = f"{name}_current" if self._neurons.has_current else "0"
            view = {"size": f"{layer.size}u", "current": current, "membrane": f"{name}_membrane"}
            if layer.spiking:
                slot = f"({name}_head + {slots}u - late) % {slots}u" if slots > 1 else "0"
                view |= {"id": f"{name}_id[{slot}]", "count": f"{name}_count[{slot}]"}
                if self.plan.several(layer.name):
                    view["times"] = f"{name}_times[{slot}]"
            lines += [f"case {k}u:", *(f"    view->{each} = {v};" for each, v in view.items())]
            lines.append("    break;")
        return lines

    # the functions of a layer

    def _layer(self, layer: Layer) -> str:
        """The rows of a layer's projections, and its timestep."""
        name, neurons = self.plan.names[layer.name], self._neurons
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
            added.append(_function(f"{name}_take", neurons.take(layer, name, unit)))
            body = self._by_event(layer, name, bias // unit, neurons)
        else:
            added = [
                each.together(self.plan.id_kind, self.out)
                if self._is_added_together(layer, k, each)
                else self._row(layer, k, each)
                for k, each in enumerate(rows)
            ]
            body = self._sum_spikes(layer, rows, bias // unit, unit)
        return "\n".join([*added, self._step(layer, name, body)])

    def _step(self, layer: Layer, name: str, body: str) -> str:
        """The timestep of a layer around its body."""
        slot, kind = self.plan.slot(layer.name), self.plan.count_kind(layer.name)
        if layer.spiking:
            body = f"uint32_t fired = 0u;\n{body}\n{name}_count[{slot}] = ({kind})fired;"
        remark = f"/* layer {re.sub(r'[^A-Za-z0-9_.-]', '?', layer.name)[:60]} */\n"
        return remark + _function(f"{name}_step", body.replace("@slot@", slot))

    def _row(self, layer: Layer, k: int, rows: Rows) -> str:
        return rows.function(self.plan.kind, self._several(layer, k), self.out)

    def _is_added_together(self, layer: Layer, k: int, rows: Rows) -> bool:
        """True where the rows of a projection are added several at a time."""
        return rows.is_whole and not self._several(layer, k)

    def _sum_spikes(self, layer: Layer, rows: list[Rows], bias: Integers, unit: int) -> str:
        """A timestep that takes in all spikes as one sum."""
        name, neurons = self.plan.names[layer.name], self._neurons
        parts = [clear_sums(bias, name, self.plan.kind, self.out)]
        for k, each in enumerate(rows):
            of, slot = self._source(layer, k)
            if self._is_added_together(layer, k, each):
                parts.append(f"{each.name}({of}_id[{slot}], {of}_count[{slot}]);")
            else:
                times = f", {of}_times[{slot}][i]" if self._several(layer, k) else ""
                parts.append(_for_each(of, slot, f"{each.name}({of}_id[{slot}][i]{times});"))
        if isinstance(neurons, CubaWriter):
            return "\n".join([*parts, neurons.update(layer, name, unit)])
        first, last = neurons.begin(layer, name), neurons.end(layer, name)
        return "\n".join(filter(None, [first, *parts, neurons.take(layer, name, unit), last]))

    def _by_event(self, layer: Layer, name: str, bias: Integers, neurons: IntegrateWriter) -> str:
        """A timestep that takes in one event after another, and the bias as the last."""
        out, kind = self.out, self.plan.kind
        nothing, parts = clear_sums(np.zeros_like(bias), name, kind, out), []
        for k in range(len(layer.synapses)):
            of, slot = self._source(layer, k)
            several = self._several(layer, k)
            row = f"{name}_row{k}({of}_id[{slot}][i]{', 1u' if several else ''});"
            body = "\n".join([nothing, row, f"{name}_take();"])
            if several:
                loop = f"for (again = 0u; again < {of}_times[{slot}][i]; again++) {{"
                body = f"uint32_t again;\n{loop}\n{indent(body.splitlines())}\n}}"
            parts.append(_for_each(of, slot, body))
        if bias.any():
            parts += [clear_sums(bias, name, kind, out), f"{name}_take();"]
        first, last = neurons.begin(layer, name), neurons.end(layer, name)
        return "\n".join(filter(None, [first, *parts, last]))

    def _source(self, layer: Layer, k: int) -> tuple[str, str]:
        """The name of the source of a projection, and which of its kept spikes arrive."""
        source, names = layer.synapses[k].source, [a.name for a in self.plan.program.layers]
        lag = self.plan.program.lags[names.index(layer.name)][k]
        return self.plan.names[source], self.plan.slot(source, lag)

    def _several(self, layer: Layer, k: int) -> bool:
        return self.plan.several(layer.synapses[k].source)


def indent(lines: list[str], depth: int = 1) -> str:
    """Lines of C, each so many levels deeper."""
    return "\n".join("    " * depth + line if line else line for line in lines)


def _loop(size: int, lines: list[str]) -> list[str]:
    """The lines for each n below a size; none without lines."""
    body = [f"    {line}" for line in lines]
    return [f"for (n = 0u; n < {size}u; n++) {{", *body, "}"] if lines else []


def _function(name: str, body: str) -> str:
    """A C function that takes and gives nothing, with a counter n of neurons."""
    return f"static void {name}(void)\n{{\n    uint32_t n;\n{indent(body.splitlines())}\n}}\n"


def _for_each(of: str, slot: str, body: str) -> str:
    """C that does something for each event i of a source."""
    loop = f"for (i = 0u; i < {of}_count[{slot}]; i++) {{"
    return f"{{\n    uint32_t i;\n    {loop}\n{indent(body.splitlines(), 2)}\n    }}\n}}"


def _suffix(state: str) -> str:
    """The suffix of constants of a state."""
    return "u" if state.endswith(("_refractory", "_spikes")) else ""
