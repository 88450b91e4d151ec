"""NIR files: spiking policies, on an emulated chip or as their float twin.

A file of another tool says neither how observations become spikes nor how output becomes actions.
A codec in JSON beside it does, with the fields of `runtime.codec.codec.Codec`, and makes it a
policy (`adopt`):

    {"timesteps": 16, "squash": "argmax",
     "normaliser": {"mean": [0, 0], "std": [1, 2], "clip": 3},
     "encoder": {"kind": "rate", "mode": "regular", "low": [-1, -1], "high": [1, 1]}}
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import nir
import numpy as np
from numpy.typing import NDArray

from spikedeploy.console import say
from spikedeploy.envs.rollout import Rollout
from spikedeploy.evaluation_setup import Setup
from spikedeploy.outputs import check_output
from spikedeploy.policies.registry import (
    DEFAULT_CHIP,
    FLOAT,
    Candidate,
    Controller,
    Env,
    Floats,
    env_id,
)
from spikedeploy.runtime.artifact.artifact import Artifact, load, save
from spikedeploy.runtime.chips.chip import chip as datasheet
from spikedeploy.runtime.chips.damage import Damage
from spikedeploy.runtime.codec.codec import GIVE_CODEC, Codec
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.compiler.rules import place
from spikedeploy.runtime.copies import Copyable
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.emulator.ledger import Ledger, Rows
from spikedeploy.runtime.emulator.running_network import chip_or_float
from spikedeploy.runtime.errors import ArtifactError, ConfigError, SpikedeployError
from spikedeploy.runtime.files import read_json
from spikedeploy.runtime.graph.discretisation import SPIKING
from spikedeploy.runtime.metadata import Provenance, Record

if TYPE_CHECKING:
    from spikedeploy.policies.costs import Costs

_OPENED = 16  # files that are kept, so that a policy which is found and then played is read once
# of what `adopt` writes; which environment it is for is not known
_ADOPTED = Provenance("", recipe="run --from")


def read_policy(path: str | Path) -> Artifact:
    """The artifact of a file that can act in a closed loop; read once while the file stays."""
    try:
        found = Path(path).stat()
    except OSError:
        return load(path)
    return _read_policy(str(path), found.st_ino, found.st_size, found.st_mtime_ns)


@lru_cache(_OPENED)
def _read_policy(path: str, *identity: int) -> Artifact:
    artifact = load(path)
    if artifact.codec is None:
        raise ArtifactError(
            f"{path} has no codec (observation to spikes, output to action), so it cannot drive a "
            f"robot. {GIVE_CODEC}. `spikedeploy emulate` plays spikes into it as it is"
        )
    return artifact


class NirController(Copyable, Controller):
    """A spiking policy with a ledger for each episode; options are those of SpikingController.

    artifact: the file
    chip: datasheet; None for the float twin
    codec: codec of the file
    program: whose operations are counted; for the float twin the one of chip `ideal`
    remarks: remarks of the compiler, on where the chip departs from the file
    controller: what acts; with `trace` its network keeps spikes and membranes of the last step
    """

    def __init__(
        self,
        path: str | Path,
        chip: str,
        rows: Rows = "total",
        **options: Any,  # noqa: ANN401
    ) -> None:
        self.artifact, self.chip = read_policy(path), chip_or_float(chip)
        self.controller = SpikingController(self.artifact, self.chip, rows, **options)
        self.codec, self.program = self.controller.codec, self.controller.program
        self.remarks = self.program.remarks
        self._ledger_before: Ledger | None = None  # before the first episode
        self._damage_before: tuple[Damage, ...] = ()

    @classmethod
    def describe(cls, path: Path) -> Candidate:
        """The candidate in a NIR file, which must have a codec to act in a closed loop."""
        artifact = read_policy(path)
        assert artifact.codec is not None
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

    @classmethod
    def open(
        cls,
        candidate: Candidate,
        chip: str | None,
        env: Env,
        setup: Setup,
        trace: bool = False,
        rows: Rows = "total",
    ) -> "NirController":
        """Load the network on the chip, or its float twin, which has neither limits nor faults."""
        on_chip = {} if chip in (None, FLOAT) else {**setup.arguments(), "faults": setup.faults}
        return cls(
            candidate.path,
            chip or FLOAT,
            rows,
            sampled=setup.sampled,
            backend=setup.backend,
            trace=trace,
            **on_chip,
        )

    def reset(self, seed: int) -> None:
        """Start an episode and its ledger."""
        self.controller.reset(seed)
        self._ledger_before, self._damage_before = self.controller.ledger, self.controller.damage

    def act(self, observation: Floats) -> NDArray[Any]:
        """The action (act,) or ()."""
        return self.controller.act(observation)

    def replay(self, observations: Floats) -> NDArray[Any]:
        """Actions (S, act) or (S,) for the observations (S, obs) of an episode, in their order."""
        if not self.controller.remembers:
            return self.controller.act_batch(observations)
        return super().replay(observations)

    @cached_property
    def cores(self) -> dict[str, int] | None:
        """Layer -> cores that `check` gives to it; None where nothing is known of the chip's."""
        if self.chip is None or self.chip.limits is None:
            return None
        found = place(self.artifact, self.chip).mapping
        placed = {each.name: each.cores for each in found.placements if each.kind == "neurons"}
        return placed if found.cores else None

    @property
    def damage(self) -> tuple[Damage, ...]:  # type: ignore[override]
        """Damage by faults of the chip; by those over time, since the last reset."""
        before = {damage.text: damage for damage in self._damage_before}
        return tuple(
            now.since(before[now.text]) if now.over_time and now.text in before else now
            for now in self.controller.damage
        )

    @property
    def ledger(self) -> Ledger:
        """Counts since the last reset, all inferences in one row."""
        found, before = self.controller.ledger, self._ledger_before
        return found if before is None else found.since(before)

    def costs(self, played: Rollout) -> "Costs":
        """Costs of the ledger of the episode, of the host beside it, and of the file."""
        # after the first action, which is sooner without them
        from spikedeploy.policies.costs import policy_costs
        from spikedeploy.runtime.metrics.traffic import placed_messages

        ledger = self.ledger
        placed = None if self.cores is None else placed_messages(ledger, self.program, self.cores)
        return policy_costs(self.artifact, ledger, self.program, self.chip, placed)


