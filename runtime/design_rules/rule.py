"""What a design rule is given, a network placed on a chip, and what it says of it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import nir
import numpy as np

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip, Limits
from spikedeploy.runtime.design_rules.mapping import CoreMapping, mapping
from spikedeploy.runtime.design_rules.topology import Population, Topology, topology
from spikedeploy.runtime.graph.neurons import NEURONS, SPIKING, DiscreteNeuron, discretise

Status = Literal["pass", "fail", "unknown", "not applicable"]
Value = float | str | None


@dataclass(frozen=True, eq=False)
class PlacedNetwork:
    """All that rules are about.

    artifact: the network and its convention.
    chip, limits: of the chip.
    network: populations and synapses.
    neurons: the difference equation of each node of neurons.
    """

    artifact: Artifact
    chip: Chip
    limits: Limits
    network: Topology
    neurons: dict[str, DiscreteNeuron]

    @cached_property
    def mapping(self) -> CoreMapping:
        """The network on the chip's cores."""
        return mapping(self.network, self.chip, self.graph)

    @property
    def graph(self) -> nir.NIRGraph:
        """Of the artifact."""
        return self.artifact.graph

    @property
    def inside(self) -> list[Population]:
        """Populations that count as neurons of the chip, not as its outputs."""
        if self.limits.outputs is None:
            return list(self.network.populations)
        return [p for p in self.network.populations if not p.leaves]

    @property
    def outputs(self) -> list[Population]:
        """Populations whose spikes leave the chip."""
        return [p for p in self.network.populations if p.leaves]

    def largest(self, population: Population) -> float:
        """The greatest weight into a population, with the gain of its neurons."""
        weight = max((projection.fan.largest for projection in population.presynaptic), default=0.0)
        neuron = self.neurons.get(population.name)
        return weight * (float(np.abs(neuron.gain).max()) if neuron else 1.0)

    def spikes(self, population: Population) -> bool:
        """Whether its neurons have a membrane and spike."""
        return isinstance(self.graph.nodes[population.name], SPIKING)


def design(artifact: Artifact, chip: Chip, limits: Limits) -> PlacedNetwork:
    """The artifact on the chip."""
    return PlacedNetwork(
        artifact=artifact,
        chip=chip,
        limits=limits,
        network=topology(
            artifact.graph, chip.membrane_output != "none", frozenset(artifact.sigma_delta)
        ),
        neurons={
            name: discretise(name, node, artifact.convention)
            for name, node in artifact.graph.nodes.items()
            if isinstance(node, NEURONS)
        },
    )


@dataclass(frozen=True)
class RuleResult:
    """What a rule found.

    rule: its name.
    node: None for the whole network.
    status: "unknown" where no limit is published; "not applicable" where the node has nothing that
        the rule is about.
    found, limit: numbers in `unit`, or words; the limit is the most, or what is possible.
    unit: what is counted.
    remedy: what to do where it fails.
    note: what a reader must know to judge it.
    """

    rule: str
    node: str | None
    status: Status
    found: Value = None
    limit: Value = None
    unit: str = ""
    remedy: str = ""
    note: str = ""

    @property
    def failed(self) -> bool:
        """Whether the network breaks the rule here."""
        return self.status == "fail"

    def describe(self, chip: str) -> str:
        """One line on a failure: the rule, the node, what was found, the limit, the remedy."""
        where = "the network" if self.node is None else f"node {self.node!r}"
        if self.limit is None:
            found = text(self.found).rstrip(".")
            if found.startswith("rule "):  # the compiler names one of its own
                return f"{self.rule}: {found}."
            return f"rule {self.rule}: {where}: {found}. {self.remedy}".rstrip()
        has = "at most " if isinstance(self.limit, int | float) else ""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"rule {self.rule}: {where} has {text(self.found)}{unit}; {chip} has "
            f"{has}{text(self.limit)}. {self.remedy}"
        )

    def as_json(self) -> dict[str, Any]:
        """All of it, for machines."""
        return {
            "rule": self.rule,
            "node": self.node,
            "status": self.status,
            "found": self.found,
            "limit": self.limit,
            "unit": self.unit,
            "remedy": self.remedy if self.failed else "",
            "note": self.note,
        }


def at_most(
    rule: str,
    node: str | None,
    found: float,
    limit: float | None,
    unit: str,
    remedy: str,
    note: str = "",
) -> RuleResult:
    """Pass up to the limit, fail above it, unknown without one."""
    status: Status = "unknown" if limit is None else "pass" if found <= limit else "fail"
    return RuleResult(rule, node, status, found, limit, unit, remedy, note)


def allowed(
    rule: str, node: str | None, found: str, possible: tuple[str, ...], remedy: str
) -> RuleResult:
    """Pass where the chip has what was found."""
    status: Status = "pass" if found in possible else "fail"
    return RuleResult(rule, node, status, found, ", ".join(possible) or "none", "", remedy)


def text(value: Value) -> str:
    """A number with its thousands apart, or the words."""
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
