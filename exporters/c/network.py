"""policy.h and policy.c: the chip's integers, one timestep after another."""

from spikedeploy.exporters.c.cuba import CubaWriter
from spikedeploy.exporters.c.declarations import Declarations, bytes_of
from spikedeploy.exporters.c.integrate import IntegrateWriter
from spikedeploy.exporters.c.layers import LayerWriter, indented
from spikedeploy.exporters.c.plan import Plan
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
            self._neurons = CubaWriter(plan.program, arithmetic, plan.kind, plan.largest)
        else:
            self._neurons = IntegrateWriter(plan.program, arithmetic, plan.kind)  # type: ignore[arg-type]
        self._declare()

    @property
    def functions(self) -> str:
        """All functions but the public ones."""
        writer = LayerWriter(self.plan, self._neurons, self.out)
        layers = [writer.functions(layer) for layer in self.plan.program.layers]
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
            "input_times": "in_times[@begin_slot@]" if self.plan.several(program.input) else "0",
            "steps": indented(steps),
            "views": indented(self._views(), 2),
        }

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
        if self.plan.several(source):
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
                if self.plan.several(layer.name):
                    lines.append(f"    view->times = {name}_times[{slot}];")
            lines.append("    break;")
        return lines


def _unsigned(state: str) -> str:
    """The suffix of constants of a state."""
    return "u" if state.endswith(("_refractory", "_spikes")) else ""
