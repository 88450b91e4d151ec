"""Chains of kills: trainings in processes of their own, killed, resumed and compared."""

import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lab.kill.kill_compare import differences
from lab.kill.kill_process import FINISHED, KILLED, STOPPED, UNHEARD, End, Moment, ended, load

_MOST = 4  # interruptions of a chain
_STOPS = 0.2  # part of them that are stops
_WRITES = 0.5  # part of the kills that are at file operations


@dataclass(frozen=True)
class Case:
    """A training of seconds.

    start: name of the case whose finished run it goes on from
    """

    name: str
    recipe: str
    settings: tuple[str, ...]
    start: str = ""


CASES = {
    case.name: case
    for case in (
        # the ring of the replay is overwritten twice, and the temperature is learned
        Case("sac", "smoke", (
            "steps=300", "checkpoint_every=50", "buffer=110", "learn_temperature=true",
            "normaliser.finish=200", "log_every=30", "validation.every=60")),
        Case("ppo", "smoke-kart", ("steps=768", "checkpoint_every=128", "env.count=3")),
        Case("ppo-mlp", "ppo-mlp", (
            "env.name=CartPole-v1", "steps=1500", "horizon=50", "checkpoint_every=300",
            "validation.every=300", "validation.episodes=2", "env.count=2")),
        Case("distill", "smoke-distill", (
            "teacher=hexapod/sac", "iterations=3", "checkpoint_every=7")),
        Case("distill-snn", "distill-snn", (
            "env.name=CartPole-v1", "teacher=lab.kill.kill_chains:lean", "updates=60",
            "iterations=3", "checkpoint_every=7", "validation.every=20", "log_every=5",
            "policy.coding=bernoulli", "validation.episodes=2", "states=200")),
        Case("sparse", "smoke-sparse", ("checkpoint_every=7",)),
        Case("sparse-ppo", "smoke-sparse-tuned", ("iterations=4",), start="sparse"),
    )
}  # fmt: skip


def lean(observation: np.ndarray) -> int:
    """A teacher of CartPole: push to where the pole falls."""
    return int(observation[2] + observation[3] > 0)


@dataclass(frozen=True)
class Row:
    """What came of one case.

    kills, writes: SIGKILLs that met a training, and those of them at a file operation
    stops: SIGTERMs that met one
    differences: of each chain that did not end as the unbroken run, in words
    """

    name: str
    recipe: str
    kills: int
    writes: int
    stops: int
    chains: int
    files: int
    seconds: float
    differences: tuple[str, ...]


class Killer:
    """Runs cases in a folder."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder, self._seed = folder, seed
        load()
        self._whole: dict[str, End] = {}

    def tried(self, case: Case, kills: int) -> Row:
        """Return what came of a case after so many kills."""
        began, rng = time.perf_counter(), np.random.default_rng([self._seed, len(case.name), kills])
        whole = self.unbroken(case)
        met: list[Moment] = []
        wrong: list[str] = []
        chains = 0
        while sum(moment.kills for moment in met) < kills:
            left = kills - sum(moment.kills for moment in met)
            runs = self._folder / case.name / f"chain-{chains}"
            met += (interruptions := self._chain(case, runs, whole, rng, left))
            found = differences(whole.run, _only(runs))
            if found:
                wrong.append(f"{case.name} chain {chains} ({interruptions}): {'; '.join(found)}")
            chains += 1
        files = sum(path.is_file() for path in whole.run.rglob("*"))
        deadly = [moment for moment in met if moment.kills]
        return Row(
            case.name, case.recipe, len(deadly), sum(m.write > 0 for m in deadly),
            len(met) - len(deadly), chains, files, time.perf_counter() - began, tuple(wrong),
        )  # fmt: skip

    def unbroken(self, case: Case) -> End:
        """Return how a training ended that nothing stopped."""
        if case.name not in self._whole:
            end = self._train(case, self._folder / case.name / "whole", Moment())
            if end.status != FINISHED:
                raise RuntimeError(f"{case.name} did not finish: {end.log}")
            self._whole[case.name] = end
        return self._whole[case.name]

    def _chain(
        self, case: Case, runs: Path, whole: End, rng: np.random.Generator, kills: int
    ) -> list[Moment]:
        """Interrupt a training a few times and let it finish; return what met it."""
        met: list[Moment] = []
        for _ in range(int(rng.integers(1, _MOST + 1))):
            moment = _moment(rng, whole)
            end = self._train(case, runs, moment)
            if end.status in (KILLED, STOPPED):
                met.append(moment)
            elif end.status == FINISHED:
                return met
            elif end.status == UNHEARD:  # it did not listen yet
                continue
            else:
                raise RuntimeError(f"{case.name} failed after {met}: {end.log}")
            if sum(moment.kills for moment in met) == kills:
                break
        end = self._train(case, runs, Moment())
        if end.status != FINISHED:
            raise RuntimeError(f"{case.name} did not finish after {met}: {end.log}")
        return met

    def _train(self, case: Case, runs: Path, moment: Moment) -> End:
        """Start a training, or resume the one in the folder."""
        settings = case.settings
        if case.start:
            settings = (*settings, f"start={self.unbroken(CASES[case.start]).run}")
        resume = _only(runs)
        if resume is None:
            shutil.rmtree(runs, ignore_errors=True)  # it died before it had a configuration
            runs.mkdir(parents=True)
        return ended(case.recipe, settings, runs, resume, moment)


def _moment(rng: np.random.Generator, whole: End) -> Moment:
    """Return a random moment of a training that takes as long as the unbroken one."""
    after = float(rng.uniform(0, whole.seconds))
    if rng.random() < _STOPS:
        return Moment(seconds=after, stop=True)
    if rng.random() < _WRITES:
        return Moment(write=int(rng.integers(1, whole.writes + 1)))
    return Moment(seconds=after)


def _only(runs: Path) -> Path | None:
    """Return the run folder in a folder, if there is one."""
    return next((file.parent for file in sorted(runs.glob("*/config.json"))), None)


def table(rows: list[Row]) -> str:
    """Return the rows as a table, and a line for each difference."""
    head = ("training", "recipe", "kills", "at a write", "stops", "chains", "equal", "files", "s")
    cells = [head] + [
        tuple(map(str, (
            r.name, r.recipe, r.kills, r.writes, r.stops, r.chains,
            r.chains - len(r.differences), r.files, round(r.seconds))))
        for r in rows
    ]  # fmt: skip
    widths = [max(len(row[k]) for row in cells) for k in range(len(head))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in cells]
    wrong = (difference for row in rows for difference in row.differences)
    return "\n".join([*(line.rstrip() for line in lines), *wrong])
