"""The kart experiment: trainings from scratch in three worlds, and what drives them.

A preset is what a policy learns from: `default` is this project's observation, reward and settings
of PPO, `classic` kart-simulator's, `corridor` the default ones on corridors that are drawn anew in
each episode. With every preset and seed four policies are trained in each world: the float network,
the spiking one, and two controls, a float network of the spiking one's size and a linear policy.
With the scripts, all are evaluated on the same starts, which no training used, and on every track,
most of which they were not trained on.

kart-simulator's own figures are from its README's table: its best runs, one seed each. Its first
finishes on Grid and Steer follow from the steps per finish that it implies.
"""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lab.experiments import QUICK
from lab.experiments.networks import evaluate, play
from lab.experiments.runner import Design, Part
from lab.experiments.training import Record, StoredRow, TrainingJob, counters, results
from spikedeploy import envs, zoo
from spikedeploy.envs.kart.gap import GapDriver
from spikedeploy.jobs.pool import cores
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.policies.run_record import checked_record
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.runtime.files import read_json, replacing
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig, amend
from spikedeploy.trainers.metrics import read
from spikedeploy.trainers.ppo import HOLDS
from spikedeploy.trainers.run_folder import load_policy
from spikedeploy.trainers.sparse.pool import BatchController, Stateless

WORLDS = ("kart-grid", "kart-gazebo", "kart-steer")
NETWORKS = ("ann", "snn")
CONTROLS = ("small", "linear")
POLICIES = (*NETWORKS, *CONTROLS)
DEFAULT, CLASSIC, CORRIDOR = "default", "classic", "corridor"
LEARNING = (DEFAULT, CLASSIC)  # presets on big_S, as kart-simulator's
PRESETS = (*LEARNING, CORRIDOR)
COUNT = 300  # finishes of training, as kart-simulator's table has it
GREEDY = 0.95  # share of greedy validation episodes that must finish
# corridors of the length that is trained on, then longer ones; every start draws another
TRACKS = (
    "corridor-8", "corridor-24", "room_1", "room_2", "room_3", "small_S", "circuit", "big_S",
)  # fmt: skip
# trained on by no policy; `corridor-8` and `big_S` are, each by some
UNSEEN = tuple(track for track in TRACKS if track not in ("corridor-8", "big_S"))
# networks before controls; what the page begins with comes first
_ORDER = (
    (DEFAULT, NETWORKS), (DEFAULT, CONTROLS), (CORRIDOR, NETWORKS), (CLASSIC, ("ann",)),
    (CLASSIC, ("snn",)), (CORRIDOR, CONTROLS), (CLASSIC, CONTROLS),
)  # fmt: skip
_VALIDATION = ("validation.every=10000", "validation.episodes=20")  # shares in steps of 5 %
FIRST, NTH = "first_finish", f"finish_{COUNT}"
HELD = f"greedy_{GREEDY:.0%}".removesuffix("%")
Steps = NDArray[np.float64]


