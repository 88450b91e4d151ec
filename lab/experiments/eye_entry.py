"""The entry test of kart-eye: a world that needs a network that sees, or one that a grid drives.

Linear policies, MLPs and GRUs on event counts that are summed over a grid, and float convolutions
with a GRU, are trained by one recipe: the same walks of the privileged teacher, as many updates, as
many walks of their own. What each has is a row of designs.toml. So are spiking policies, which
begin with the convolutions of the float policy of their seed, and drive on emulated chips. Each
training is evaluated on signs and corridors that no training saw; a row is a file in
<runs>/evaluations, which says what it was made with. Rows of trainings that are not here stay in
the table.
"""

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lab.experiments import DESIGNS, QUICK, pages
from lab.experiments.eye_map import NOT_PRUNED
from lab.experiments.pages import grouped, mean, releases, versions_at_start, versions_text
from lab.experiments.runner import Design, Part, command_line
from lab.experiments.training import Record, StoredRow, TrainingJob, read_rows, write_exactly
from lab.experiments.vision import FIRST_SEED, drive, make_controller
from spikedeploy import zoo
from spikedeploy.comparison.statistics import Estimate, nested_ratio, share, stratified_bootstrap
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import read_json
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.policies.vision import SIGNS
from spikedeploy.trainers.run_folder import LEVEL, RunFolder
from spikedeploy.trainers.sparse.controllers import FloatController
from spikedeploy.trainers.sparse.pool import BatchController, Stateless
from spikedeploy.trainers.sparse.vision import EyeEpisodes

_BESIDE = "cnn"  # the network whose finishes are 100 %
TEACHER = "teacher"  # drives by what the simulation knows, and is no training
MOST_OF_GRIDS, LEAST_RIGHT, LEAST_FINISHED = 0.75, 0.95, 0.90  # what the test asks for
_ROWS: Mapping[str, Mapping[str, Any]] = DESIGNS["kart-eye"]["networks"]
_WALKS: Mapping[str, Mapping[str, Any]] = DESIGNS["kart-eye"]["walks"]
_STARTS: Mapping[str, Any] = DESIGNS["kart-eye"]["starts"]  # how trainings go on from others
_FROM_NOTHING: Mapping[str, Any] = {"walks": "walks", "settings": []}
_TABLE = "kart-eye.csv"
_VERSION = 1  # of what a row holds; a higher one makes all rows again
_FORM = {"network": str}  # of a row
_TEXT = ("network", "level", "way", "quick", "versions")
_KEY = ("network", "seed", "level", "way")
_COLUMNS = (
    "network", "seed", "level", "way", "episodes", "weights", "updates", "walks", "right_share",
    "finish_share", "crash_share", *(COUNTED := ("macs", "sop", "neuron_update", "events")),
    "quick", "versions", "right", "wrong", "finish", "crash",
)  # fmt: skip


