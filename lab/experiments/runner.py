"""The command of all experiments: missing parts run as jobs, resumed where they stopped; a page."""

import argparse
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from lab.experiments import EXPERIMENTS
from lab.experiments.training import Record, StoredRow, TrainingJob, results
from spikedeploy.console import console, print_json
from spikedeploy.jobs import resumable
from spikedeploy.jobs.resumable import Job, JobEnd
from spikedeploy.outputs import check_folder, check_output_folder, has_text
from spikedeploy.runtime.chips.chip import chip as chip_named
from spikedeploy.runtime.errors import ConfigError

_EVERY = 300.0  # [s] between two lines on what runs
_PAGE_EVERY = 120.0  # [s] between two pages, which read all results


@dataclass(frozen=True)
class Outcome:
    """The result of running an experiment.

    done, of     number of complete parts, and of all
    failed       part -> last line of its log
    interrupted  whether it was stopped from outside
    files        page, tables and pictures
    """

    done: int
    of: int
    failed: dict[str, str]
    interrupted: bool
    files: list[Path]


@dataclass(frozen=True)
class Part:
    """A part of an experiment: a training, its results, or both; a job of its own.

    name      for people, and for --only
    rows      the results to be made, which are known once what they are made from is trained
    training  to be completed before
    of        the training that the results are of, where another part completes it
    after     names of the parts that must be done before
    """

    name: str
    rows: Callable[[], Sequence[StoredRow]] = tuple
    training: TrainingJob | None = None
    of: TrainingJob | None = None
    after: Sequence[str] = ()

    @classmethod
    def to_train(cls, training: TrainingJob) -> "Part":
        """The part that completes a training, after those that it is made from."""
        after = [parent.name for parent in training.parents.values()]
        return cls(training.name, training=training, after=after)

    @property
    def found(self) -> Iterator[Any]:
        """The results so far."""
        source = self.training or self.of
        return results(self.rows() if source is None or source.is_trained else ())

    @property
    def is_done(self) -> bool:
        """Return whether nothing is missing."""
        source = self.training or self.of
        if source is not None and not source.is_trained:
            return False
        return all(row.found is not None for row in self.rows())

    def perform(self) -> bool:
        """Do what is missing; False if it was interrupted."""
        if self.training is not None and not self.training.complete():
            return False
        for row in self.rows():
            row.complete()
        return True


@dataclass(frozen=True)
class Design:
    """The parts of an experiment; subclasses name their parts and write their page.

    seeds     trainings of each policy, from seed 0 up
    runs      folder of run folders and of rows
    settings  of trainings, as `--set` takes them
    episodes  of each evaluation
    chip      on which spiking policies are evaluated
    limit     control steps that an episode of an evaluation may take; None for all
    quick     whether parts take seconds, for a first look and for tests
    """

    seeds: int = 3
    runs: str = ""
    settings: Sequence[str] = ()
    episodes: int = 100
    chip: str = "loihi1"
    limit: int | None = None
    quick: bool = False

    NAME: ClassVar[str]
    # option of the command -> field
    OPTIONS: ClassVar[dict[str, str]] = {
        "seeds": "seeds", "runs": "runs", "set": "settings", "episodes": "episodes",
        "chip": "chip", "quick": "quick",
    }  # fmt: skip
    QUICK: ClassVar[dict[str, Any]] = {"seeds": 1, "episodes": 2, "limit": 40}
    JOBS: ClassVar[int] = 1  # side by side, if the command does not say
    ENVS: ClassVar[Sequence[str]] = ()  # of which the command names one

    def __post_init__(self) -> None:
        chip_named(self.chip)  # raises on an unknown name

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Any:  # noqa: ANN401 - of this class
        """The design of the options of a command; ConfigError where one is of others."""
        if other := sorted(options.keys() - cls.OPTIONS):
            raise ConfigError(f"the experiment {cls.NAME} has no {other[0]}. Leave it out.")
        if cls.ENVS and "env" not in options:
            raise ConfigError(
                f"the experiment {cls.NAME} needs an environment: {', '.join(cls.ENVS)}"
            )
        quick = options.get("quick", False)
        given = {cls.OPTIONS[name]: value for name, value in options.items()}
        if isinstance(given.get("tasks"), str):
            given["tasks"] = (given["tasks"],)
        place = Path("runs") / (f"{cls.NAME}-quick" if quick else cls.NAME)
        return cls(**{"runs": str(place), **(cls.QUICK if quick else {}), **given})

    def trainings(self) -> Sequence[TrainingJob]:
        """All trainings, those that others are made from before them."""
        return ()

    def parts(self) -> list[Part]:
        """All parts, in the order in which they are done."""
        raise NotImplementedError

    def bundles(self, names: list[str]) -> list[list[str]]:
        """Parts that are one job together."""
        return [[name] for name in names]

    def all_rows(self) -> Iterator[Record]:
        """The results so far, part by part."""
        return (row for part in self.parts() for row in part.found)

    def check(self, results: Path) -> None:
        """Refuse settings that no training has, before the first one starts."""
        for training in self.trainings():
            training.planned()

    def write(self, results: Path) -> list[Path]:
        """Write page, tables and pictures of what is complete; return the files."""
        raise NotImplementedError


