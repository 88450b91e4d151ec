"""A policy for every chip: trains what is not shipped yet, and makes the table of chips and tasks.

    python -m lab chip-policies train [--only CartPole-v1/xylo-a2] [--again]
    python -m lab chip-policies table [--episodes 100]

`train` imitates the task's float teacher in the integers of each chip (recipe `for-chip`) and puts
file and card into spikedeploy/zoo/chips; a teacher that is not shipped is trained first. `table`
plays each shipped file on its chip, compiled with all design rules, on seeds from 10,000 on, which
no training saw, and its teacher in float on the same; it writes results/chips.csv and .md. Rows of
files that have not changed stay.
"""

import argparse
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lab.experiments import DESIGNS
from lab.experiments.networks import (
    float_actions,
    is_discrete,
    random_actions,
    share_of_teacher,
)
from lab.experiments.pages import ROOT, render, share
from lab.experiments.training import Record, read_rows, write_exactly
from spikedeploy import envs, zoo
from spikedeploy.comparison.statistics import stratified_bootstrap
from spikedeploy.runtime import SpikingController, load
from spikedeploy.runtime.chips import CHIPS as EVERY_CHIP
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.files import as_text, replacing, write_text
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.export_run import export_run
from spikedeploy.shipping.publish_run import describe

TABLE, PAGE = ROOT / "results" / "chips.csv", ROOT / "results" / "chips.md"
CHIPS = ("xylo-a2", "speck2f", "odin", "tinyodin", "truenorth", "spiker", "spinnaker2", "loihi2")
WANTED = 0.95  # of the teacher


TASKS: Mapping[str, Record] = DESIGNS["chips"]["tasks"]
FURTHER: Mapping[str, Sequence[str]] = DESIGNS["chips"]["further"]
Act = Callable[[NDArray[np.float64]], NDArray[Any]]


def pairs(only: str | None) -> Iterator[tuple[str, str]]:
    """Tasks and chips, or those whose name begins so."""
    for task in TASKS:
        for name in CHIPS:
            if f"{task}/{name}".startswith(only or ""):
                yield task, name


def _file(task: str, name: str) -> Path:
    return zoo.FOLDER / zoo.FOR_CHIPS / task / f"{name}.nir"


# training


def train_all(only: str | None, again: bool, runs: Path) -> None:
    """Train and ship what is missing, one after another."""
    for task, name in pairs(only):
        file = _file(task, name)
        if _shipped(file) and not again:
            continue
        settings = [*TASKS[task]["settings"], *FURTHER.get(name, ())]
        settings += [f'policy.chip="{name}"', f'teacher="{_teacher(task, runs)}"']
        run = _trained("for-chip", task, runs, settings)
        print(f"{task}/{name}: {run}", flush=True)
        _ship(run, file)


def _shipped(file: Path) -> bool:
    """Return whether a policy is there with its card, which is written after it."""
    name = file.relative_to(zoo.FOLDER).with_suffix("").as_posix()
    return file.is_file() and zoo.card(name).get("sha256") == zoo.sha256(file)


def _teacher(task: str, runs: Path) -> str:
    """The name of the task's shipped teacher, which is trained if there is none."""
    if (name := zoo.teacher(task)) is not None:
        return name
    run = _trained(TASKS[task]["recipe"], task, runs)
    _ship(run, zoo.FOLDER / zoo.FOR_CHIPS / task / f"{zoo.TEACHER}.onnx")
    return str(zoo.teacher(task))


def _trained(recipe: str, task: str, runs: Path, settings: Sequence[str] = ()) -> Path:
    """The run folder of a training that came to its end."""
    from spikedeploy.trainers.progress import Interrupt
    from spikedeploy.trainers.train import train

    stopped = Interrupt()
    run = train(recipe, env=task, overrides=settings, runs=runs, quiet=True, interrupt=stopped)
    if stopped.share is not None:
        raise SystemExit(stopped.exit_code)
    return run


