"""policy.h and policy.c: the chip's integers, one timestep after another."""

import re

import numpy as np

from spikedeploy.exporters.c.cuba import CubaWriter
from spikedeploy.exporters.c.declarations import Declarations, bytes_of
from spikedeploy.exporters.c.integrate import IntegrateWriter
from spikedeploy.exporters.c.plan import Plan
from spikedeploy.exporters.c.synapses import Rows, cleared, unit_of
from spikedeploy.runtime.chips.layer import Layer
from spikedeploy.runtime.families.cuba.fixed_point import CubaFixedPoint


class NetworkWriter:
    """Writes the network of a plan.

    out: its declarations, complete when `functions` was asked for.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.out = Declarations(bytes_of(plan.kind), bytes_of(plan.id_kind))
        arithmetic = plan.program.chip.arithmetic
        self._neurons: CubaWriter | IntegrateWriter
        if isinstance(arithmetic, CubaFixedPoint):
            self._neurons = CubaWriter(plan.program, arithmetic, plan.kind)
        else:
            self._neurons = IntegrateWriter(plan.program, arithmetic, plan.kind)  # type: ignore[arg-type]
        self._declare()

    @property
    def functions(self) -> str:
        """All functions but the public ones."""
        layers = [self._layer(layer) for layer in self.plan.program.layers]
        return "\n".join(filter(None, [self._neurons.shared(), *layers]))

    def gaps(self) -> dict[str, str]:
        """What the template of policy.c leaves open."""
        functions = self.functions
        program, plan = self.plan.program, self.plan
        steps = [f"{plan.names[layer.name]}_step();" for layer in program.layers]
        return {
            "declarations": self.out.text,
            "functions": functions,
            "reset": indented(self._reset()),
            "advance": indented(self._advance()),
            "begin_slot": plan.slot(program.input),
            "input_times": "in_times[@begin_slot@]" if self._several(program.input) else "0",
            "steps": indented(steps),
            "views": indented(self._views(), 2),
        }

    def _several(self, source: str) -> bool:
        return self.plan.times_max[source] > 1

    def _declare(self) -> None:
        plan, out = self.plan, self.out
        out.variable("sums", "@prefix@_int_t", max(layer.size for layer in plan.program.layers))
        for source, name in plan.names.items():
            if source != plan.program.input:
                self._neurons.variables(plan.program.layer(source), name, out)
                if not plan.program.layer(source).spiking:
                    continue
            self._spikes(source, name)

    def _spikes(self, source: str, name: str) -> None:
        """Memory for the spikes of a source."""
        plan, out, slots = self.plan, self.out, self.plan.slots[source]
        out.variable(f"{name}_id", "@prefix@_id_t", slots, plan.capacity(source))
        out.variable(f"{name}_count", plan.count_kind(source), slots)
        if self._several(source):
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
            zero = [f"    {state}[n] = 0{_unsigned(state)};" for state in states]
            lines += [f"for (n = 0u; n < {layer.size}u; n++) {{", *zero, "}"]
        for source in self._sources():
            name, slots = self.plan.names[source], self.plan.slots[source]
            lines += [f"for (n = 0u; n < {slots}u; n++) {{", f"    {name}_count[n] = 0u;", "}"]
            lines += [f"{name}_head = 0u;"] if slots > 1 else []
        return lines

    def _advance(self) -> list[str]:
        """What a timestep begins with: room for the spikes of now."""
        lines = []
        for source in self._sources():
            name, slots = self.plan.names[source], self.plan.slots[source]
            if slots > 1:
                lines.append(f"{name}_head = ({name}_head + 1u) % {slots}u;")
        return lines

    def _layer(self, layer: Layer) -> str:
        """The functions of a layer: its projections, and its timestep."""
        plan, name, out = self.plan, self.plan.names[layer.name], self.out
        neurons = self._neurons
        bias = layer.bias.astype(np.int64)
        if isinstance(neurons, IntegrateWriter):
            bias = bias + layer.voltage_bias.astype(np.int64)
        unit = unit_of(layer, bias)
        rows = [
            Rows(f"{name}_row{k}", s.weight.astype(np.int64) // unit)
            for k, s in enumerate(layer.synapses)
        ]
        functions = [
            r.function(plan.kind, self._several(s.source), out)
            for r, s in zip(rows, layer.synapses, strict=True)
        ]
        by_event = isinstance(neurons, IntegrateWriter) and neurons.rules.adds == "event"
        if by_event:
            functions.append(self._take(layer, name, unit))
        body = (
            self._by_event(layer, name, bias // unit)
            if by_event
            else self._summed(layer, name, bias // unit, unit)
        )
        body = body.replace("@slot@", plan.slot(layer.name))
        counted = layer.spiking
        head = "    uint32_t i;\n    uint32_t n;\n" + (
            "    uint32_t fired = 0u;\n" if counted else ""
        )
        end = f"    {name}_count[{plan.slot(layer.name)}] = ({plan.count_kind(layer.name)})fired;\n"
        functions.append(
            f"/* layer {_comment(layer.name)} */\nstatic void {name}_step(void)\n{{\n{head}"
            + indented(body.splitlines())
            + "\n"
            + (end if counted else "")
            + "}\n"
        )
        return "\n".join(functions)

    def _summed(self, layer: Layer, name: str, bias: "np.ndarray", unit: int) -> str:
        """A timestep that takes in all spikes as one sum."""
        neurons, out = self._neurons, self.out
        parts = [cleared(bias, name, self.plan.kind, out)]
        parts += [self._events(layer, name, k, "") for k in range(len(layer.synapses))]
        if isinstance(neurons, CubaWriter):
            return "\n".join([*parts, neurons.update(layer, name, unit, out)])
        first, last = neurons.begin(layer, name, out), neurons.end(layer, name, out)
        take = neurons.take(layer, name, unit, out)
        return "\n".join(filter(None, [first, *parts, take, last]))

    def _take(self, layer: Layer, name: str, unit: int) -> str:
        """A function for what one event does to the neurons of a layer."""
        neurons = self._neurons
        body = (
            neurons.take(layer, name, unit, self.out)
            if isinstance(neurons, IntegrateWriter)
            else ""
        )
        return (
            f"static void {name}_take(void)\n{{\n    uint32_t n;\n"
            + indented(body.splitlines())
            + "\n}\n"
        )

    def _by_event(self, layer: Layer, name: str, bias: "np.ndarray") -> str:
        """A timestep that takes in one event after another, and the bias as the last."""
        neurons, out, kind = self._neurons, self.out, self.plan.kind
        if not isinstance(neurons, IntegrateWriter):
            raise TypeError(type(neurons).__name__)
        nothing = cleared(np.zeros_like(bias), name, kind, out)
        each = "\n".join([nothing, "@row@", f"{name}_take();"])
        parts = [self._events(layer, name, k, each) for k in range(len(layer.synapses))]
        if bias.any():
            parts += [cleared(bias, name, kind, out), f"{name}_take();"]
        first, last = neurons.begin(layer, name, out), neurons.end(layer, name, out)
        return "\n".join(filter(None, [first, *parts, last]))

    def _events(self, layer: Layer, name: str, k: int, each: str) -> str:
        """C that adds the rows of the events that arrive through a projection.

        each: what is done for an event, with a gap for its row; "" adds up all.
        """
        plan, source = self.plan, layer.synapses[k].source
        index = [a.name for a in plan.program.layers].index(layer.name)
        slot, of = plan.slot(source, plan.program.lags[index][k]), plan.names[source]
        several = self._several(source)
        axon = f"{of}_id[{slot}][i]"
        row = f"{name}_row{k}({axon}{f', {of}_times[{slot}][i]' if several and not each else ''});"
        body = row
        if each:
            body = each.replace("@row@", f"{name}_row{k}({axon}{', 1u' if several else ''});")
            if several:
                loop = f"for (again = 0u; again < {of}_times[{slot}][i]; again++) {{"
                body = f"uint32_t again;\n{loop}\n{indented(body.splitlines())}\n}}"
        lines = indented(body.splitlines())
        return f"for (i = 0u; i < {of}_count[{slot}]; i++) {{\n{lines}\n}}"

    def _views(self) -> list[str]:
        lines = []
        for k, layer in enumerate(self.plan.program.layers):
            name = self.plan.names[layer.name]
            current = f"{name}_current" if self._neurons.has_current else "0"
            lines += [
                f"case {k}u:",
                f"    view->size = {layer.size}u;",
                f"    view->current = {current};",
            ]
            lines.append(f"    view->membrane = {name}_membrane;")
            if layer.spiking:
                slots = self.plan.slots[layer.name]
                slot = f"({name}_head + {slots}u - late) % {slots}u" if slots > 1 else "0"
                lines += [
                    f"    view->id = {name}_id[{slot}];",
                    f"    view->count = {name}_count[{slot}];",
                ]
                if self._several(layer.name):
                    lines.append(f"    view->times = {name}_times[{slot}];")
            lines.append("    break;")
        return lines


def indented(lines: list[str], depth: int = 1) -> str:
    """Lines of C, each so many levels deeper."""
    return "\n".join("    " * depth + line if line else line for line in lines)


def _unsigned(state: str) -> str:
    """The suffix of constants of a state."""
    return "u" if state.endswith(("_refractory", "_spikes")) else ""


def _comment(text: str) -> str:
    """A name from a file as it may stand in a comment of C."""
    return re.sub(r"[^A-Za-z0-9_.-]", "?", text)[:60]
