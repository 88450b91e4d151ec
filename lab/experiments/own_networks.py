"""Networks of examples/networks.py as policies: share of the teacher's return, by task and chip.

    python -m lab own-networks [--seeds 3] [--only CartPole-v1/loihi1]

Each is distilled (`distill --network`) in the integers of its chip from the task's float teacher,
with the recipe's defaults, but for the timesteps and, where the chip has few inputs, the code. The
checkpoint is the best in validation, on seeds from 5,000 on; it is played on the emulated chip,
compiled with all design rules, on 100 seeds from 10,000 on, and its teacher in float on the same.
Rows that results/own-networks.csv has stay; the page is made of them.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from lab.experiments.chip_policies import Act, play
from lab.experiments.networks import float_actions, is_discrete, random_actions, share_of_teacher
from lab.experiments.pages import ROOT, share
from lab.experiments.training import Record, read_rows, write_exactly
from spikedeploy import envs
from spikedeploy.runtime.artifact.artifact import load
from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.files import write_text
from spikedeploy.seeds import EVALUATION
from spikedeploy.shipping.exported_run import runnable

TABLE, PAGE = ROOT / "results" / "own-networks.csv", ROOT / "results" / "own-networks.md"
# task -> teacher, settings
TASKS: Mapping[str, tuple[str, Sequence[str]]] = {
    "CartPole-v1": ("chips/CartPole-v1/teacher", ()),
    "Pendulum-v1": ("chips/Pendulum-v1/teacher", ("policy.timesteps=16",)),
    "examples.quadrotor:Quadrotor": (
        "results/students/quadrotor.zip",
        ("policy.timesteps=16", "noise=0.1", "iterations=8", "updates=4800"),
    ),
}  # fmt: skip
# network of examples/networks.py, chip
NETWORKS = (
    ("for_loihi", "loihi1"),
    ("RecurrentForLoihi", "loihi1"),
    ("for_xylo", "xylo-a2"),
    ("for_speck", "speck2f"),
)
# membranes of Xylo that lose a sixteenth in a timestep learn more slowly: validation still rises
_LONGER = {"Pendulum-v1/xylo-a2": ("updates=4800",)}
# inputs of Xylo are 16: ten observations have one each
_FEW_INPUTS = ("policy.coding=regular", "policy.reach=2")
WANTED = 0.97
_COLUMNS = ("task", "network", "chip", "seed", "inputs", "timesteps", "sops", "scores")
_TEXT = ("task", "network", "chip")
Key = tuple[str, str, str, int]


def jobs(seeds: int, only: str) -> Iterator[Key]:
    """Yield task, network, chip and seed of every training, and of teacher and random actions."""
    for task in TASKS:
        yield from ((task, name, "", 0) for name in ("teacher", "random"))
    for seed in range(seeds):
        for task in TASKS:
            for network, name in NETWORKS:
                if f"{task}/{name}".startswith(only):
                    yield task, network, name, seed


def measure(key: Key, runs: Path, episodes: int) -> Record:
    """Return a row: train what is to be trained, and play."""
    task, network, name, seed = key
    numbers = range(EVALUATION, EVALUATION + episodes)
    row: Record = {"task": task, "network": network, "chip": name, "seed": seed}
    if network == "random":
        drawn: Act = random_actions(task).act_batch
        return {**row, "scores": play(task, drawn, numbers)}
    teacher = TASKS[task][0]
    if network == "teacher":
        from spikedeploy.trainers.distill.teachers import teacher as opened

        acts: Act = float_actions(opened(teacher, task), is_discrete(task)).act_batch
        return {**row, "scores": play(task, acts, numbers)}
    from spikedeploy.trainers.progress import Interrupt
    from spikedeploy.trainers.train import train
    from spikedeploy.training_settings import student

    recipe, settings = student(teacher, f"examples.networks:{network}", name)
    world = envs.make(task)
    assert world.observation_space.shape is not None
    wide = world.observation_space.shape[0] > 8 and name.startswith("xylo")
    longer = _LONGER.get(f"{task}/{name}", ())
    settings += [*TASKS[task][1], *longer, *(_FEW_INPUTS if wide else ())]
    stopped = Interrupt()
    run = train(
        recipe, env=task, overrides=settings, seed=seed, runs=runs, quiet=True, interrupt=stopped
    )
    if stopped.share is not None:
        raise SystemExit(stopped.exit_code)
    artifact = load(runnable(str(run)))
    controller = SpikingController(artifact, chip(name), ledger="total")
    scores = play(task, controller.act_batch, numbers)
    assert artifact.codec is not None
    return {
        **row,
        "inputs": artifact.codec.encoder.width,
        "timesteps": artifact.codec.timesteps,
        "sops": controller.ledger.per_inference("sop"),
        "scores": scores,
    }


def _worst(scores: Sequence[float]) -> float:
    """Return the mean of the worst twentieth."""
    return float(np.sort(scores)[: max(1, len(scores) // 20)].mean())


def _settings_said() -> str:
    further = {task: settings for task, (_, settings) in TASKS.items()} | _LONGER
    parts = [f"{name}: `{' '.join(each)}`" for name, each in further.items() if each]
    return "; ".join([*parts, f"Xylo with more than eight observations: `{' '.join(_FEW_INPUTS)}`"])


def page(rows: Mapping[Key, Record]) -> str:
    """Return the table as Markdown."""
    lines = [
        "# Networks of one's own as policies",
        "",
        "Written by `python -m lab own-networks`. snnTorch modules of `examples/networks.py`, two "
        "hidden layers of 32 and 16 neurons and 8 output neurons, one of them recurrent, are "
        "distilled in the integers of a chip from each task's float teacher (`distill --network`) "
        "and played on the emulated chip, compiled with all design rules, in 100 episodes on seeds "
        "from 10,000 on, which no training saw. A share is the return over the teacher's; where "
        "that is negative, of the way from random actions to the teacher. Brackets are 95 % "
        "bootstrap intervals over trainings and episodes; of three trainings they are too narrow. "
        f"✓: the whole interval is at least {WANTED:.0%}; ≈: it contains that; ✗: below. Tasks and "
        "trainings that are not here were not run.",
        "",
        f"Beside the recipe's defaults: {_settings_said()}. Longer trainings were chosen after a "
        "first training of the defaults had been played on these seeds.",
        "",
        "Worst 5 %: mean return of that share of the episodes, of all trainings, and of the "
        "teacher. No float network of this size was trained beside these.",
        "",
        "| task | network | chip | inputs | T | SOPs a control step | trainings | of the teacher "
        "| worst 5 % | teacher's |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for task in TASKS:
        if (task, "random", "", 0) not in rows or (task, "teacher", "", 0) not in rows:
            continue
        at_random = float(np.mean(rows[task, "random", "", 0]["scores"]))
        taught = rows[task, "teacher", "", 0]["scores"]
        for network, name in NETWORKS:
            own = [rows[key] for key in sorted(rows) if key[:3] == (task, network, name)]
            if own:
                found = share_of_teacher([row["scores"] for row in own], taught, at_random)
                sops = ", ".join(f"{row['sops']:,.0f}" for row in own)
                lines.append(
                    f"| `{task}` | `{network}` | `{name}` | {own[0]['inputs']:.0f} | "
                    f"{own[0]['timesteps']:.0f} | {sops} | {len(own)} | "
                    f"{share(found)} {found.mark(WANTED)} | "
                    f"{_worst([s for row in own for s in row['scores']]):,.1f} | "
                    f"{_worst(taught):,.1f} |"
                )
    return "\n".join([*lines, ""])


def main() -> None:
    """Read the command line; train and play what is missing, and write table and page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", default="", help="by the beginning of TASK/CHIP")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--runs", type=Path, default=ROOT / "runs" / "own-networks")
    given = parser.parse_args()
    found = read_rows(TABLE, _TEXT) if TABLE.is_file() else []
    rows: dict[Key, Record] = {
        (row["task"], row["network"], row["chip"] or "", int(row["seed"])): row for row in found
    }
    for key in jobs(given.seeds, given.only):
        if key not in rows:
            rows[key] = measure(key, given.runs, given.episodes)
            print(*key, f"{np.mean(rows[key]['scores']):,.1f}", flush=True)
            filled = [{name: row.get(name) for name in _COLUMNS} for row in rows.values()]
            write_exactly(filled, _COLUMNS, TABLE)
    write_text(PAGE, page(rows))
