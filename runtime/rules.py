"""The design rules: a table of them, and what they say of a network on a chip."""

from collections.abc import Callable, Iterable
from typing import TypeAlias

from runtime import rules_of_layers, rules_of_networks, rules_of_nodes
from runtime.artifact import Artifact
from runtime.chip import Chip
from runtime.design import Design, design
from runtime.errors import RuleError
from runtime.ruling import Ruling

Rule: TypeAlias = Callable[[Design], Iterable[Ruling]]

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
    "weight-bits": rules_of_nodes.weight_bits,
    "weight-values": rules_of_nodes.weight_values,
    "threshold-range": rules_of_nodes.threshold_range,
    "decay-range": rules_of_nodes.decay_range,
    "recurrence": rules_of_nodes.recurrence,
    "delay": rules_of_nodes.delay,
}
NETWORK_RULES: dict[str, Rule] = {
    "inputs": rules_of_networks.inputs,
    "outputs": rules_of_networks.outputs,
    "fan-out-mean": rules_of_networks.fan_out_mean,
    "cores": rules_of_networks.cores,
    "chips": rules_of_networks.chips,
    "convention": rules_of_networks.convention,
}
RULES = (*NODE_RULES, *NETWORK_RULES)
# what the arithmetic itself cannot do, so that no size of the chip would help
ARITHMETIC = ("primitive", "reset", "weight-bits", "threshold-range", "decay-range", "convention")


def judged(plan: Design) -> list[Ruling]:
    """What every rule says of every node, and of the network."""
    rulings = []
    for name, rule in NODE_RULES.items():
        found = list(rule(plan))
        silent = set(plan.graph.nodes) - {ruling.node for ruling in found}
        rulings += [*found, *(Ruling(name, node, "not applicable") for node in sorted(silent))]
    for rule in NETWORK_RULES.values():
        rulings += rule(plan)
    return rulings


def refuse(artifact: Artifact, chip: Chip) -> None:
    """Refuse a network that breaks a design rule of the chip, by the first that it breaks."""
    if chip.limits is None:
        return
    broken = [ruling for ruling in judged(design(artifact, chip, chip.limits)) if ruling.failed]
    if broken:
        way_out = " Or emulate the arithmetic alone with --limits off (limits=False)."
        first = broken[0]
        line = first.describe(chip.name)
        raise RuleError(line if first.rule in ARITHMETIC else f"{line}{way_out}")