@dataclass(frozen=True)
class EyeEntryDesign(Design):
    """The parts: the teacher, the walks that all learn from, each network's trainings by seed.

    settings  of every training
    """

    seeds: int = 5
    episodes: int = 200

    NAME = "kart-eye"
    OPTIONS: ClassVar = {n: n for n in ("seeds", "runs", "episodes", "quick")} | {"set": "settings"}
    QUICK: ClassVar = {"seeds": 1, "episodes": 2, "limit": 120}

    def trainings(self) -> list[TrainingJob]:
        """The walks, and of a seed the trainings of each network, so that early pages have all."""
        each = [
            self._training(name, seed)
            for seed in range(self.seeds)
            for name, of in _ROWS.items()
            if seed < of.get("seeds", self.seeds)
        ]
        return [*self.walks, *each]

    @property
    def walks(self) -> list[TrainingJob]:
        """Trainings of one update, in whose folders are the teacher's walks."""
        return [self._walks(name) for name in _WALKS]

    def _walks(self, name: str) -> TrainingJob:
        of, short = _WALKS[name], QUICK["kart-eye-walks"] if self.quick else ()
        every = (*of["settings"], *short)
        return TrainingJob(name, of["recipe"], 0, self.runs, every, telling=every)

    def _training(self, network: str, seed: int) -> TrainingJob:
        of = _ROWS[network]
        start = _start_of(network)
        short = QUICK["kart-eye"] if self.quick else ()
        every = (*of["settings"], *start["settings"], *short, *self.settings)
        parents = {"pool": self._walks(start["walks"])}
        for setting in ("guide", "start"):
            if setting in of:
                parents[setting] = self._training(of[setting], seed)
        name = f"{network}-s{seed}"
        job = TrainingJob(name, of["recipe"], seed, self.runs, every, parents)
        # other trainings of the recipe, and the walks, differ in one of these
        like = (*_ROWS.values(), *_WALKS.values())
        others = [row["settings"] for row in like if row["recipe"] == of["recipe"]]
        starts = (each["settings"] for each in _STARTS.values())
        names = {text.split("=")[0] for row in (*others, *starts) for text in row}
        names -= {"teacher_walks", "noisy_walks"}  # which come with the walks of others
        made = job.planned().model_dump(mode="json")
        found = {name: _setting(made, name) for name in sorted(names | {"dense_rounds"})}
        own = [f"{name}={json.dumps(value)}" for name, value in found.items() if value is not None]
        return replace(job, telling=(*every, *own))

    def check(self, results: Path) -> None:
        """Refuse unknown settings, and a table that the rows cannot stand in."""
        super().check(results)
        self.read_kept(results / _TABLE)

    def parts(self) -> list[Part]:
        """The teacher's episodes; the walks; each training and its episodes."""
        trained = []
        for each in self.trainings()[len(_WALKS) :]:
            after = [parent.name for parent in each.parents.values()]
            trained.append(Part(each.name, partial(self._rows, each), each, after=after))
        teacher = Part(TEACHER, partial(self._rows, None))
        return [teacher, *map(Part.to_train, self.walks), *trained]

    # rows

    def _rows(self, training: TrainingJob | None) -> list[StoredRow]:
        """The rows of a training that ended, of each level and way, or of the teacher."""
        made = {
            "episodes": self.episodes,
            "first_seed": FIRST_SEED,
            "limit": self.limit,
            "version": _VERSION,
        }
        folder = Path(self.runs) / "evaluations"
        if training is None:
            make = partial(self._evaluate, None, "", "")
            of = {**made, "policy": TEACHER}
            return [StoredRow(folder / f"{TEACHER}.json", of, make, form=_FORM)]
        run = RunFolder(training.existing_run)
        ways = _ROWS[training.name.rpartition("-s")[0]].get("ways", [""])
        rows = []
        for level in reversed(run.levels.values()):
            policy = zoo.sha256(run.checkpoint(level))
            for way in ways:
                name = "-".join(filter(None, (training.name, level, way.replace(":", "-"))))
                make = partial(self._evaluate, training, level, way)
                of = {**made, "policy": policy, "way": way}
                rows.append(StoredRow(folder / f"{name}.json", of, make, form=_FORM))
        return rows

    def _evaluate(self, training: TrainingJob | None, level: str, way: str) -> Record:
        facts: Record = {"network": TEACHER, "quick": "yes" if self.quick else ""}
        config = training.config if training else self._training(next(iter(_ROWS)), 0).planned()
        env: EnvConfig = config.env
        episodes = EyeEpisodes(env, self.episodes, self.limit)
        controller: BatchController = Stateless(lambda seen: taught_actions(episodes, seen))
        if training is not None:
            run = RunFolder(training.existing_run)
            taught = training.parents["pool"].config
            policy = run.policy(level)
            controller = FloatController(policy)
            progress = run.load(level)[0]
            facts |= {
                "network": training.name.rpartition("-s")[0],
                "seed": training.seed,
                "level": level,
                "way": way,
                "weights": sum(each.numel() for each in policy.parameters()),
                "updates": progress["updates"],
                "walks": taught.teacher_walks
                + taught.noisy_walks
                + config.walks * progress["phase"],
                "versions": versions_text(read_json(training.existing_run / "versions.json")),
            }
            if way:
                driver = make_controller(policy, self.episodes, way)
                counted, ends = drive(env.options, driver, self.episodes, self.limit)
                return facts | {n: counted[n] for n in COUNTED if n in counted} | outcomes(ends)
        *_, ends = episodes.play(range(FIRST_SEED, FIRST_SEED + self.episodes), controller)
        return facts | outcomes(ends)

    def read_kept(self, table: Path) -> list[Record]:
        """The rows of the table so far; ConfigError where they cannot stand beside new ones."""
        rows = read_table(table) if table.is_file() else []
        for row in rows:
            if (row["episodes"], bool(row["quick"])) != (self.episodes, self.quick):
                raise ConfigError(
                    f"{table} has rows of {row['episodes']} episodes"
                    f"{', of quick trainings' if row['quick'] else ''}: name another folder with -o"
                )
        return rows

    def write(self, results: Path) -> list[Path]:
        """Write page and table of the complete rows; return the files, the page first."""
        table = results / _TABLE
        both = (*self.read_kept(table), *self.all_rows())
        found = {tuple(row.get(name) or 0 for name in _KEY): row for row in both}
        order = [TEACHER, *_ROWS]
        rows = sorted(found.values(), key=lambda r: (order.index(r["network"]), r.get("seed") or 0))
        write_exactly(({n: row.get(n) for n in _COLUMNS} for row in rows), _COLUMNS, table)
        rows = read_table(table)  # as they stand there, so that the page can be made of it again
        whole = (row for row in rows if row["level"] in (None, NOT_PRUNED) and not row["way"])
        by_name = dict(grouped(whole, "network"))
        driven = [
            student_facts(key, of, rows)
            for key, of in grouped(rows, "network", "level", "way")
            if key[2]
        ]
        page, shown = pages.write_page(
            results / "kart-eye.md",
            {},
            command=command_line(),
            quick=self.quick,
            episodes=self.episodes,
            first_seed=FIRST_SEED,
            missing=self._missing(rows),
            networks=[network_facts(name, of) for name, of in by_name.items()],
            verdicts="\n".join(f"- {line}" for line in verdicts(by_name)),
            students=driven,
            versions=[
                f"- {releases()}",
                *versions_at_start(
                    {
                        (row["network"], row["seed"]): row["versions"]
                        for row in rows
                        if row["versions"]
                    }.values()
                ),
            ],
        )
        return [page, table, shown]

    def _missing(self, rows: Sequence[Record]) -> str:
        """The trainings that have no row; empty where there are none."""
        there = {f"{row['network']}-s{row['seed']}" for row in rows}
        lack = [each.name for each in self.trainings()[len(_WALKS) :] if each.name not in there]
        return f"**Not trained or evaluated yet: {', '.join(lack)}.**" if lack else ""


