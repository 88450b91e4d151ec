"""NIR files: spiking policies, on an emulated chip or as their float twin."""

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from spikedeploy.envs.rollout import Rollout
from spikedeploy.policies.costs import (
    Costs,
    beside,
    message_energies,
    readout_acs,
    readout_macs,
    spiking_costs,
)
from spikedeploy.policies.host_terms import encoding, reading_out, resetting
from spikedeploy.policies.interface import FLOAT, Candidate, env_id
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.damage import Damage
from spikedeploy.runtime.chips.quantisation import PLAIN, Quantisation
from spikedeploy.runtime.design_rules.rule import design
from spikedeploy.runtime.emulator.backend import BackendName
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import Ledger, Rows
from spikedeploy.runtime.emulator.network import chip_called
from spikedeploy.runtime.errors import ArtifactError
from spikedeploy.runtime.faults import NONE, Faults
from spikedeploy.runtime.metrics.energy import TABLES
from spikedeploy.runtime.metrics.memory import packed_bytes
from spikedeploy.runtime.metrics.neurobench import connection_sparsity, dense_products, footprint
from spikedeploy.runtime.metrics.traffic import placed_messages

Floats = NDArray[np.float64]


class NirController:
    """A spiking policy with a ledger for each episode.

    chip     datasheet; None for the float twin
    graph    of the file
    codec    likewise
    program  whose operations are counted; for the float twin the one of chip `ideal`
    remarks  of the compiler, on where the chip departs from the file
    controller  what acts; with `trace` its network keeps spikes and membranes of the last step
    """

    def __init__(
        self,
        path: str,
        chip: str,
        sampled: bool = False,
        limits: bool = True,
        quantisation: Quantisation = PLAIN,
        faults: Faults = NONE,
        trace: bool = False,
        rows: Rows = "total",
        backend: BackendName = "numpy",
    ) -> None:
        artifact = load(path)
        if artifact.codec is None:
            raise ArtifactError(f"{path} has no codec, so it cannot drive a robot")
        self._artifact, self.graph, self.codec = artifact, artifact.graph, artifact.codec
        self.chip = chip_called(chip)
        self.controller = SpikingController(
            artifact,
            self.chip,
            rows,
            sampled,
            backend,
            faults=faults,
            trace=trace,
            limits=limits,
            quantisation=quantisation,
        )
        self.program = self.controller.program
        self.remarks = self.program.remarks
        self._before, self._hit_before = self.controller.ledger, self.controller.damage

    def reset(self, seed: int) -> None:
        """Start an episode and its ledger."""
        self.controller.reset(seed)
        self._before, self._hit_before = self.controller.ledger, self.controller.damage

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action (act,) or ()."""
        return self.controller.act(observation)

    def replay(self, observations: Floats) -> NDArray[Any]:
        """Actions (S, act) or (S,) for the observations (S, obs) of an episode, in their order."""
        if not self.controller.remembers:
            return self.controller.act_batch(observations)
        return np.stack([self.controller.act(observation) for observation in observations])

    @cached_property
    def cores(self) -> dict[str, int] | None:
        """Layer -> cores that `check` gives to it; None where nothing is known of the chip's."""
        if self.chip is None or self.chip.limits is None:
            return None
        found = design(self._artifact, self.chip, self.chip.limits).mapping
        placed = {each.name: each.cores for each in found.placements if each.kind == "neurons"}
        return placed if found.cores else None

    @property
    def damage(self) -> tuple[Damage, ...]:
        """What faults of the chip have hit, those over time since the last reset."""
        before = {damage.text: damage for damage in self._hit_before}
        return tuple(
            now.since(before[now.text]) if now.over_time and now.text in before else now
            for now in self.controller.damage
        )

    @property
    def ledger(self) -> Ledger:
        """Counts since the last reset, all inferences in one row."""
        return self.controller.ledger.since(self._before)


def describe(path: Path) -> Candidate:
    """The candidate in a NIR file, which must have a codec to act in a closed loop."""
    artifact = load(path)
    if artifact.codec is None:
        raise ArtifactError(
            f"{path} has no codec (observation to spikes, output to action), so it cannot drive a "
            "robot; `spikedeploy emulate` plays spikes into it"
        )
    (output,) = artifact.graph.outputs.values()
    origin = artifact.provenance
    return Candidate(
        path=str(path),
        name=path.stem,
        kind="snn",
        format=".nir",
        env=env_id(origin.env) if origin and origin.env else None,
        observed=artifact.codec.encoder.observed,
        actions=int(np.prod(output.output_type["output"])),
        chip=(origin.chip or None) if origin else None,
    )


def controller(
    candidate: Candidate, chip: str | None, env: gymnasium.Env[Any, Any], sampled: bool
) -> NirController:
    """The network on the chip, or its float twin."""
    return NirController(
        candidate.path,
        chip or FLOAT,
        sampled,
        candidate.limits,
        candidate.quantisation,
        candidate.faults,
        backend=candidate.backend,
    )


def costs(controller: NirController, played: Rollout) -> Costs:
    """Costs of the ledger of the episode, of the host beside it, and of the file and its size."""
    ledger, program = controller.ledger, controller.program
    graph, cores = controller.graph, controller.cores
    found = spiking_costs(ledger, program, controller.chip)
    placed = None if cores is None else placed_messages(ledger, program, cores)
    return replace(
        beside(found, _host_terms(controller, found)),
        dense=float(dense_products(graph) * ledger.timesteps / ledger.inferences),
        footprint=footprint(graph),
        footprint_packed=packed_bytes(program) if controller.chip else None,
        connection_sparsity=connection_sparsity(graph),
        messages_placed=placed,
        control_steps_late=program.control_steps_late(controller.codec.timesteps),
        messages_placed_j={} if placed is None else message_energies(placed),
    )


def _host_terms(controller: NirController, found: Costs) -> dict[str, dict[str, float | None]]:
    """Terms [J] of each table besides those of the chip; None where nothing prices one."""
    ledger, program = controller.ledger, controller.program
    encoder = encoding(controller.codec, found.input_spikes or 0.0)
    readout = reading_out(program, readout_acs(ledger, program), readout_macs(ledger, program))
    return {
        name: {"encoder": encoder, "readout": readout, "resets": resetting(program, table)}
        for name, table in TABLES.items()
    }