@dataclass(frozen=True)
class KartTraining(TrainingJob):
    """A training, exported, and evaluated on starts and tracks of its own.

    A run of other limits is found, too, and goes on where a limit was raised.

    preset, world, policy  as in its rows
    episodes               of the evaluation, greedy, from seed EVALUATION up
    chip                   on which a spiking policy is evaluated, beside its float twin
    """

    preset: str = DEFAULT
    world: str = ""
    policy: str = ""
    episodes: int = 100
    chip: str = "loihi1"

    @property
    def config(self) -> Any:  # noqa: ANN401
        """The configuration of the training, with the limits of the design."""
        found = super().config
        return amend(found, overrides=self.overrides) if self.run else found

    def _is_finished(self, run: Path) -> bool:
        """Return whether all limits of the training are reached, or the budget is spent."""
        found, config = counters(run), self.config
        if not found:
            return False
        with checked_record(run / "checkpoints" / "last.json"):
            enough = config.reached(found["finishes"], found.get("held", 0))
            return enough or bool(found["env_steps"] >= config.steps)

    @property
    def run(self) -> Path | None:
        """Its run folder; there is one."""
        files = Path(self.folder).glob(f"{self.recipe}-s{self.seed}-*/config.json")
        return next((f.parent for f in sorted(files) if self._is_of(read_json(f))), None)

    def _train(self, run: Path | None) -> None:
        from spikedeploy.trainers import train

        settings: dict[str, Any] = {"resume": run} if run else {"seed": self.seed}
        train.train(self.recipe, overrides=self.overrides, runs=self.folder, quiet=True, **settings)

    @property
    def env_steps(self) -> int:
        """Environment steps at the last checkpoint."""
        return int(counters(self.run)["env_steps"]) if self.run else 0

    @property
    def finishes(self) -> Steps:
        """Environment steps (n,) at the end of each finished episode of training, in order."""
        if self.run is None:
            return np.empty(0)
        rows = read(self._table("episodes.csv"))
        found = np.sort([row["env_steps"] for row in rows if row.get("finish")])
        counted = counters(self.run).get("finishes", 0)
        if len(found) != counted and self.is_trained:
            raise ConfigError(
                f"{self.run}/episodes.csv is damaged: it has {len(found)} finishes of {counted}. "
                "Put it back, or train again."
            )
        return found

    def steps_to_greedy(self, share: float) -> float:
        """Environment steps to the first validation in which `share` of greedy episodes finish.

        It counts only if the next one says so, too, or if there is none. Infinite where none is.
        """
        rows = read(self._table("metrics.csv")) if self.run else []
        found = [row for row in rows if "eval_finish" in row]
        enough = [row["eval_finish"] >= share for row in found]
        held = (row for k, row in enumerate(found) if all(enough[k : k + HOLDS]))
        return next((row["env_steps"] for row in held), math.inf)

    def _table(self, name: str) -> Path:
        """A table of the run folder."""
        path = (self.run or Path()) / name
        if not path.is_file():
            raise ConfigError(f"{path} is missing: put it back, or train again")
        return path

    def stored(self) -> list[StoredRow]:
        """The evaluation, made with the steps, episodes and chip that it must have been."""
        steps = counters(self.run).get("env_steps") if self.run else None
        made = {"env_steps": steps, "episodes": self.episodes, "chip": self.chip}
        trial = {"recipe": self.recipe, "seed": self.seed}
        file = (self.run or Path()) / "evaluation.json"
        form = {"parameters": int, "rows": [{}]}
        return [StoredRow(file, made, self._evaluate, {"trial": trial}, "", form)]

    @property
    def evaluation(self) -> Record | None:
        """The evaluation; None where it is missing, or was made with other steps or episodes."""
        return next(results(self.stored() if self.is_trained else ()), None)

    def _evaluate(self) -> Record:
        """Export the policy and evaluate it, a spiking one also on its chip."""
        from spikedeploy.shipping.export_run import export_run

        run, config = self.existing_run, self.config
        exported = export_run(str(run), "onnx" if config.policy.kind == "mlp" else "nir")
        if failed := [check.name for check in exported.checks if not check.passed]:
            raise SpikedeployError(
                f"{exported.path} does not do what {run} does: {', '.join(failed)}"
            )
        world, file = config.env, str(exported.path)
        return {
            "parameters": sum(weights.numel() for weights in load_policy(run).parameters()),
            "rows": evaluate(world.name, world.options, file, self.episodes, self.chip),
        }

    # on every track

    @property
    def exported(self) -> Path | None:
        """The exported policy; None where it is missing or not complete."""
        if self.run is None or self.evaluation is None:
            return None
        files = (self.run / f"policy{ending}" for ending in (".onnx", ".nir"))
        return next((file for file in files if file.is_file()), None)

    def tracks(self, starts: int) -> list[StoredRow]:
        """The finishes on all tracks."""
        file = self.exported
        made = {"policy": file and zoo.sha256(file), "chip": self.chip}
        return [_track_row((self.run or Path()) / "tracks.json", self, starts, made)]

    @property
    def options(self) -> Mapping[str, Any]:
        """Those of the environment that it was trained in."""
        found: Mapping[str, Any] = self.config.env.options
        return found

    def driver(self, options: Mapping[str, Any]) -> BatchController:
        """The exported policy, for a batch of karts; what it observes stays as in its training."""
        file = str(self.exported)
        if file.endswith(".onnx"):
            return Stateless(OnnxController(file).replay)
        spiking = SpikingController(load(file), chip(self.chip), "none")
        spiking.reset(EVALUATION)
        return Stateless(spiking.act_batch)  # membranes start every control step at zero