def _setting(made: Record, name: str) -> Any:  # noqa: ANN401 - JSON
    """A setting of a configuration; None for an option that is not set."""
    found: Any = made
    for each in name.split("."):
        found = found.get(each)
    return found


def taught_actions(episodes: EyeEpisodes, seen: Any) -> Any:  # noqa: ANN401 - arrays
    """Actions (B,) of the privileged teacher: those of the largest label."""
    return episodes.label(seen)[:, :-SIGNS].argmax(1)


def outcomes(ends: Sequence[Mapping[str, float]]) -> Record:
    """What episodes came to: forks taken right and wrong, finishes and crashes, one each."""
    right, wrong, finish, crash = (
        [int(end[name]) for end in ends] for name in ("forks", "wrong", "finish", "crash")
    )
    taken = sum(right) + sum(wrong)
    return {
        "episodes": len(ends),
        "right_share": sum(right) / taken if taken else None,
        "finish_share": sum(finish) / len(ends),
        "crash_share": sum(crash) / len(ends),
        "right": right,
        "wrong": wrong,
        "finish": finish,
        "crash": crash,
    }


def read_table(table: Path) -> list[Record]:
    """The rows of the table; ConfigError where it is damaged."""
    try:
        rows = read_rows(table, _TEXT)
        for row in rows:
            if tuple(row) != _COLUMNS or row["network"] not in (TEACHER, *_ROWS):
                raise ValueError(f"a row of {row.get('network')}")
    except (OSError, ValueError, csv.Error) as error:
        raise ConfigError(f"{table} is damaged ({error}): put it back, or move it away") from error
    return rows


# the page


