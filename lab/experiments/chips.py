"""A policy for every chip: trains and ships what is missing, and plays each on its chip.

    python -m lab chips [--only CartPole-v1/xylo-a2] [--again]

A policy imitates the task's float teacher in the integers of its chip (recipe `for-chip`); file and
card go into spikedeploy/zoo/chips. A teacher that is not shipped is trained first. `--again` plays
again: to train again, remove the file.
"""

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from lab.experiments import policies
from lab.experiments.runner import TASKS, Experiment, Record, share, trained
from lab.publish import describe
from spikedeploy import zoo
from spikedeploy.comparison.statistics import stratified_bootstrap
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips import CHIPS as EVERY_CHIP
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.compiler.compile import compile_program
from spikedeploy.runtime.files import as_text, replacing, write_text
from spikedeploy.shipping.export_run import export_run

CHIPS = ("xylo-a2", "speck2f", "odin", "tinyodin", "truenorth", "spiker", "spinnaker2", "loihi2")
WANTED = 0.95  # of the teacher
_TASKS, _FURTHER = TASKS["chips"]["tasks"], TASKS["chips"]["further"]
_BESIDE = ("teacher", "random")


def jobs(_: int) -> Iterator[tuple[str, str]]:
    """Yield tasks and policies; a policy has one training."""
    yield from ((task, name) for task in _TASKS for name in (*_BESIDE, *CHIPS))


def policy_file(task: str, name: str) -> Path:
    """Return where the policy for a chip is shipped."""
    return zoo.FOLDER / zoo.FOR_CHIPS / task / f"{name}.nir"


def is_shipped(file: Path) -> bool:
    """Return whether a policy is there with its card, which is written after it."""
    name = file.relative_to(zoo.FOLDER).with_suffix("").as_posix()
    return file.is_file() and zoo.card(name).get("sha256") == zoo.sha256(file)


def measure(job: tuple[str, str]) -> Iterator[Record]:
    """Train and ship what is missing, and play it."""
    task, name = job
    row: Record = {"task": task, "chip": name, "episodes": policies.EPISODES}
    if name in _BESIDE:
        policy = policies.of_teacher(_teacher(task), task) if name == "teacher" else None
        scores, _ = policies.play(task, policy or policies.at_random(task))
        yield {**row, "scores": scores}
        return
    file = policy_file(task, name)
    if not is_shipped(file):
        settings = [*_TASKS[task]["settings"], *_FURTHER.get(name, ())]
        settings += [f'policy.chip="{name}"', f'teacher="{_teacher(task)}"']
        _ship(trained(f"chips/{task}-{name}", "for-chip", task, settings), file)
    on_chip = policies.EmulatedPolicy(file, name)
    scores, counts = policies.play(task, on_chip)
    del counts["readout_updates"]
    own = {"sha256": zoo.sha256(file), "neurons": on_chip.neurons, **on_chip.inputs}
    yield {**row, **own, **counts, "scores": scores}


def _teacher(task: str) -> str:
    """Return the name of the task's shipped teacher, which is trained if there is none."""
    if zoo.teacher(task) is None:
        run = trained(f"chips/{task}-teacher", _TASKS[task]["recipe"], task)
        _ship(run, zoo.FOLDER / zoo.FOR_CHIPS / task / f"{zoo.TEACHER}.onnx")
    return str(zoo.teacher(task))


def _ship(run: Path, file: Path) -> None:
    """Export the run's best policy into the zoo, with a card, if the file does what it does."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = run / file.name
    exported = export_run(str(run), file.suffix[1:], part)
    if failed := [check.name for check in exported.checks if not check.passed]:
        raise SystemExit(f"{run}: the file does not do what the policy does: {', '.join(failed)}")
    card = describe(run, exported) | {"file": file.name}
    with replacing(file) as whole:
        shutil.move(part, whole)
    write_text(file.with_suffix(".json"), as_text(card))


def facts(rows: Sequence[Record]) -> Record:
    """Return what the page shows."""
    by = {(row["task"], row["chip"]): row for row in rows}

    def kept(task: str, name: str) -> str:
        if (task, name) not in by:
            return "not trained"
        taught, random = (by[task, each]["scores"] for each in _BESIDE)
        found = policies.share_of_teacher([by[task, name]["scores"]], taught, random)
        return f"{share(found)} {found.mark(WANTED)}"

    return {
        "tasks": [task for task in _TASKS if (task, "teacher") in by],
        "rows": [by[job] for job in jobs(1) if job in by],
        "kept": kept,
        "earned": lambda row: stratified_bootstrap(
            [row["scores"]], np.random.default_rng(0)
        ).mean.text(",.1f"),
        "clock": _clock,
        "others": [name for name in EVERY_CHIP if name not in (*CHIPS, "ideal", "int")],
        "WANTED": WANTED,
        "CHIPS": CHIPS,
    }


def _clock(task: str, name: str) -> str:
    """Return how the chip's layers advance; those of a float network do not."""
    file = policy_file(task, name)
    return compile_program(load(file), chip(name)).clock if file.is_file() else "–"


EXPERIMENT = Experiment(
    name="chips",
    columns=(
        "task", "chip", "episodes", "sha256", "inputs", "neurons", "timesteps", "sops", "spikes",
        "updates", "saturations", "scores",
    ),
    texts=("task", "chip", "sha256"),
    jobs=jobs,
    measure=measure,
    facts=facts,
    is_current=lambda row: row["chip"] in _BESIDE
    or row["sha256"] == zoo.sha256(policy_file(row["task"], row["chip"])),
)  # fmt: skip
main = EXPERIMENT.main