@dataclass(frozen=True)
class Script:
    """A built-in policy in a world.

    policy    "random" or "gap"
    folder    where <world>-<policy>.json is written
    episodes  as in KartTraining
    """

    world: str
    policy: str
    folder: str
    episodes: int

    preset: ClassVar[str] = DEFAULT
    seed: ClassVar[None] = None
    options: ClassVar[Mapping[str, Any]] = {}

    @property
    def name(self) -> str:
        """`kart-grid-gap`."""
        return f"{self.world}-{self.policy}"

    def stored(self) -> list[StoredRow]:
        """The evaluation."""
        file = Path(self.folder) / f"{self.name}.json"
        made = {"episodes": self.episodes}
        return [StoredRow(file, made, self._evaluate, under="", form={"rows": [{}]})]

    @property
    def evaluation(self) -> Record | None:
        """The evaluation; None where it is missing, or has another number of episodes."""
        return next(results(self.stored()), None)

    def _evaluate(self) -> Record:
        return {"rows": evaluate(self.world, {}, self.policy, self.episodes, None)}

    def tracks(self, starts: int) -> list[StoredRow]:
        """The finishes on all tracks."""
        return [_track_row(Path(self.folder) / f"{self.name}-tracks.json", self, starts, {})]

    def driver(self, options: Mapping[str, Any]) -> BatchController:
        """The script, for a batch of karts."""
        env = envs.make(self.world, **options)
        if self.policy == "gap":
            gap = GapDriver.of(env)
            return Stateless(lambda seen: np.array([gap.act(each) for each in seen]))
        env.action_space.seed(EVALUATION)
        return Stateless(lambda seen: np.array([env.action_space.sample() for _ in seen]))


def _track_row(file: Path, driver: KartTraining | Script, starts: int, more: Record) -> StoredRow:
    """Track -> whether each episode of a driver finished (n,)."""

    def finished(track: str) -> list[int]:
        options = {**driver.options, "track": track}
        config = EnvConfig(name=driver.world, options=options)
        return [int(i["finish"]) for i in play(config, starts, driver.driver(options)).infos]

    made = {"tracks": list(TRACKS), "starts": starts, "first_seed": EVALUATION, **more}
    form = {track: [int] for track in TRACKS}
    return StoredRow(file, made, lambda: {track: finished(track) for track in TRACKS}, form=form)


