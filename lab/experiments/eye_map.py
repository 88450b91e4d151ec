"""The map of kart-eye: control rates and shares of quiet at which spiking costs less.

Policies are run folders of kart-eye, of `spikedeploy train kart-eye-…`: those that the experiment
`kart-eye` has trained, or those that are named, at the levels that they are pruned to. Each drives
in every cell of the map, a control rate and a share of quiet, whose rate is that of its training,
or a higher one to which it is transferred (`vision`). A cell of a policy is a part of the
experiment, and a row for each way of a float network to save operations, or for each chip, a file
of its own.
Counts are kept and not energies, so that the page can be written again with other prices.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

from lab.experiments import DESIGNS
from lab.experiments.networks import constants
from lab.experiments.runner import Design, Part
from lab.experiments.training import Record, StoredRow
from lab.experiments.vision import (
    WAYS,
    CountedChipController,
    drive,
    held_at,
    make_controller,
    wait_longer,
)
from spikedeploy.envs.eye.batch import EyeOptions
from spikedeploy.reports.table import write_rows
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import differences
from spikedeploy.trainers.policies.vision import SpikingVisionPolicy, VisionPolicy
from spikedeploy.trainers.run_folder import LEVEL, RunFolder, existing_run, file_sha256, runs_in
from spikedeploy.trainers.sparse.config import SparseConfig

MAP: dict[str, Any] = DESIGNS["kart-eye-map"]
ENV = "kart-eye"
NOT_PRUNED = f"{LEVEL}{1e6:g}"  # the level of the recipes that is above all operations
COLUMNS = (
    "policy", "seed", "spiking", "way", "rate", "quiet", "driven_quiet", "trained_rate", "span",
    "episodes", "steps", "finished", "right", "crashed", "late", "events", "cells", "macs",
    "first_macs", "changed_macs", "conv_macs", "dense_macs", "first_dense_macs", "behind_weights",
    "memory_weights", "sent", "compared", "units", "first_units", "gates", "runs", "wait", "sop",
    "graded_sop", "bias_sop", "neuron_update", "one_state_update", "neuron_idle", "touched",
    "spike_in", "spike_out", "message", "saturation", "lost_spike", "constants", "neurons",
)  # fmt: skip


@dataclass(frozen=True)
class Checkpoint:
    """A policy: a checkpoint of a run.

    run    its folder
    level  name of the checkpoint
    """

    run: RunFolder
    level: str

    @cached_property
    def settings(self) -> Record:
        """The configuration of its training."""
        return self.run.settings()

    @property
    def name(self) -> str:
        """`kart-eye-cnn`, `kart-eye-cnn gru=32`, `kart-eye-cnn ops-30000 at 240 Hz`."""
        own = [text.split(".", 1)[1] for text in self.own_settings]
        level = [] if self.pruned_to in ("best", NOT_PRUNED) else [self.pruned_to]
        rate = [] if self.rate == EyeOptions.rate else [f"at {self.rate} Hz"]
        return " ".join([str(self.settings["recipe"]), *own, *level, *rate]).replace('"', "")

    @property
    def pruned_to(self) -> str:
        """The level, or where it is not pruned that of the run from which its training started."""
        start = str(self.settings.get("start") or "")
        if not start or self.level not in ("best", NOT_PRUNED):
            return self.level
        levels = RunFolder(self.run.path.parent / Path(start).name).levels  # runs move together
        return next(iter(levels.values()), self.level)

    @property
    def own_settings(self) -> list[str]:
        """Settings of the network that are not those of the recipe."""
        found = differences(self.run.config(SparseConfig))
        return [text for text in found if text.startswith("policy.")]

    @property
    def seed(self) -> int:
        """Seed of the training."""
        return int(self.settings["seed"])

    @property
    def rate(self) -> int:
        """Control rate [Hz] that it was trained at."""
        return int(self.settings["env"]["options"].get("rate", EyeOptions.rate))

    @property
    def weights(self) -> Path:
        """The file of the checkpoint."""
        return self.run.path / "checkpoints" / f"{self.level}.safetensors"

    @cached_property
    def policy(self) -> VisionPolicy:
        """The policy; ConfigError where it does not see by events."""
        policy = self.run.policy(self.level)
        if not isinstance(policy, VisionPolicy):
            raise ConfigError(
                f"{self.run.path} holds a {policy.kind}, which has no map; leave it out"
            )
        return policy

    @property
    def is_driven_in_all_ways(self) -> bool:
        """Whether it is the level of its run that is driven in all ways, and at higher rates."""
        levels = [Checkpoint(self.run, name) for name in self.run.levels.values()]  # fewest first
        listed = [each.level for each in levels if each.pruned_to in MAP["levels"]]
        return self.level in (listed or [each.level for each in levels] or [self.level])[:1]

    def ways(self, rate: int) -> list[str]:
        """Ways of a float network to save operations, or chips, at a control rate [Hz].

        What runs at the rate of its training, or less often, is derived (`hold`).
        """
        if isinstance(self.policy, SpikingVisionPolicy):
            chips = MAP["chips"][self.policy.neuron]
            gated = [f"{chip} {MAP['gate']}" for chip in chips if self.policy.neuron == "if"]
            return [*chips, *gated]
        ways = MAP["ways"] if self.is_driven_in_all_ways else MAP["ways"][:1]
        return [way for way in ways if WAYS[way].every in (1, *range(2, rate // self.rate))]


@dataclass(frozen=True)
class EyeMapDesign(Design):
    """The parts of the experiment.

    policies  run folders; where none is named, all in `runs` with networks of the recipes that
              designs.toml names
    """

    episodes: int = 32
    policies: Sequence[str] = ()

    NAME = "kart-eye-map"
    OPTIONS: ClassVar = {name: name for name in ("runs", "episodes", "policies", "quick")}
    QUICK: ClassVar = {"episodes": 2, "limit": 30}

    @classmethod
    def of(cls, options: Any) -> "EyeMapDesign":  # noqa: ANN401
        """The design of the options of a command."""
        named = [name for text in options.get("policies", ()) for name in text.split(",") if name]
        given = {**options, **({"policies": named} if named else {})}
        made: EyeMapDesign = super().of({"runs": str(Path("runs") / ENV), **given})
        return made

    @property
    def cells(self) -> list[tuple[int, float]]:
        """Control rate [Hz] and share of quiet that are driven; fewer in a quick trial."""
        rates = MAP["rates"][:: 2 if self.quick else 1]
        checked = [] if self.quick else [(rate, q) for rate, q in MAP["checked"]["cells"]]
        return sorted([(rate, quiet) for rate in rates for quiet in MAP["measured"]] + checked)

    def checkpoints(self) -> list[Checkpoint]:
        """All policies: of each run its levels, or where it has none its best."""
        named = [existing_run(name, self.runs) for name in self.policies]
        found = []
        for path in named or runs_in(Path(self.runs)):
            run = RunFolder(path)
            if not named and run.settings()["recipe"] not in MAP["recipes"]:
                continue
            if run.settings()["env"]["name"] != ENV:
                raise ConfigError(f"{path} is no training of {ENV}; leave it out")
            names = list(run.levels.values()) or ["best"]
            each = [Checkpoint(run, name) for name in names if run.checkpoint(name).is_file()]
            found += [c for c in each if named or not c.own_settings]
        return found

    def check(self, results: Path) -> None:
        """Refuse a map without policies."""
        if not self.checkpoints():
            raise ConfigError(
                f"{self.runs} has no run folder of {ENV}: train some with `spikedeploy train "
                f"kart-eye-cnn --runs {self.runs}`, or name them, --policies FOLDER"
            )

    def parts(self) -> list[Part]:
        """Each policy in each cell at the rate of its training, some at higher ones too."""
        found = []
        for checkpoint in self.checkpoints():
            for rate, quiet in self.cells:
                is_check = quiet not in MAP["measured"]
                if is_check and checkpoint.seed >= MAP["checked"]["seeds"]:
                    continue
                if self._drives(checkpoint, rate):
                    words = f"{checkpoint.name}-s{checkpoint.seed}-{rate}-q{quiet:g}"
                    name = re.sub("[^a-z0-9.]+", "-", words.lower())
                    found.append(Part(name, partial(self._rows, checkpoint, rate, quiet, name)))
        return found

    def _drives(self, checkpoint: Checkpoint, rate: int) -> bool:
        """Whether it does at a control rate; at the highest ones fewer do."""
        few = {} if self.quick or self.policies else MAP["fewer"].get(str(rate), {})
        is_left_out = few and (
            checkpoint.seed >= few["seeds"] or checkpoint.name not in few["policies"]
        )
        is_transferred = rate > checkpoint.rate and checkpoint.is_driven_in_all_ways
        return not is_left_out and (rate == checkpoint.rate or is_transferred)

    def _rows(self, checkpoint: Checkpoint, rate: int, quiet: float, name: str) -> list[StoredRow]:
        """The rows of a policy in a cell, one for each way or chip."""
        options = {**checkpoint.settings["env"]["options"], "rate": rate, "quiet": quiet}
        made = {
            "policy": file_sha256(checkpoint.weights), "episodes": self.episodes,
            "limit": self.limit, "options": options,
        }  # fmt: skip
        folder = Path(self.runs) / "evaluations" / name
        return [
            StoredRow(
                folder / f"{way.replace(' ', '-').replace(':', '-')}.json",
                {**made, "way": way},
                partial(self._evaluate, checkpoint, options, way),
                form={"policy": str, "way": str},
            )
            for way in checkpoint.ways(rate)
        ]

    def _evaluate(self, checkpoint: Checkpoint, options: Record, way: str) -> Record:
        slower, gated = (options["rate"] // rate for rate in (checkpoint.rate, EyeOptions.rate))
        controller = make_controller(checkpoint.policy, self.episodes, way, slower, gated)
        about: Record = {
            "policy": checkpoint.name, "seed": checkpoint.seed, "way": way,
            "rate": options["rate"], "quiet": options["quiet"], "driven_quiet": options["quiet"],
            "trained_rate": checkpoint.rate, "span": 1 / checkpoint.rate,
        }  # fmt: skip
        if isinstance(controller, CountedChipController):
            program = controller.program
            late = program.control_steps_late(1) or (0, 0)
            sizes = sum(layer.size for layer in program.layers)
            chip = {"constants": constants(program), "neurons": sizes}
            about |= {"spiking": True, "late": list(late), **chip}
        else:
            about |= {"spiking": False, "late": [0, 0]}
        return about | drive(options, controller, self.episodes, self.limit)[0]

    def all_rows(self) -> Iterator[Record]:
        """The results so far, and those that follow from them.

        Where a kart waits for longer, and where a policy runs at the rate of its training while
        actions are wanted at a higher one.
        """
        for row in self._with_longer_waits():
            yield row
            for rate in MAP["rates"]:
                if row["rate"] == row["trained_rate"] < rate:
                    yield hold(row, rate)

    def _with_longer_waits(self) -> Iterator[Record]:
        found = [row for part in self.parts() for row in part.found]
        driven = {self._place(row) for row in found}
        longest = max(MAP["measured"])
        for row in found:
            yield row
            for quiet in MAP["quiet"] if row["quiet"] == longest and "still" in row else ():
                longer = wait_longer(row, quiet)
                if quiet > longest and self._place(longer) not in driven:
                    yield longer

    @staticmethod
    def _place(row: Record) -> tuple[Any, ...]:
        return tuple(row[name] for name in ("policy", "seed", "way", "rate", "quiet"))

    def deviations(self) -> list[float]:
        """Operations of cells that were driven over those that follow from a shorter wait [1]."""
        found = {self._place(row): row for part in self.parts() for row in part.found}
        rows = []
        for row in found.values():
            shorter = found.get((*self._place(row)[:-1], max(MAP["measured"])))
            if row["quiet"] > max(MAP["measured"]) and shorter is not None:
                name = "sop" if row["spiking"] else "macs"
                rows.append(row[name] / wait_longer(shorter, row["quiet"])[name])
        return sorted(rows)

    def write(self, results: Path) -> list[Path]:
        """Write page, table and picture of the complete rows; return the files, the page first."""
        from lab.experiments.eye_map_page import write

        rows = list(self.all_rows())
        told = [{name: row.get(name) for name in COLUMNS} for row in rows]
        table = write_rows(told, COLUMNS, results / "kart-eye-map.csv")
        missing = sum(not part.is_done for part in self.parts())
        return [*write(rows, results, missing, self.limit, self.deviations()), table]


_OF_A_STEP = COLUMNS[COLUMNS.index("events") : COLUMNS.index("constants") + 1]


def hold(row: Record, rate: int) -> Record:
    """The row of a policy that runs as often as in a row, at a higher control rate [Hz].

    It sees the events of as many control steps together, and holds its action for as long: it
    drives the same way, as the physics have a rate of their own.
    """
    times = rate / row["rate"]
    each = {name: row[name] / times for name in _OF_A_STEP if row.get(name) is not None}
    return {
        **row,
        **each,
        "way": row["way"] + held_at(row["rate"]),
        "rate": rate,
        "late": [times * steps for steps in row["late"]],
        # an event waits for the end of the longer control step, and on average for half of it
        "wait": times * row.get("wait", 0.0) + (times - 1) / 2,
        "steps": round(times * row["steps"]),
    }
