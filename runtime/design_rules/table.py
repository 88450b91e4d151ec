"""The design rules: a table of them, and what they say of a network on a chip."""

from collections.abc import Callable, Collection, Iterable
from typing import TypeAlias

from spikedeploy.runtime.design_rules import capacity_rules as rules_of_layers
from spikedeploy.runtime.design_rules import capacity_rules as rules_of_networks
from spikedeploy.runtime.design_rules import node_rules as rules_of_nodes
from spikedeploy.runtime.design_rules import node_rules as rules_of_weights
from spikedeploy.runtime.design_rules.placed import PlacedNetwork
from spikedeploy.runtime.design_rules.result import RuleResult
from spikedeploy.runtime.errors import RuleError

Rule: TypeAlias = Callable[[PlacedNetwork], Iterable[RuleResult]]

# rules on single nodes, which say of the others that they do not apply
NODE_RULES: dict[str, Rule] = {
    "primitive": rules_of_nodes.primitive,
    "reset": rules_of_nodes.reset,
    "neurons": rules_of_layers.neurons,
    "fan-in": rules_of_layers.fan_in,
    "fan-out": rules_of_layers.fan_out,
    "synaptic-memory": rules_of_layers.synaptic_memory,
    "axons-in": rules_of_layers.axons_in,
    "axons-out": rules_of_layers.axons_out,
    "shape": rules_of_layers.shape,
    "destinations": rules_of_layers.destinations,
    "kernel": rules_of_weights.kernel,
    "sign": rules_of_weights.axon_signs,
    "axon-types": rules_of_weights.weight_values,
    "weight-bits": rules_of_nodes.weight_bits,
    "threshold-range": rules_of_nodes.threshold_range,
    "decay-range": rules_of_nodes.decay_range,
    "recurrence": rules_of_nodes.recurrence,
    "delay": rules_of_nodes.delay,
}
NETWORK_RULES: dict[str, Rule] = {
    "inputs": rules_of_networks.inputs,
    "outputs": rules_of_networks.outputs,
    "input-targets": rules_of_networks.input_targets,
    "output-sources": rules_of_networks.output_sources,
    "fan-out-mean": rules_of_networks.fan_out_mean,
    "cores": rules_of_networks.cores,
    "chips": rules_of_networks.chips,
    "convention": rules_of_networks.convention,
}
RULES = (*NODE_RULES, *NETWORK_RULES)
# what the compiler alone finds: biases that no neuron can have, a network too large to unroll, and
# an option that no scale satisfies; all else that it refuses has the name of a rule
COMPILER_RULES = ("bias", "matrix", "headroom")
# what is about numbers and not about room: the compiler looks at them when it rounds, too
ARITHMETIC = (
    "primitive",
    "reset",
    "sign",
    "axon-types",
    "weight-bits",
    "threshold-range",
    "decay-range",
    "convention",
)
ROOM = tuple(name for name in RULES if name not in ARITHMETIC)


def judged(plan: PlacedNetwork, names: Collection[str] = RULES) -> list[RuleResult]:
    """What each of these rules says of every node, and of the network."""
    rulings = []
    for name, rule in NODE_RULES.items():
        if name not in names:
            continue
        found = list(rule(plan))
        silent = set(plan.graph.nodes) - {ruling.node for ruling in found}
        rulings += [*found, *(RuleResult(name, node, "not applicable") for node in sorted(silent))]
    for name, rule in NETWORK_RULES.items():
        rulings += rule(plan) if name in names else ()
    return rulings


def refuse(plan: PlacedNetwork, names: Collection[str] = RULES) -> None:
    """Refuse a network that breaks one of these rules of the chip, by the first that it breaks."""
    for ruling in judged(plan, names):
        if ruling.failed:
            raise RuleError(
                f"{ruling.describe(plan.chip.name)} Or emulate the arithmetic alone with --limits "
                "off (limits=False)."
            )
