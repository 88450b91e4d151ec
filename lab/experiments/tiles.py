"""The entry test of hexapod-tiles, and its front: what places feet, and for how many operations.

Policies of the whole body, and networks that all legs share, float and spiking, are trained by one
recipe from the same walks of a script that is shown the ground as it is. Each training is evaluated
in fields that no training saw, at each level of its pruning: float networks in float32, in 8 bits
and as delta networks, spiking ones on the emulated chip. Scripts walk beside them.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lab.experiments import DESIGNS, QUICK, costs, pages
from lab.experiments.eye_entry import episode_share
from lab.experiments.eye_map import NOT_PRUNED
from lab.experiments.networks import DELTA, network, play
from lab.experiments.pages import grouped, mean
from lab.experiments.runner import Design, Part
from lab.experiments.students import PRICES
from lab.experiments.training import Record, StoredRow, TrainingJob, read_rows, write_exactly
from spikedeploy import make, zoo
from spikedeploy.comparison.statistics import Estimate, nested_ratio, stratified_bootstrap
from spikedeploy.envs.hexapod.footholds import FootholdScript
from spikedeploy.policies.counting import count_operations
from spikedeploy.policies.run_record import SPIKING
from spikedeploy.seeds import EVALUATION
from spikedeploy.trainers.config import EnvConfig
from spikedeploy.trainers.policies.policy import PrunedWeight
from spikedeploy.trainers.run_folder import RunFolder
from spikedeploy.trainers.sparse.pool import Walk

SCRIPT, GAIT = "script", "gait"
SCRIPTS = {SCRIPT: "looks", GAIT: "does not look"}
VIEWS = ("around", "ahead")
FEW, FEW_SUCCEED, MANY_SUCCEED = 5_000, 0.2, 0.9  # operations; shares that the test asks for
_ROWS: Mapping[str, Mapping[str, Any]] = DESIGNS["hexapod-tiles"]["networks"]
_WALKS: Mapping[str, Any] = DESIGNS["hexapod-tiles"]["walks"]
_GROUNDS: Mapping[str, Mapping[str, Any]] = DESIGNS["hexapod-tiles"]["grounds"]
_TABLE = "hexapod-tiles.csv"
_VERSION = 2  # of what a row holds; a higher one makes all rows again
_TEXT = ("network", "view", "level", "place", "ground", "quick")
_KEY = ("network", "view", "seed", "level", "place", "ground")
_FLOAT = ("float32", "int8")  # places of float networks
_DELTA = f"{DELTA}0.01"  # of those without memory; a threshold tried in fields of seeds from 5,000
_COUNTS = (
    "weights", "operations", "neuron_updates", "bias_operations", "readout_updates", "neuron_idle",
    "messages", "spikes_out", "events", "compared", "sent", "observations", "constants",
)  # fmt: skip
_COLUMNS = (
    *_KEY, "episodes", *_COUNTS, "quick", "success", "missteps", "distance", "fall",
)  # fmt: skip


@dataclass(frozen=True)
class TilesDesign(Design):
    """The parts: the scripts, and for each view the walks and each network's trainings by seed."""

    seeds: int = 5

    NAME = "hexapod-tiles"
    OPTIONS: ClassVar = {n: n for n in ("seeds", "runs", "episodes", "chip", "quick")} | {
        "set": "settings"
    }
    QUICK: ClassVar = {"seeds": 1, "episodes": 2, "limit": 60}

    def trainings(self) -> list[TrainingJob]:
        """The walks of each view, and of a seed the trainings of each network."""
        each = [
            self._training(name, view, seed)
            for seed in range(self.seeds)
            for name, of in _ROWS.items()
            for view in of.get("views", VIEWS)
        ]
        return [*(self._walks(view) for view in VIEWS), *each]

    def _walks(self, view: str) -> TrainingJob:
        """A training of one update, in whose folder are the script's walks."""
        every = (
            f'env.options.view="{view}"', *_WALKS["settings"],
            *(QUICK["hexapod-tiles-walks"] if self.quick else ()),
        )  # fmt: skip
        name = f"walks-{view}"
        return TrainingJob(name, _WALKS["recipe"], 0, self.runs, every, telling=every)

    def _training(self, name: str, view: str, seed: int) -> TrainingJob:
        of = _ROWS[name]
        every = (
            f'env.options.view="{view}"', *of["settings"],
            *(QUICK["hexapod-tiles"] if self.quick else ()), *self.settings,
        )  # fmt: skip
        # in an environment of its own a network sees other observations than the walks show
        own = (*of["settings"], *self.settings)
        alone = any(setting.startswith("env.") for setting in own)
        parents = {} if alone else {"pool": self._walks(view)}
        job = TrainingJob(f"{name}-{view}-s{seed}", of["recipe"], seed, self.runs, every, parents)
        made = job.planned()
        # the walks are a run of one of the recipes too, and differ in their rounds; where walks are
        # taken over, the environment has no other options than these
        told = {"dense_rounds": made.dense_rounds, "policy.hidden": made.policy.hidden}
        told |= {"env.name": made.env.name} | ({} if made.bits is None else {"bits": made.bits})
        telling = (*every, *(f"{name}={json.dumps(value)}" for name, value in told.items()))
        telling += () if alone else ("teacher_walks=0",)
        return replace(job, telling=telling, lacking=("bits",) if made.bits is None else ())

    def parts(self) -> list[Part]:
        """The scripts' episodes; the walks; each training and its episodes."""
        found = [
            Part(f"{name}-{view}", partial(self._script_rows, name, view))
            for view in VIEWS
            for name in SCRIPTS
        ]
        found += [
            Part(f"{SCRIPT}-around-{ground}", partial(self._script_rows, SCRIPT, "around", ground))
            for ground in _GROUNDS
        ]
        for job in self.trainings():
            if is_walks(job):
                found.append(Part.to_train(job))
            else:
                after = [parent.name for parent in job.parents.values()]
                found.append(Part(job.name, partial(self._rows, job), job, after=after))
        return found

    # rows

    @property
    def _made(self) -> Record:
        return {
            "episodes": self.episodes, "first_seed": EVALUATION, "limit": self.limit,
            "version": _VERSION,
        }  # fmt: skip

    def _script_rows(self, name: str, view: str, ground: str | None = None) -> list[StoredRow]:
        stem = "-".join([name, view, *([ground] if ground else [])])
        file = Path(self.runs) / "evaluations" / f"{stem}.json"
        return [StoredRow(file, self._made, partial(self._walk_by_script, name, view, ground))]

    def _walk_by_script(self, name: str, view: str, ground: str | None) -> Record:
        scripts = Scripts(view, looks=name == SCRIPT)
        played = play(_env(view, ground), self.episodes, scripts, self.limit)
        # the gait is the same script on a scan that is free; what it needs was not counted
        facts = {"operations": scripts.count(played.walks)} if name == SCRIPT else {}
        return self._row((name, view, None, None, None, ground), facts, played.infos)

    def _rows(self, training: TrainingJob) -> list[StoredRow]:
        """The rows of a training that ended, one of each level."""
        run = RunFolder(training.existing_run)
        spikes = training.config.policy.kind in SPIKING
        bits = training.config.bits  # weights that were rounded in training are not in float32
        places = [self.chip] if spikes else [f"int{bits}"] if bits else _FLOAT
        every: list[tuple[str, str, str | None]] = [
            (level, at, None) for level in reversed(run.levels.values()) for at in places
        ]
        name, view, _ = training.name.rsplit("-", 2)
        if view == "around" and _ROWS[name].get("transfer"):
            every += [(NOT_PRUNED, places[0], ground) for ground in _GROUNDS]
        if _ROWS[name].get("levels") and training.config.policy.kind == "pruned-mlp" and not bits:
            levels = reversed(run.levels.values())
            every += [(level, at, None) for level in levels for at in ("int8-rows", _DELTA)]
        rows = []
        for level, place, ground in every:
            of = {**self._made, "policy": zoo.sha256(run.checkpoint(level))}
            stem = "-".join([training.name, level, place, *([ground] if ground else [])])
            file = Path(self.runs) / "evaluations" / f"{stem}.json"
            rows.append(
                StoredRow(file, of, partial(self._evaluate, training, level, place, ground))
            )
        return rows

    def _evaluate(
        self, training: TrainingJob, level: str, place: str, ground: str | None
    ) -> Record:
        name, view, _ = training.name.rsplit("-", 2)
        run = RunFolder(training.existing_run)
        policy = run.policy(level)
        stem = Path(self.runs) / "policies" / f"{training.name}-{level}"
        placed = network(run.path, level, place, stem)
        env = training.config.env
        rough = _GROUNDS[ground] if ground else {}
        env = env.model_copy(update={"options": {**env.options, **rough}})
        played = play(env, self.episodes, placed.controller, self.limit)
        matrices = [each for each in policy.modules() if isinstance(each, PrunedWeight)]
        weights = sum(int(each.mask.sum()) for each in matrices)
        facts = {"weights": weights, **placed.counts(played.walks)}
        return self._row((name, view, training.seed, level, place, ground), facts, played.infos)

    def _row(
        self,
        key: tuple[str, str, int | None, str | None, str | None, str | None],
        facts: Mapping[str, Any],
        infos: Sequence[Mapping[str, Any]],
    ) -> Record:
        return {
            **dict(zip(_KEY, key, strict=True)),
            "episodes": len(infos),
            **{name: facts.get(name) for name in _COUNTS},
            "quick": "yes" if self.quick else "",
            "success": [int(info["success"]) for info in infos],
            "missteps": [float(info["misstep_share"]) for info in infos],
            "distance": [float(info["distance"]) for info in infos],
            "fall": [int(info["fall"]) for info in infos],
        }

    def write(self, results: Path) -> list[Path]:
        """Write page and table of what is complete; rows of the table without a run stay."""
        table = results / _TABLE
        old = read_rows(table, _TEXT) if table.is_file() else []
        found = {tuple(row.get(n) or 0 for n in _KEY): row for row in (*old, *self.all_rows())}
        order = [*SCRIPTS, *_ROWS]  # rows of other networks are left out
        rows = sorted(
            (row for row in found.values() if row["network"] in order),
            key=lambda r: (VIEWS.index(r["view"]), order.index(r["network"]), r["seed"] or 0),
        )
        write_exactly(({n: row.get(n) for n in _COLUMNS} for row in rows), _COLUMNS, table)
        rows = read_rows(table, _TEXT)  # as they stand there, so that the page can be made again
        there = {(row["network"], row["view"], row["seed"]) for row in rows}
        trainings = [job for job in self.trainings() if not is_walks(job)]
        lack = Counter(
            job.name.rpartition("-s")[0] for job in trainings
            if (*job.name.rsplit("-", 2)[:2], job.seed) not in there
        )  # fmt: skip
        usual = [row for row in rows if not row["ground"]]
        every = [policy_facts(of) for _, of in grouped(usual, "network", "view", "level", "place")]
        rough = [policy_facts(of) for _, of in grouped(
            [row for row in rows if row["ground"]], "ground", "network", "level", "place"
        )]  # fmt: skip
        whole = [f for f in every if not f["pruned"] and not _is_other_way(f)]
        page, shown = pages.write_page(
            results / "hexapod-tiles.md",
            {},
            command=pages.command(self, sizes=("seeds", "episodes")),
            quick=self.quick,
            episodes=self.episodes,
            first_seed=EVALUATION,
            chip=self.chip,
            missing=[f"{name} ({count})" for name, count in lack.items()],
            views={v: [f for f in whole if f["view"] == v] for v in VIEWS},
            rough=rough,
            heights={name: 100 * of["terrain"] for name, of in _GROUNDS.items()},
            front=[f for f in every if f["pruned"] or f["has_levels"]],
            verdicts="\n".join(f"- {line}" for line in verdicts(every)),
            changed=list(pages.other_settings(trainings, pages.CHANGED)),
            facts=[f"- {pages.releases('torch', 'numpy', 'mujoco')}"],
            PRICES=PRICES,
        )
        return [page, table, shown]