def _ship(run: Path, file: Path) -> None:
    """Export the run's best policy into the zoo, with a card, if the file does what it does."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = run / file.name
    exported = export_run(str(run), file.suffix[1:], part)
    failed = [check.name for check in exported.checks if not check.passed]
    if failed:
        raise SystemExit(f"{run}: the file does not do what the policy does: {', '.join(failed)}")
    card = describe(run, exported) | {"file": file.name}
    with replacing(file) as whole:
        shutil.move(part, whole)
    write_text(file.with_suffix(".json"), as_text(card))


# evaluation


def play(task: str, act: Act, seeds: Sequence[int]) -> list[float]:
    """Returns of one episode for each seed, side by side."""
    worlds = [envs.make(task) for _ in seeds]
    pairs = zip(worlds, seeds, strict=True)
    seen = np.stack([world.reset(seed=seed)[0] for world, seed in pairs]).astype(np.float64)
    totals, running = np.zeros(len(seeds)), np.arange(len(seeds))
    while running.size:
        going = []
        for k, action in zip(running, act(seen[running]), strict=True):
            seen[k], reward, terminated, truncated, _ = worlds[k].step(action)
            totals[k] += reward
            if not (terminated or truncated):
                going.append(k)
        running = np.array(going, np.int64)
    return [float(total) for total in totals]


def _of_float(task: str) -> Act:
    """The teacher of a task as it acts."""
    from spikedeploy.trainers.distill.teachers import teacher

    return float_actions(teacher(str(zoo.teacher(task)), task), is_discrete(task)).act_batch


def _row(task: str, name: str, seeds: Sequence[int]) -> Record:
    """One line of the table, as stored."""
    base = {"task": task, "chip": name, "episodes": len(seeds)}
    if name in ("teacher", "random"):
        scores = play(
            task, _of_float(task) if name == "teacher" else random_actions(task).act_batch, seeds
        )
        return {**base, "sha256": "", "scores": scores}
    file = _file(task, name)
    artifact = load(file)
    controller = SpikingController(artifact, chip(name), ledger="total")
    scores = play(task, controller.act_batch, seeds)
    ledger = controller.ledger
    assert artifact.codec is not None
    return {
        **base,
        "sha256": zoo.sha256(file),
        "inputs": artifact.codec.encoder.width,
        "neurons": sum(ledger.neurons),
        "timesteps": artifact.codec.timesteps,
        "sops": ledger.per_inference("sop"),
        "spikes": ledger.per_inference("spike_out"),
        "updates": ledger.per_inference("neuron_update"),
        "saturations": ledger.per_inference("saturation"),
        "scores": scores,
    }


_COLUMNS = (
    "task", "chip", "episodes", "sha256", "inputs", "neurons", "timesteps", "sops", "spikes",
    "updates", "saturations", "scores",
)  # fmt: skip
_TEXT = ("task", "chip", "sha256")
Table = Mapping[tuple[str, str], Record]


def make_table(episodes: int) -> None:
    """Evaluate what is new, and write table and page."""
    seeds = range(EVALUATION, EVALUATION + episodes)
    rows = read(TABLE)
    for task in TASKS:
        shipped = [name for _, name in pairs(f"{task}/") if _file(task, name).is_file()]
        for name in ("teacher", "random", *shipped) if shipped else ():
            digest = zoo.sha256(_file(task, name)) if name in CHIPS else ""
            old = rows.get((task, name))
            if old is None or (old["sha256"] or "") != digest or old["episodes"] != episodes:
                rows[task, name] = _row(task, name, seeds)
                print(f"{task}/{name}: {np.mean(rows[task, name]['scores']):,.1f}", flush=True)
                write_exactly([rows[key] for key in sorted(rows, key=_place)], _COLUMNS, TABLE)
    write_text(PAGE, page(rows))


def _place(key: tuple[str, str]) -> tuple[int, int]:
    return list(TASKS).index(key[0]), ("teacher", "random", *CHIPS).index(key[1])


def read(table: Path) -> dict[tuple[str, str], Record]:
    """The rows of an earlier table, by task and policy."""
    rows = read_rows(table, _TEXT) if table.is_file() else []
    return {(row["task"], row["chip"]): row for row in rows}


def page(rows: Table) -> str:
    """The table as Markdown."""
    return render(
        "chips",
        tasks=[task for task in TASKS if (task, "teacher") in rows],
        shares=lambda task, name: _share(rows, task, name),
        rows=[rows[key] for key in sorted(rows, key=_place)],
        earned=lambda row: stratified_bootstrap([row["scores"]], np.random.default_rng(0)).mean,
        clock=_clock,
        others=[name for name in EVERY_CHIP if name not in (*CHIPS, "ideal", "int")],
        **{"WANTED": WANTED, "CHIPS": CHIPS},
    )


def _share(rows: Table, task: str, name: str) -> str:
    """The share of the teacher's return; where that is negative, from random actions on."""
    if (task, name) not in rows:
        return "not trained"
    teacher, at_random = (rows[task, each]["scores"] for each in ("teacher", "random"))
    found = share_of_teacher([rows[task, name]["scores"]], teacher, float(np.mean(at_random)))
    return f"{share(found)} {found.mark(WANTED)}"


def _clock(task: str, name: str) -> str:
    """How the chip's layers advance; those of a float network do not."""
    file = _file(task, name)
    return compile_program(load(file), chip(name)).clock if file.is_file() else "–"


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("train", "table"))
    parser.add_argument("--only", help="tasks and chips by the beginning of TASK/CHIP")
    parser.add_argument("--again", action="store_true", help="train what is shipped already, too")
    parser.add_argument("--runs", type=Path, default=ROOT / "runs" / "chips")
    parser.add_argument("--episodes", type=int, default=100)
    given = parser.parse_args()
    if given.what == "train":
        train_all(given.only, given.again, given.runs)
    else:
        make_table(given.episodes)
