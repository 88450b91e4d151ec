"""The design: a network on a chip, which is what design rules judge."""

from dataclasses import dataclass
from functools import cached_property

import nir
import numpy as np

from spikedeploy.runtime.artifact.artifact import Artifact
from spikedeploy.runtime.chips.chip import Chip
from spikedeploy.runtime.chips.limits import Limits
from spikedeploy.runtime.design_rules.mapping import CoreMapping, mapping
from spikedeploy.runtime.design_rules.topology import Population, Topology, topology
from spikedeploy.runtime.graph.neurons import NEURONS, SPIKING, DiscreteNeuron, discretise


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
        weight = max((connection.fan.largest for connection in population.presynaptic), default=0.0)
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
        network=topology(artifact.graph),
        neurons={
            name: discretise(name, node, artifact.convention)
            for name, node in artifact.graph.nodes.items()
            if isinstance(node, NEURONS)
        },
    )