def adopt(
    file: str,
    codec: Path | None,
    force: bool = False,
    check: Callable[[Artifact], object] = id,
    **convention: Any,  # noqa: ANN401
) -> Path:
    """Write FILE.policy.nir beside a file of another tool, and return it.

    codec: JSON file
    force: whether a file that this function did not write is replaced
    check: is called with the policy before anything is written, and raises where it is no use
    convention: written_by and options of artifact.load
    """
    path = Path(file)
    artifact = load(path, **convention)
    if codec is None:
        raise ConfigError(
            f"{file} says neither how observations become spikes nor how its output becomes "
            "actions: give --codec FILE.json; docs/own-network.md has one"
        )
    if artifact.codec is not None:
        raise ConfigError(f"{file} states its codec: leave --codec out")
    found, actions = read_codec(codec)
    try:
        policy = replace(artifact, codec=found, provenance=_ADOPTED)
    except ArtifactError as error:  # written by hand
        what = str(error).removesuffix(" Export the policy again.")
        raise ArtifactError(
            f"--codec {codec}: {what} Change the encoder, or give a network with "
            f"{found.encoder.width} inputs."
        ) from error
    if actions is not None:
        policy = _with_actions(policy, actions, f"--codec {codec}: actions")
    target = path.with_suffix(".policy.nir")
    check_output("--from", target, (file, codec), force, _is_adopted)
    check(policy)
    save(policy, target)
    say(f"{file}: {artifact.convention.describe()}")
    say(f"wrote {target}: a policy as any other")
    return target


def check_fits(chip: str | None, policy: Artifact, **on_chip: Any) -> None:  # noqa: ANN401
    """Raise the rule that a policy breaks on a chip; "float" has none."""
    if chip != FLOAT:
        compile_program(policy, datasheet(chip or DEFAULT_CHIP), **on_chip)


def _is_adopted(path: Path) -> bool:
    """Return True if a file is an earlier output of `adopt`."""
    try:
        found = load(path).provenance
    except SpikedeployError:
        return False
    return found is not None and (found.env, found.recipe) == (_ADOPTED.env, _ADOPTED.recipe)


def _with_actions(policy: Artifact, actions: Any, where: str) -> Artifact:  # noqa: ANN401
    """Return the policy whose output neurons' rates, 0 to 1, become actions from low to high.

    A readout of its own scales them, behind neurons that spike at most once in a timestep.

    actions: low and high (N,), of which -1 and 1 stand for the bounds of the environment's
    """
    graph = policy.graph
    (output,) = graph.outputs
    before = [source for source, target in graph.edges if target == output]
    neurons = int(np.prod(graph.outputs[output].output_type["output"]))
    spiking = all(isinstance(graph.nodes[name], SPIKING) for name in before) and len(before) == 1
    if not spiking or policy.convention.spikes == "many" or policy.sigma_delta:
        raise ConfigError(
            f"{where} scales output neurons that spike once in a timestep at most, and the output "
            f"hears {', '.join(sorted(before))}. Without it, scores are actions"
        )
    if policy.codec is None or policy.codec.squash != "none":
        raise ConfigError(f"{where} needs squash 'none': what it gives are the actions")
    try:
        low, high = np.array([actions["low"], actions["high"]], np.float64)
        sound = low.shape == (neurons,) and (low >= -1).all() and (high <= 1).all()
    except (TypeError, KeyError, ValueError):
        sound = False
    if not sound or not (low < high).all():
        raise ArtifactError(
            f'{where} must be {{"low": […], "high": […]}}, from -1 to 1, low below high, a number '
            f"of each for the network's {neurons} output neurons"
        )
    name = "actions"
    while name in graph.nodes:
        name += "_"
    readout = nir.Affine(np.diag(high - low), low)
    edges = [edge for edge in graph.edges if edge[1] != output]
    edges += [(before[0], name), (name, output)]
    wider = nir.NIRGraph(
        {**graph.nodes, name: readout}, edges, metadata=graph.metadata, type_check=False
    )
    return replace(policy, graph=wider)


def read_codec(path: Path) -> tuple[Codec, Any]:
    """Return the codec in a JSON file, and its `actions`, or None."""
    try:
        record = read_json(path, "docs/own-network.md has a whole one")
        actions = record.pop("actions", None)
        return Codec.from_record(Record(_with_arrays(record), str(path))), actions
    except (ConfigError, ArtifactError, ValueError, OverflowError) as error:
        # ValueError: lists of different lengths
        found = str(error).removesuffix(". Export the policy again.")  # written by hand
        raise ArtifactError(f"--codec {found}; docs/own-network.md has a whole one") from error


def _with_arrays(value: Any) -> Any:  # noqa: ANN401
    """Return JSON with arrays for lists."""
    if isinstance(value, dict):
        return {name: _with_arrays(each) for name, each in value.items()}
    return np.asarray(value) if isinstance(value, list) else value
