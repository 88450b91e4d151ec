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

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lab.experiments.networks import evaluate, play
from lab.experiments.runner import Design, Part
from lab.experiments.training import Record, StoredRow, TrainingJob, counters
from spikedeploy import envs, zoo
from spikedeploy.envs.kart.gap import GapDriver
from spikedeploy.files import as_text, read_json, write_text
from spikedeploy.jobs.pool import cores
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.policies.run_record import checked_record
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError, SpikedeployError
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig, amended
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
_QUICK = (
    "steps=64", "horizon=32", "env.count=2", "epochs=1", "minibatch=32", "critic_hidden=[8]",
    "validation.every=64", "validation.episodes=2", "validation.limit=10", "checkpoint_every=64",
)  # fmt: skip
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
        return amended(found, overrides=self.overrides) if self.run else found

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

    @property
    def file(self) -> Path:
        """The file with the evaluation."""
        return (self.run or Path()) / "evaluation.json"

    @property
    def evaluation(self) -> Record | None:
        """The evaluation; None where it is missing, or was made with other steps or episodes."""
        if self.run is None or not self.file.is_file() or not self.is_trained:
            return None
        found, trial = read_json(self.file), {"recipe": self.recipe, "seed": self.seed}
        made = found.get("of"), found.get("trial")
        return found if made == (self.evaluated_with, trial) else None

    @property
    def evaluated_with(self) -> Record:
        """The steps, episodes and chip that an evaluation must have been made with."""
        steps = counters(self.run).get("env_steps") if self.run else None
        return {"env_steps": steps, "episodes": self.episodes, "chip": self.chip}

    @property
    def is_done(self) -> bool:
        """Return whether it is trained and evaluated."""
        return self.evaluation is not None

    def perform(self) -> bool:
        """Train, export and evaluate, as far as it is missing; False if it was interrupted."""
        if not self.complete():
            return False
        if not self.is_done:
            self._evaluate()
        return True

    def _evaluate(self) -> None:
        """Export the policy and evaluate it, a spiking one also on its chip."""
        from spikedeploy.shipping.export_run import export_run

        run, config = self.run, self.config
        assert run is not None
        exported = export_run(str(run), "onnx" if config.policy.kind == "mlp" else "nir")
        if failed := [check.name for check in exported.checks if not check.passed]:
            raise SpikedeployError(
                f"{exported.path} does not do what {run} does: {', '.join(failed)}"
            )
        world, file = config.env, str(exported.path)
        found = {
            "of": self.evaluated_with,
            "trial": {"recipe": self.recipe, "seed": self.seed},
            "parameters": sum(weights.numel() for weights in load_policy(run).parameters()),
            "rows": evaluate(world.name, world.options, file, self.episodes, self.chip),
        }
        write_text(self.file, as_text(found))

    # on every track

    @property
    def exported(self) -> Path | None:
        """The exported policy; None where it is missing or not complete."""
        if self.run is None or not self.is_done:
            return None
        files = (self.run / f"policy{ending}" for ending in (".onnx", ".nir"))
        return next((file for file in files if file.is_file()), None)

    def tracks(self, starts: int) -> StoredRow | None:
        """The finishes on all tracks; None before the training is complete."""
        file = self.exported
        if file is None or self.run is None:
            return None
        digest = zoo.sha256(file)
        made = _tracks_made(starts) | {"policy": digest, "chip": self.chip}
        return StoredRow(self.run / "tracks.json", made)

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

    options: ClassVar[Mapping[str, Any]] = {}

    @property
    def name(self) -> str:
        """`kart-grid-gap`."""
        return f"{self.world}-{self.policy}"

    @property
    def file(self) -> Path:
        """The file with the evaluation."""
        return Path(self.folder) / f"{self.name}.json"

    @property
    def evaluation(self) -> Record | None:
        """The evaluation; None where it is missing, or has another number of episodes."""
        found = read_json(self.file) if self.file.is_file() else {}
        return found if found.get("of") == {"episodes": self.episodes} else None

    @property
    def is_done(self) -> bool:
        """Return whether it is evaluated."""
        return self.evaluation is not None

    def perform(self) -> None:
        """Evaluate it."""
        rows = evaluate(self.world, {}, self.policy, self.episodes, None)
        write_text(self.file, as_text({"of": {"episodes": self.episodes}, "rows": rows}))

    def tracks(self, starts: int) -> StoredRow:
        """The finishes on all tracks."""
        return StoredRow(Path(self.folder) / f"{self.name}-tracks.json", _tracks_made(starts))

    def driver(self, options: Mapping[str, Any]) -> BatchController:
        """The script, for a batch of karts."""
        env = envs.make(self.world, **options)
        if self.policy == "gap":
            gap = GapDriver.of(env)
            return Stateless(lambda seen: np.array([gap.act(each) for each in seen]))
        env.action_space.seed(EVALUATION)
        return Stateless(lambda seen: np.array([env.action_space.sample() for _ in seen]))