@dataclass(frozen=True)
class KartDesign(Design):
    """The parts of the experiment.

    seeds     trainings of each network
    controls  trainings of each control
    finishes  after which a training ends; 0 for never, or for COUNT with the classic preset
    starts    of every policy on each held-out track
    """

    seeds: int = 5
    controls: int = 5
    runs: str = "runs/experiment-kart"
    finishes: int = 0
    starts: int = 50

    NAME = "kart"
    OPTIONS: ClassVar = Design.OPTIONS | {"controls": "controls", "finishes": "finishes"}
    QUICK: ClassVar = {"seeds": 1, "controls": 1, "episodes": 2, "starts": 2}
    JOBS: ClassVar = cores()

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Any:  # noqa: ANN401
        """The design of the options."""
        usual = {} if options.get("quick") else {"runs": cls.runs}
        return super().of({**usual, **options})

    def trainings(self) -> list[KartTraining]:
        """All trainings, seed by seed, so that results of every world come early."""
        return [
            self._training(preset, world, policy, seed)
            for preset, policies in _ORDER
            for seed in range(self.controls if policies == CONTROLS else self.seeds)
            for world in WORLDS
            for policy in policies
        ]

    def _training(self, preset: str, world: str, policy: str, seed: int) -> KartTraining:
        """With the classic preset only learning counts, in kart-simulator's metric, which ends it.

        `--set stop_at_greedy=0.95` goes on until greedy episodes finish, too.
        """
        recipe = f"{world}-{policy}" if preset == DEFAULT else f"{world}-{preset}-{policy}"
        enough = self.finishes or (COUNT if preset == CLASSIC else 0)
        quick = QUICK["kart"] if self.quick else ()
        overrides = (*_VALIDATION, f"stop_at_finishes={enough}", *quick, *self.settings)
        return KartTraining(
            f"{recipe}-s{seed}", recipe, seed, self.runs, overrides, preset=preset, world=world,
            policy=policy, episodes=self.episodes, chip=self.chip,
        )  # fmt: skip

    def scripts(self) -> list[Script]:
        """All evaluations of built-in policies on big_S."""
        return [
            Script(world, player, self.runs, self.episodes)
            for world in WORLDS
            for player in envs.spec(world).controls
        ]

    def drivers(self) -> list[KartTraining | Script]:
        """All that drive on all tracks: scripts, and what was trained on one or many."""
        return [*self.scripts(), *(each for each in self.trainings() if each.preset != CLASSIC)]

    def parts(self) -> list[Part]:
        """All parts, the short evaluations first."""
        return [
            *(Part(script.name, script.stored) for script in self.scripts()),
            *(Part(each.name, each.stored, each) for each in self.trainings()),
            *(
                Part(
                    f"{each.name}-tracks", partial(each.tracks, self.starts),
                    of=None if isinstance(each, Script) else each, after=[each.name],
                )
                for each in self.drivers()
            ),
        ]  # fmt: skip

    def check(self, results: Path) -> None:
        """Refuse unknown settings, and to write over rows that the new tables would not have."""
        if count := count_lost(self, results / "kart"):
            raise ConfigError(
                f"the tables of {results / 'kart.md'} have {count} rows that new ones would not, "
                f"of trainings that are not in {self.runs} or were not asked for. Name another "
                f"folder with -o; or `python -m lab kart-trainings unpack --runs {self.runs}` puts "
                "this project's trainings there."
            )
        super().check(results)

    def write(self, results: Path) -> list[Path]:
        """Write page, tables and picture of the complete parts; return the files."""
        from lab.experiments.kart_page import write

        return write(self, results)


# results, a record for each training and each evaluation, also as CSV


def learning(design: KartDesign) -> list[Record]:
    """A record for each complete training: steps to the first and 300th finish, and greedily."""
    found = []
    for training in (each for each in design.trainings() if each.is_trained):
        ends = training.finishes.tolist()
        found.append(
            {
                **_identity(training),
                "env_steps": training.env_steps,
                "finishes": len(ends),
                FIRST: float(ends[0]) if ends else math.inf,
                NTH: float(ends[COUNT - 1]) if len(ends) >= COUNT else math.inf,
                HELD: training.steps_to_greedy(GREEDY),
            }
        )
    return found


def each_finish(design: KartDesign) -> list[Record]:
    """A record for each finish of each complete training on big_S, up to COUNT."""
    return [
        {"recipe": t.recipe, "seed": t.seed, "finish": n, "env_steps": steps}
        for t in design.trainings()
        if t.is_trained and t.preset in LEARNING
        for n, steps in enumerate(map(int, t.finishes[:COUNT]), start=1)
    ]