def command_line() -> str:
    """The command that this process runs, as it can be typed again."""
    return f"{sys.argv[0]} {shlex.join(sys.argv[1:])}"


def run_experiment(
    design: Design,
    only: Sequence[str] = (),
    jobs: int | None = None,
    results: Path = Path("results"),
    train: bool = True,
) -> Outcome:
    """Run the missing parts of the experiment, and write its page.

    only     beginnings of the names of parts, in which * stands for anything; empty for all
    jobs     processes in parallel
    results  folder of the page
    train    False only writes the page
    """
    check_folder("--runs", Path(design.runs))
    check_folder("--output", results)
    design.check(results)
    parts = {part.name: part for part in design.parts()}
    chosen = _chosen(list(parts), only) if train else []
    to_do = [name for name in chosen if not parts[name].is_done]
    _check_before(parts, to_do)
    _say(f"{len(to_do)} of {len(parts)} parts to do")
    failed: dict[str, str] = {}
    written = shown = time.monotonic()

    def ended(end: JobEnd) -> None:
        nonlocal written
        _say(end.line)
        if end.failed:
            failed[end.job.name] = end.last_line
        if time.monotonic() - written > _PAGE_EVERY:
            design.write(results)
            written = time.monotonic()

    def progress(job: Job) -> str:
        part = parts.get(job.name)
        return part.training.progress if part and part.training else job.name

    def look(running: Sequence[Job]) -> None:
        nonlocal shown
        if time.monotonic() - shown > _EVERY:
            shown = time.monotonic()
            _say("running: " + "; ".join(map(progress, running)))

    made = [_job(design, names, parts) for names in design.bundles(to_do)]
    is_whole = resumable.run(made, jobs or design.JOBS, ended, look)
    files = design.write(results)
    done = sum(part.is_done for part in parts.values())
    return Outcome(done, len(parts), failed, not is_whole, files)


def _chosen(names: Sequence[str], only: Sequence[str]) -> list[str]:
    """The names that begin so; all where none is asked for."""
    for beginning in only:
        if not any(fnmatchcase(name, f"{beginning}*") for name in names):
            raise ConfigError(
                f"no part of the experiment begins with {beginning!r}; known: {', '.join(names)}"
            )
    return [n for n in names if not only or any(fnmatchcase(n, f"{each}*") for each in only)]


def _check_before(parts: Mapping[str, Part], to_do: Sequence[str]) -> None:
    """Refuse parts that need another which is neither complete nor among them."""
    for part in (parts[name] for name in to_do):
        if part.training is not None and part.training.run is not None:
            continue  # it is resumed
        for name in part.after:
            if name not in to_do and not parts[name].is_done:
                raise ConfigError(
                    f"{part.name} needs {name}, which is not trained yet. Run the experiment "
                    f"without --only, or with --only {name} first."
                )


def _job(design: Design, names: Sequence[str], parts: Mapping[str, Part]) -> Job:
    name = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
    log = Path(design.runs) / "logs" / f"{name.replace(': ', '-').replace(' ', '-')}.log"
    arguments = {"experiment": design.NAME, "design": asdict(design), "parts": list(names)}
    return Job(name, f"{__name__}:perform", log, arguments, parts[names[0]].after)


def perform(experiment: str, design: Mapping[str, Any], parts: Sequence[str]) -> bool:
    """Do some parts of a design (a job of `resumable`); False if one was interrupted."""
    every = {part.name: part for part in design_class(experiment)(**design).parts()}
    return all(every[name].perform() for name in parts)


