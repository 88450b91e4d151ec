"""Networks of examples/networks.py as policies: share of the teacher's return, by task and chip.

    python -m lab own-networks [--seeds 3] [--only CartPole-v1/RecurrentForLoihi]

Each is distilled (`distill --network`) in the integers of its chip from the task's float teacher,
with the recipe's defaults, but for the timesteps and, where the chip has few inputs, the code. The
checkpoint is the best in validation; it is played on the emulated chip, compiled with all design
rules, and its teacher in float on the same seeds.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from lab.experiments import policies
from lab.experiments.runner import Experiment, Record, share, trained
from spikedeploy import envs
from spikedeploy.shipping.exported_run import runnable
from spikedeploy.training_settings import student

# task -> teacher, settings
TASKS: Mapping[str, tuple[str, Sequence[str]]] = {
    "CartPole-v1": ("chips/CartPole-v1/teacher", ()),
    "Pendulum-v1": ("chips/Pendulum-v1/teacher", ("policy.timesteps=16",)),
    "examples.quadrotor:Quadrotor": (
        "results/students/quadrotor.zip",
        ("policy.timesteps=16", "noise=0.1", "iterations=8", "updates=4800"),
    ),
}
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
_BESIDE = ("teacher", "random")
Key = tuple[str, str, str, int]


def jobs(seeds: int) -> Iterator[Key]:
    """Yield task, network, chip and seed of every training, and of teacher and random actions."""
    for task in TASKS:
        yield from ((task, name, "", 0) for name in _BESIDE)
        yield from ((task, *each, seed) for each in NETWORKS for seed in range(seeds))


def measure(job: Key) -> Iterator[Record]:
    """Train what is to be trained, and play."""
    task, network, name, seed = job
    row: Record = {"task": task, "network": network, "chip": name, "seed": seed}
    teacher, further = TASKS[task]
    if network in _BESIDE:
        policy = policies.of_teacher(teacher, task) if network == "teacher" else None
        scores, _ = policies.play(task, policy or policies.at_random(task))
        yield {**row, "scores": scores}
        return
    recipe, settings = student(teacher, f"examples.networks:{network}", name)
    shape = envs.make(task).observation_space.shape
    is_wide = shape is not None and shape[0] > 8 and name.startswith("xylo")
    settings += [*further, *_LONGER.get(f"{task}/{name}", ()), *(_FEW_INPUTS if is_wide else ())]
    run = trained(f"own-networks/{task}-{network}-s{seed}", recipe, task, settings, seed)
    on_chip = policies.EmulatedPolicy(Path(runnable(str(run))), name)
    scores, counts = policies.play(task, on_chip)
    yield {**row, **on_chip.inputs, "sops": counts["sops"], "scores": scores}


def _worst(scores: Sequence[float]) -> float:
    """Return the mean of the worst twentieth."""
    return float(np.sort(scores)[: max(1, len(scores) // 20)].mean())


def facts(rows: Sequence[Record]) -> Record:
    """Return what the page shows."""
    by: dict[tuple[str, str, str], list[Record]] = {}
    for row in sorted(rows, key=lambda row: row["seed"]):
        by.setdefault((row["task"], row["network"], row["chip"]), []).append(row)
    further = {task: settings for task, (_, settings) in TASKS.items()} | _LONGER
    shown = []
    for task, network, name in by:
        if network in _BESIDE or any((task, each, "") not in by for each in _BESIDE):
            continue
        own = by[task, network, name]
        taught, random = (by[task, each, ""][0]["scores"] for each in _BESIDE)
        found = policies.share_of_teacher([row["scores"] for row in own], taught, random)
        shown.append(
            {
                **own[0],
                "sops": ", ".join(f"{row['sops']:,.0f}" for row in own),
                "trainings": len(own),
                "share": f"{share(found)} {found.mark(WANTED)}",
                "worst": _worst([score for row in own for score in row["scores"]]),
                "worst_of_teacher": _worst(taught),
            }
        )
    order = [(task, *each) for task in TASKS for each in NETWORKS]
    return {
        "rows": sorted(shown, key=lambda r: order.index((r["task"], r["network"], r["chip"]))),
        "settings": {name: " ".join(each) for name, each in further.items() if each},
        "few_inputs": " ".join(_FEW_INPUTS),
        "WANTED": WANTED,
    }


EXPERIMENT = Experiment(
    name="own-networks",
    columns=("task", "network", "chip", "seed", "inputs", "timesteps", "sops", "scores"),
    texts=("task", "network", "chip"),
    jobs=jobs,
    measure=measure,
    facts=facts,
)
main = EXPERIMENT.main