def is_walks(training: TrainingJob) -> bool:
    """Return whether a training does no more than play the walks that others learn from."""
    return training.name.startswith("walks-")


def _env(view: str, ground: str | None = None) -> EnvConfig:
    options = _GROUNDS[ground] if ground else {}
    return EnvConfig(name="hexapod-tiles", options={"view": view, **options})


class Scripts:
    """The script footholds for a batch of robots, or the same gait that does not look."""

    def __init__(self, view: str, looks: bool) -> None:
        self._env = make("hexapod-tiles", view=view).unwrapped
        self._looks = looks

    def reset(self, robots: int) -> None:
        """Start an episode of each."""
        self._each = [FootholdScript(self._env) for _ in range(robots)]  # type: ignore[arg-type]

    def act_batch(self, observation: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        """Actions (B, 18) for observations (B, obs)."""
        pairs = zip(self._each, observation, strict=True)
        return np.stack([self._act(script, seen) for script, seen in pairs])

    def _act(self, script: FootholdScript, seen: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        if self._looks:
            return script.act(seen)
        return script.act_with_scan(seen, np.zeros((6, 35)))

    def count(self, walks: Sequence[Walk]) -> float:
        """Operations of a control step, all kinds together, in the first of these walks."""
        script = FootholdScript(self._env)  # type: ignore[arg-type]
        seen = walks[0].observation.astype(np.float64)
        return float(sum(count_operations(partial(self._act, script), seen).values()))


# the page


def policy_facts(rows: Sequence[Record]) -> Record:
    """Facts that the page shows of a policy at a level, in all its trainings."""
    first = rows[0]
    of = _ROWS.get(first["network"], {})
    is_script = first["network"] in SCRIPTS
    unit = "SOPs" if costs.is_spiking(first) else "MACs"
    return {
        "name": first["network"],
        "view": first["view"],
        "level": first["level"],
        "place": first["place"],
        "ground": first.get("ground"),
        "kind": of.get("kind", SCRIPTS.get(first["network"], "")),
        "pruned": first["level"] is not None and first["level"] != NOT_PRUNED,
        "has_levels": of.get("levels", False),
        "memory": of.get("memory", False),
        "harder": of.get("harder", False),
        "trainings": 0 if is_script else len(rows),
        "success": episode_share(rows, "success"),
        "missteps": episode_mean(rows, "missteps"),
        "distance": float(np.mean([row["distance"] for row in rows])),
        "fall": float(np.mean([row["fall"] for row in rows])),
        "weights": mean(rows, "weights"),
        "operations": mean(rows, "operations"),
        "unit": "" if is_script else unit,
        "updates": mean(rows, "neuron_updates"),
        "energy": [] if is_script else [mean_energy(rows, table) for table in PRICES],
        "rows": rows,
    }


def mean_energy(rows: Sequence[Record], table: str) -> list[float]:
    """Energies [nJ] of a control step: of operations and neuron updates, and of all terms."""
    totals = ("updates", "all")
    return [1e9 * float(np.mean([costs.total(r, table, of) for r in rows])) for of in totals]


def episode_mean(rows: Sequence[Record], field: str) -> Estimate:
    """Mean of a field of episodes, over trainings and episodes."""
    values = [row[field] for row in rows]
    return stratified_bootstrap(values, np.random.default_rng(0)).mean


def verdicts(every: Sequence[Record]) -> Iterator[str]:
    """Whether the test is passed, in sentences; none on what is not there."""
    in_all = [f for f in every if f["trainings"] and f["kind"] != "blind"]
    of_each = [f for f in in_all if not _is_other_way(f)]
    networks = [f for f in of_each if not f["harder"]]
    around = [f for f in networks if f["view"] == "around"]
    small = [f for f in around if f["unit"] == "MACs" and f["operations"] < FEW]
    for pruned, those in ((False, "succeed"), (True, "that were pruned to them succeed")):
        if found := [f for f in small if f["pruned"] == pruned]:
            best = max(found, key=_success)
            above = [_with_operations(f) for f in found if _success(f) > FEW_SUCCEED]
            yield (
                f"Float policies below {FEW:,} MACs {those} in at most {FEW_SUCCEED:.0%}: "
                f"{'no, ' + ', '.join(above) if above else 'those that are here do'}; the best is "
                f"{_with_success(best)}."
            )
    large = [f for f in around if f["unit"] == "MACs" and not f["pruned"]]
    if harder := [f for f in of_each if f["harder"]]:
        yield f"In a harder world succeed {', '.join(map(_with_success, harder))}."
    if large:
        best = max(large, key=_success)
        yield (
            f"A float network succeeds in {MANY_SUCCEED:.0%}: "
            f"{'yes' if _success(best) >= MANY_SUCCEED else 'no'}; {best['name']} with "
            f"{pages.percent(best['success'], 1)} and {pages.percent(best['missteps'], 1)} "
            "missteps."
        )
        seen = [f for f in in_all if f["view"] == "around" and not f["harder"]]
        floats = [f for f in seen if f["unit"] == "MACs"]  # in all ways
        yield from (_compare(f, best, floats) for f in around if f["unit"] == "SOPs")
    ahead = [f for f in networks if f["view"] == "ahead" and not f["pruned"]]
    floats = [f for f in ahead if f["unit"] == "MACs"]
    with_memory = [f for f in floats if f["memory"]]
    memoryless = [f for f in floats if not f["memory"]]
    if with_memory and memoryless:
        best = max(with_memory, key=_success)
        without = max(memoryless, key=_success)
        yield f"On `ahead`, without memory, {_compare(without, best)}"
        others = [f for f in with_memory if f is not best]
        yield from (f"On `ahead` {_compare(f, best)}" for f in others)
        yield from (f"On `ahead` {_compare(f, best)}" for f in ahead if f["unit"] == "SOPs")


def _is_other_way(facts: Record) -> bool:
    """Whether the page has the network in float32 as well."""
    place = facts["place"] or ""
    return place.startswith(DELTA) or _in_integers(place)


def _in_integers(place: str) -> bool:
    """Whether a float network has integers for weights there; `int` alone is a chip."""
    return place.startswith("int") and place[3:4].isdigit()


def _success(facts: Record) -> float:
    return float(facts["success"].mean)


def _compare(facts: Record, best: Record, floats: Sequence[Record] = ()) -> str:
    """What share of the best network's successes one has, and who has more for no more."""
    operations = _with_operations(facts)
    if facts["updates"]:
        operations += f" and {facts['updates']:,.0f} neuron updates"
    if not _success(best):
        return f"{operations} is compared with none: {best['name']} succeeds in no field."
    if not _success(facts):
        return f"{operations} succeeds in no field, {_with_success(best)}."
    own, others = ([row["success"] for row in f["rows"]] for f in (facts, best))
    ratio = pages.percent(nested_ratio(own, others), 1)
    said = f"{operations} has {ratio} of the successes of {_with_operations(best)}"
    cheap = [f for f in floats if f["operations"] <= facts["operations"]]
    if cheap:
        said += (
            f"; it succeeds in {pages.percent(facts['success'], 1)}, with no more operations "
            f"{_with_success(max(cheap, key=_success))}"
        )
    if eight := [f for f in cheap if _in_integers(f["place"])]:
        said += f", of 8 bits {_with_success(max(eight, key=_success))}"
    return f"{said}."


def _with_operations(facts: Record) -> str:
    way = f" ({facts['place']})" if _is_other_way(facts) else ""
    return f"{facts['name']}{way} at {facts['operations']:,.0f} {facts['unit']}"


def _with_success(facts: Record) -> str:
    return f"{_with_operations(facts)} in {pages.percent(facts['success'], 1)}"
