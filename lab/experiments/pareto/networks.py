"""A policy of some level on a chip, or in few bits, for a batch of robots; and what it did."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from spikedeploy.exporters.to_nir import to_nir
from spikedeploy.exporters.to_onnx import to_onnx
from spikedeploy.policies import run_record
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.policies.run_record import SPIKING
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.codec.delta import DeltaEncoder
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import EVENTS
from spikedeploy.runtime.metadata import Provenance
from spikedeploy.shipping.export_run import kind_of
from spikedeploy.trainers.policies import Policy, PrunedMlpPolicy
from spikedeploy.trainers.policies.pruned_mlp import PrunedWeight
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.pool import BatchController, Stateless, Walk

Done = dict[str, float | None]


@dataclass(frozen=True)
class LevelNetwork:
    """A policy, ready to walk.

    controller  of B robots
    done        means per control step of what it did in episodes, given their walks; the
                controller must have walked them, and no others, in one batch
    """

    controller: BatchController
    done: Callable[[Sequence[Walk]], Done]


def network(run: Path, level: str, place: str, stem: Path) -> LevelNetwork:
    """The policy of a level of a run at a place (ParetoDesign.places), exported.

    level  name of a checkpoint
    stem   of the exported file, without a suffix

    Raises RuleError where the chip refuses it.
    """
    policy = RunFolder(run).policy(level)
    if policy.kind in SPIKING:
        path = stem.with_name(f"{stem.name}.nir")
        return _spiking(policy, run_record.origin(run, level), path, place)
    if isinstance(policy, PrunedMlpPolicy):
        rounded = in_bits(policy, int(place.removeprefix("int"))) if place != "float32" else policy
        path = stem.with_name(f"{stem.name}-{place}.onnx")
        return _float(rounded, run_record.origin(run, level), path)
    raise TypeError(f"{type(policy).__name__} is no policy that is pruned")


class _OnChip:
    """An artifact on a chip as a BatchController that keeps a row of counts for each robot."""

    def __init__(self, path: Path, place: str) -> None:
        self.artifact = load(path)
        self.spiking = SpikingController(self.artifact, chip(place), ledger="each")
        self.act_batch = self.spiking.act_batch

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self.spiking.reset(0)


def _spiking(policy: Policy, origin: Provenance, path: Path, place: str) -> LevelNetwork:
    path.parent.mkdir(parents=True, exist_ok=True)
    running = _OnChip(to_nir(policy, origin, path), place)
    return LevelNetwork(running, lambda walks: _counted(running, walks))


def _counted(running: _OnChip, walks: Sequence[Walk]) -> Done:
    """Means per control step; robots at their end keep their place in the batch, uncounted."""
    ledger, program = running.spiking.ledger, running.spiking.program
    lengths = np.array([len(walk.observation) for walk in walks])
    rows = ledger.counts.reshape(lengths.max(), len(walks), *ledger.counts.shape[1:])
    alive = np.arange(lengths.max())[:, None] < lengths
    counts = rows[alive].sum(axis=0) / lengths.sum()  # (L, E)
    per_step = dict(zip(EVENTS, counts.sum(axis=0).tolist(), strict=True))
    sent = dict(zip(ledger.layers, counts[:, EVENTS.index("spike_out")].tolist(), strict=True))
    updates = counts[:, EVENTS.index("neuron_update")]
    readouts = [name in ledger.readouts for name in ledger.layers]
    first = program.layers[0]
    others = sum(sent[s.source] for s in first.synapses if s.source != program.input)
    encoder = running.artifact.codec.encoder if running.artifact.codec else None
    used = int(np.isfinite(encoder.step).sum()) if isinstance(encoder, DeltaEncoder) else 0
    spiking = sum(layer.size for layer in program.spiking)
    several = ledger.several or not spiking
    return {
        "operations": per_step["sop"],
        "graded_operations": per_step["graded_sop"],
        "bias_operations": per_step["bias_sop"],
        "neurons": float(sum(ledger.neurons)),
        "neuron_updates": per_step["neuron_update"],
        "readout_updates": float(updates[readouts].sum()),
        "neuron_idle": per_step["neuron_idle"],
        "messages": per_step["message"],
        "events": float(counts[0, EVENTS.index("spike_in")]) - others,
        "spikes_out": per_step["spike_out"],
        "observations": float(used),
        "constants": float(_constants(program)),
        "on_host": float(sum(layer.size for layer in program.host)),
        "saturations": per_step["saturation"] * float(lengths.sum()),
        "sparsity": None if several else 1 - per_step["spike_out"] / spiking,
    }


def _constants(program: Program) -> int:
    """Numbers that the host adds to what leaves the chip."""
    if program.readout is not None:
        return int(program.readout.bias.size)
    return sum(outlet.bias.size for outlet in program.outlets)


def _float(policy: PrunedMlpPolicy, origin: Provenance, path: Path) -> LevelNetwork:
    path.parent.mkdir(parents=True, exist_ok=True)
    kind = kind_of(policy)
    running = OnnxController(to_onnx(policy, origin, path, kind))

    def done(walks: Sequence[Walk]) -> Done:
        seen = np.concatenate([walk.observation for walk in walks]).astype(np.float64)
        first, *others = (each.fan_out for each in policy.matrices.children() if _pruned(each))
        read = first + policy.past.fan_out if policy.skip else first
        hidden = sum(int(torch.count_nonzero(fan_out)) for fan_out in others)
        return {
            "operations": running.effective_macs(seen),
            "observations": float(torch.count_nonzero(read)),
            "constants": float(hidden + policy.actions),  # a bias of each unit
        }

    return LevelNetwork(Stateless(running.replay), done)


def _pruned(module: nn.Module) -> TypeGuard[PrunedWeight]:
    return isinstance(module, PrunedWeight)


def in_bits(policy: PrunedMlpPolicy, bits: int) -> PrunedMlpPolicy:
    """The policy with weights rounded to integers of so many bits, one scale a matrix.

    Scales are such that the largest weight fills the range, as on the chips; weights that are
    rounded to 0 cost no operations, as there.
    """
    largest = 2 ** (bits - 1) - 1
    for matrix in policy.modules():
        if isinstance(matrix, PrunedWeight) and matrix.weight.numel():
            weight = matrix().detach()
            scale = weight.abs().max().clamp(min=torch.finfo(weight.dtype).tiny) / largest
            steps = torch.round(weight / scale)
            matrix.weight.data = steps * scale
            matrix.mask.copy_(steps != 0)
    return policy


def outcomes(returns: Sequence[float], infos: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What episodes came to: scores are finishes (0 or 1) of karts, returns of walkers.

    Of karts the returns stand beside the scores.
    """
    found: dict[str, Any] = {"return_mean": float(np.mean(returns)), "scores": list(returns)}
    if "gates" not in infos[0]:
        return found | {"falls": float(np.mean([info["fall"] for info in infos]))}
    finished = [bool(info["finish"]) for info in infos]
    laps = [float(info["lap_time"]) for info in infos if info["finish"]]
    crashed = float(np.mean([bool(info["crash"]) for info in infos]))
    return found | {
        "scores": [float(each) for each in finished],
        "returns": list(returns),
        "lap_time": float(np.mean(laps)) if laps else None,
        "crashes": crashed,
    }


def greedy(act_all: Callable[[NDArray[np.float64]], NDArray[Any]], discrete: bool) -> Stateless:
    """A teacher as a controller: its actions, or the likeliest of its logits."""
    return Stateless((lambda seen: act_all(seen).argmax(-1)) if discrete else act_all)