def network_facts(name: str, rows: Sequence[Record]) -> Record:
    """Facts that the page shows of a network in all its trainings."""
    return {
        "name": name,
        "sees": _ROWS[name]["sees"] if name in _ROWS else "the simulation's state",
        "trainings": len(rows) if name in _ROWS else 0,
        "weights": mean(rows, "weights"),
        "right": right_share(rows),
        "finish": episode_share(rows, "finish"),
        "crash": episode_share(rows, "crash"),
        "best": max((row["right_share"] for row in rows if row["right_share"]), default=None),
    }


def student_facts(
    of: tuple[str, str, str], rows: Sequence[Record], all_rows: Sequence[Record]
) -> Record:
    """Facts that the page shows of a network, its level and its way, in all its trainings."""
    network, level, way = of
    seeds = {row["seed"] for row in rows}
    beside = [
        row["finish"] for row in all_rows
        if (row["network"], row["level"], row["way"]) == (_BESIDE, NOT_PRUNED, None)
        and row["seed"] in seeds and not _drives_elsewhere(network)
    ]  # fmt: skip
    operations = "macs" if rows[0]["macs"] else "sop"
    return {
        **network_facts(network, rows),
        "way": way,
        "aim": None if level == NOT_PRUNED else float(level.removeprefix(LEVEL)),
        "operations": mean(rows, operations),
        "kind": {"macs": "MACs", "sop": "SOPs"}[operations],
        "updates": mean(rows, "neuron_update"),
        "of_cnn": nested_ratio([row["finish"] for row in rows], beside) if beside else None,
    }


def _start_of(network: str) -> Mapping[str, Any]:
    """The walks that a training begins with, and the settings of those that begin alike."""
    of = _ROWS[network]
    found: Mapping[str, Any] = _STARTS[of["continued"]] if "start" in of else _FROM_NOTHING
    return found


def _drives_elsewhere(network: str) -> bool:
    """Whether it drives with other options of the environment than most."""
    settings = (*_ROWS[network]["settings"], *_start_of(network)["settings"])
    return any(setting.startswith("env.") for setting in settings)


def right_share(rows: Sequence[Record]) -> Estimate | None:
    """Share of the forks taken that were taken right; None where none was."""
    right = np.array([row["right"] for row in rows])
    taken = right + np.array([row["wrong"] for row in rows])
    return nested_ratio(right, taken, together=True) if taken.any() else None


def episode_share(rows: Sequence[Record], event: str) -> Estimate:
    """Share of the episodes in which something happened."""
    values = [row[event] for row in rows]
    if len(values) == 1:
        return share(values[0])
    return stratified_bootstrap(values, np.random.default_rng(0)).mean


def verdicts(rows: Mapping[str, Sequence[Record]]) -> Iterator[str]:
    """Whether the test is passed, in sentences; none on networks that have no row."""
    grids = {n: right_share(of) for n, of in rows.items() if n != TEACHER and _is_grid(n)}
    found = {name: right for name, right in grids.items() if right is not None}
    if found:
        best = max(found, key=lambda name: found[name].mean)
        above = [name for name, right in found.items() if right.mean >= MOST_OF_GRIDS]
        holds = f"no: {', '.join(above)}" if above else "those that are here do"
        finishes = {name: episode_share(rows[name], "finish") for name in found}
        most = max(finishes, key=lambda name: finishes[name].mean)
        yield (
            f"Policies on grids stay below {MOST_OF_GRIDS:.0%} right: {holds}. The most has {best}:"
            f" {pages.percent(found[best], 1)}. They finish in at most "
            f"{pages.percent(finishes[most], 1)} of the episodes ({most}), as six forks in a row "
            "must be right."
        )
    for name, of in rows.items():
        sees = name != TEACHER and _ROWS[name]["recipe"] == _ROWS[_BESIDE]["recipe"]
        right = right_share(of) if sees else None
        if right is None or _drives_elsewhere(name):
            continue
        finish = episode_share(of, "finish")
        does = right.mean >= LEAST_RIGHT and finish.mean >= LEAST_FINISHED
        yield (
            f"A convolutional float network reaches {LEAST_RIGHT:.0%} right and "
            f"{LEAST_FINISHED:.0%} finished: {name} {'does' if does else 'does not'}, with "
            f"{pages.percent(right, 1)} and {pages.percent(finish, 1)}."
        )


def _is_grid(name: str) -> bool:
    return bool(_ROWS[name]["grid"])