def _say(line: str) -> None:
    console(stderr=True).print(line, markup=False, soft_wrap=True)


def design_class(name: str) -> type[Any]:
    """The design of an experiment by its name."""
    if name not in EXPERIMENTS:
        raise ConfigError(f"unknown experiment {name!r}; known: {', '.join(EXPERIMENTS)}")
    module, _, kind = EXPERIMENTS[name].partition(":")
    found: type[Any] = getattr(import_module(module), kind)
    return found


# option -> its least number and help, or its metavar and help; Design.OPTIONS says whose they are
_NUMBERS = {
    "seeds": (1, "trainings of each network (kart, lineup 5; others 3)"),
    "controls": (0, "kart: trainings of each control (5)"),
    "jobs": (1, "processes side by side (kart all cores, others 1)"),
    "finishes": (0, "kart: finishes that end a training; 0 spends the whole budget (classic 300)"),
    "episodes": (
        1,
        "of each evaluation (100; karts of pareto 300; kart-eye 200; its map 32; robustness 30; "
        "gymnasium 50)",
    ),
    "chip-episodes": (1, "pareto: episodes on other chips and in fewer bits (30)"),
    "levels": (1, "pareto: how many of the last levels are evaluated (all)"),
}
_LISTS = {
    "only": ("NAME", "parts by prefix of their names: kart-grid, kart-grid-snn-s0, *-classic"),
    "set": ("KEY=VALUE", "a setting of every training; robustness: an option of the environment"),
    "policies": ("NAME,…", "robustness: as `compare` takes them; needed for other people's ENV"),
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Train, export and evaluate all parts of an experiment; resume where it "
        "stopped.",
        allow_abbrev=False,
    )
    parser.add_argument("name", metavar="NAME", help=", ".join(EXPERIMENTS))
    parser.add_argument(
        "env", metavar="ENV", nargs="?", help="of kart none, of gymnasium and lineup one task"
    )
    for option, (_, text) in _NUMBERS.items():
        parser.add_argument(f"--{option}", type=int, metavar="N", help=text)
    for option, (metavar, text) in _LISTS.items():
        parser.add_argument(f"--{option}", action="append", metavar=metavar, help=text)
    parser.add_argument("--chip", help="of the spiking policies (loihi1)")
    parser.add_argument("--runs", help="where the run folders are (runs/NAME)")
    parser.add_argument(
        "-o", "--output", type=Path, help="folder of NAME.md and NAME/ (results; --quick: runs/…)"
    )
    parser.add_argument(
        "--train", action=argparse.BooleanOptionalAction, default=True, help="or the page alone"
    )
    parser.add_argument("--quick", action="store_true", help="parts of seconds, a first look")
    parser.add_argument("--force", action="store_true", help="write over what others made")
    parser.add_argument("--json", action="store_true")
    return parser


def main() -> int:
    """Run the command of sys.argv; return its exit code."""
    parser = _parser()
    options = {name.replace("_", "-"): value for name, value in vars(parser.parse_args()).items()}
    given = {n: v for n, v in options.items() if v is not None and v is not False}
    for option, (least, _) in _NUMBERS.items():
        if given.get(option, least) < least:
            parser.error(f"argument --{option}: {given[option]} is below {least}")
    kind, quick = design_class(given["name"]), options["quick"]
    own = {n for other in EXPERIMENTS for n in design_class(other).OPTIONS}
    design = kind.of({n: v for n, v in given.items() if n in own})
    results = options["output"] or Path(f"runs/{kind.NAME}-quick" if quick else "results")
    pages = (f"{kind.NAME}.md", f"{kind.NAME}.html")

    def is_ours(folder: Path) -> bool:
        return has_text(folder / pages[0], "python -m lab")

    check_output_folder("-o", results, pages, (), options["force"], is_ours)
    outcome = run_experiment(
        design, options["only"] or (), options["jobs"], results, options["train"]
    )
    if options["json"]:
        print_json({**vars(outcome), "files": [str(path) for path in outcome.files]})
    else:
        print(f"{outcome.done} of {outcome.of} parts are complete: {outcome.files[0]}")
        for part, line in outcome.failed.items():
            print(f"failed: {part}: {line}", file=sys.stderr)
    return 130 if outcome.interrupted else 1 if outcome.failed else 0