def count_lost(design: KartDesign, folder: Path) -> int:
    """The number of rows of earlier tables that are not among those of the design.

    folder  of learning.csv, driving.csv and tracks.csv
    """
    made = {"learning": _trained, "driving": driving, "tracks": heldout}
    return sum(
        len(_keys(_read_csv(table)) - _keys(records(design)))
        for name, records in made.items()
        if (table := folder / f"{name}.csv").is_file()
    )


def _trained(design: KartDesign) -> list[Record]:
    """Complete trainings; their episodes, which are many, are not read."""
    return [_identity(training) for training in design.trainings() if training.is_trained]


def _keys(rows: Iterable[Mapping[str, Any]]) -> set[tuple[str, ...]]:
    """Keys of the rows of a table, as they stand in it."""
    names = ("world", "preset", "policy", "seed", "chip", "track")
    return {tuple("" if row.get(n) is None else str(row[n]) for n in names) for row in rows}


def _read_csv(table: Path) -> list[dict[str, str]]:
    try:
        with table.open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"{table} is damaged ({error}): put it back, or move it away") from error


_FIELDS = (
    "chip", "episodes", "success_rate", "lap_time", "crashes", "stalls", "gates", "return_mean",
    "success_difference_mean", "actions_equal", "sparsity", "spikes_per_inference",
    "sops_per_inference", "effective_macs", "macs_dense",
)  # fmt: skip


def driving(design: KartDesign) -> list[Record]:
    """A record for each row of each complete evaluation."""
    found = []
    drivers: list[KartTraining | Script] = [*design.trainings(), *design.scripts()]
    for part in drivers:
        if (evaluation := part.evaluation) is not None:
            with checked_record(part.stored()[0].file):
                about = _identity(part) | {"parameters": None}
                if not isinstance(part, Script):
                    about["parameters"] = evaluation["parameters"]
                found += [about | _driven(row) for row in evaluation["rows"]]
    return found


def _driven(row: Mapping[str, Any]) -> Record:
    energies, bounds = row["energy_per_inference_j"], row.get("energy_interval_j", {})
    spikes = row.get("sops_per_inference") is not None
    lower = [n for n, joules in energies.items() if not spikes and bounds.get(n) == [joules, None]]
    return {
        **{field: row.get(field) for field in _FIELDS},
        "energies_at_least": " ".join(lower),
        **{f"energy_{table}_j": joules for table, joules in energies.items()},
    }


def heldout(design: KartDesign) -> list[Record]:
    """A record for each driver and track; `finished` (n,) of its starts."""
    return [
        {
            **_identity(driver),
            "chip": getattr(driver, "chip", None) if driver.policy == "snn" else None,
            "track": track,
            "unseen": track in UNSEEN,
            "finished": each,
        }
        for driver in design.drivers()
        for found in results(driver.tracks(design.starts))
        for track, each in found.items()
    ]


def _identity(part: KartTraining | Script) -> Record:
    return {name: getattr(part, name) for name in ("world", "preset", "policy", "seed")}


def write_csv(rows: Sequence[Record], path: Path) -> Path:
    """Write the rows; missing fields stay empty, and finished episodes are a row of 1 and 0."""

    def cell(value: object) -> object:
        if isinstance(value, list):
            return "".join(map(str, value))
        return f"{value:.10g}" if isinstance(value, float) else value

    names = list(dict.fromkeys(name for row in rows for name in row))
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows({name: cell(value) for name, value in row.items()} for row in rows)
    return path


# kart-simulator's thousands of environment steps, by its README: policy -> to the first finish of
# training, and to the 300th
PEERS: dict[str, dict[str, tuple[int, int]]] = {
    "kart-grid": {"ann": (141, 402), "snn": (175, 406)},
    "kart-gazebo": {"ann": (82, 431), "snn": (22, 507)},
    "kart-steer": {"ann": (156, 724), "snn": (441, 957)},
}