def _tracks_made(starts: int) -> Record:
    return {"tracks": list(TRACKS), "starts": starts, "first_seed": EVALUATION}


def read_tracks(driver: KartTraining | Script, starts: int) -> Mapping[str, list[int]] | None:
    """Track -> whether each episode finished; None where an evaluation is missing."""
    row = driver.tracks(starts)
    return row.found if row else None


def drive_tracks(driver: KartTraining | Script, starts: int) -> bool:
    """Evaluate a driver on all tracks; False where its training is not complete."""
    row = driver.tracks(starts)
    if row is None:
        return False
    row.write({track: _finished(driver, track, starts) for track in TRACKS})
    return True


def _finished(driver: KartTraining | Script, track: str, starts: int) -> list[int]:
    """Return whether each episode on a track finished."""
    options = {**driver.options, "track": track}
    config = EnvConfig(name=driver.world, options=options)
    played = play(config, starts, driver.driver(options))
    return [int(info["finish"]) for info in played.infos]


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
        recipe = f"{world}-{policy}" if preset == DEFAULT else f"{world}-{preset}-{policy}"
        return KartTraining(
            f"{recipe}-s{seed}", recipe, seed, self.runs, self.overrides(preset), preset=preset,
            world=world, policy=policy, episodes=self.episodes, chip=self.chip,
        )  # fmt: skip

    def overrides(self, preset: str) -> tuple[str, ...]:
        """Settings of the trainings of a preset.

        With the classic preset only learning counts, in kart-simulator's metric: with that it ends.
        `--set stop_at_greedy=0.95` goes on until greedy episodes finish, too.
        """
        enough = self.finishes or (COUNT if preset == CLASSIC else 0)
        quick = _QUICK if self.quick else ()
        return (*_VALIDATION, f"stop_at_finishes={enough}", *quick, *self.settings)

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
        scripts = [Part(s.name, partial(_is_done, s), s.perform) for s in self.scripts()]
        trained = [Part(t.name, partial(_is_done, t), t.perform, (), t) for t in self.trainings()]
        tracks = [
            Part(
                f"{each.name}-tracks",
                partial(self._has_tracks, each),
                partial(drive_tracks, each, self.starts),
                [each.name],
            )
            for each in self.drivers()
        ]
        return [*scripts, *trained, *tracks]

    def _has_tracks(self, driver: KartTraining | Script) -> bool:
        return read_tracks(driver, self.starts) is not None

    def check(self, results: Path) -> None:
        """Refuse unknown settings, and to write over rows that the new tables would not have."""
        from lab.experiments.kart_results import count_lost

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


def _is_done(part: KartTraining | Script) -> bool:
    return part.is_done


@dataclass(frozen=True)
class _Peer:
    """Steps of its networks in one world, in thousands of environment steps.

    first  policy -> to the first finish of training
    nth    policy -> to the 300th
    """

    first: Mapping[str, int]
    nth: Mapping[str, int]

    @property
    def share(self) -> float:
        """Steps of the ANN / steps of the SNN."""
        return self.nth["ann"] / self.nth["snn"]


PEERS = {
    "kart-grid": _Peer({"ann": 141, "snn": 175}, {"ann": 402, "snn": 406}),
    "kart-gazebo": _Peer({"ann": 82, "snn": 22}, {"ann": 431, "snn": 507}),
    "kart-steer": _Peer({"ann": 156, "snn": 441}, {"ann": 724, "snn": 957}),
}
