"""The design rules: a table of them, and what they say of a network on a chip."""

from collections.abc import Callable, Collection, Iterable
from typing import TypeAlias

from spikedeploy.runtime.design_rules import capacity_rules, node_rules
from spikedeploy.runtime.design_rules.rule import PlacedNetwork, RuleResult
from spikedeploy.runtime.errors import RuleError

Rule: TypeAlias = Callable[[PlacedNetwork], Iterable[RuleResult]]

# rules on single nodes, which say of the others that they do not apply
NODE_RULES: dict[str, Rule] = {
    "primitive": node_rules.primitive,
    "reset": node_rules.reset,
    "graded": node_rules.graded,
    "neurons": capacity_rules.neurons,
    "fan-in": capacity_rules.fan_in,
    "fan-out": capacity_rules.fan_out,
    "synaptic-memory": capacity_rules.synaptic_memory,
    "axons-in": capacity_rules.axons_in,
    "axons-out": capacity_rules.axons_out,
    "shape": capacity_rules.shape,
    "destinations": capacity_rules.destinations,
    "kernel": node_rules.kernel,
    "sign": node_rules.axon_signs,
    "axon-types": node_rules.weight_values,
    "weight-bits": node_rules.weight_bits,
    "threshold-range": node_rules.threshold_range,
    "decay-range": node_rules.decay_range,
    "recurrence": node_rules.recurrence,
    "delay": node_rules.delay,
}
_NETWORK_RULES: dict[str, Rule] = {
    "inputs": capacity_rules.inputs,
    "outputs": capacity_rules.outputs,
    "input-targets": capacity_rules.input_targets,
    "output-sources": capacity_rules.output_sources,
    "fan-out-mean": capacity_rules.fan_out_mean,
    "cores": capacity_rules.cores,
    "chips": capacity_rules.chips,
    "convention": capacity_rules.convention,
}
RULES = (*NODE_RULES, *_NETWORK_RULES)
# what the compiler alone finds: biases that no neuron can have, a network too large to unroll, and
# an option that no scale satisfies; all else that it refuses has the name of a rule
COMPILER_RULES = ("bias", "clock", "matrix", "headroom")
# about numbers and not about capacity: the compiler looks at them when it rounds, too
ARITHMETIC = (
    "primitive",
    "reset",
    "graded",
    "sign",
    "axon-types",
    "weight-bits",
    "threshold-range",
    "decay-range",
    "convention",
)
CAPACITY = tuple(name for name in RULES if name not in ARITHMETIC)


def judged(plan: PlacedNetwork, names: Collection[str] = RULES) -> list[RuleResult]:
    """What each of these rules says of every node, and of the network."""
    results = []
    for name, rule in NODE_RULES.items():
        if name not in names:
            continue
        found = list(rule(plan))
        others = set(plan.graph.nodes) - {result.node for result in found}
        results += [*found, *(RuleResult(name, node, "not applicable") for node in sorted(others))]
    for name, rule in _NETWORK_RULES.items():
        results += rule(plan) if name in names else ()
    return results


def refuse(plan: PlacedNetwork, names: Collection[str] = RULES) -> None:
    """Refuse a network that breaks one of these rules of the chip, by the first that it breaks."""
    for result in judged(plan, names):
        if result.failed:
            raise RuleError(
                f"{result.describe(plan.chip.name)} Or emulate the arithmetic alone with --limits "
                "off (limits=False)."
            )
