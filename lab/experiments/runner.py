"""What an experiment is: jobs that fill a table of results/, and a page made of the table.

Each row is written as soon as it is measured, so that a stopped command goes on where it was.
"""

import argparse
import csv
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from spikedeploy.comparison.statistics import Estimate
from spikedeploy.reports.table import ABSENT
from spikedeploy.runtime.files import replacing, write_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found, unused-ignore]

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results"
Record = dict[str, Any]
Job = tuple[Any, ...]
TASKS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("tasks.toml").read_text("utf-8"))


@dataclass(frozen=True)
class Experiment:
    """A table, and how it is filled and shown.

    name: of results/NAME.csv, results/NAME.md and templates/NAME.md
    columns: of the table; a job is named by the first of them
    texts: the columns that hold text; others hold JSON
    jobs: what is to be measured with so many training seeds, in order: values of the first columns
    measure: makes the rows of a job
    facts: what the page shows of all rows
    is_current: whether a row is of what would be measured today
    """

    name: str
    columns: Sequence[str]
    texts: Sequence[str]
    jobs: Callable[[int], Iterable[Job]]
    measure: Callable[[Job], Iterable[Record]]
    facts: Callable[[list[Record]], Record]
    is_current: Callable[[Record], bool] = lambda row: True

    @property
    def table(self) -> Path:
        """The table."""
        return RESULTS / f"{self.name}.csv"

    def read(self) -> list[Record]:
        """Return the rows of the table."""
        return read_rows(self.table, self.texts) if self.table.is_file() else []

    def page(self, rows: list[Record]) -> str:
        """Return the page that shows the rows."""
        return render(self.name, **self.facts(rows))

    def fill(self, jobs: Iterable[Job], again: bool = False) -> Iterator[Job]:
        """Measure the jobs that have no current rows, or all; yield each whose rows are written."""
        rows = self.read()
        for job in jobs:
            old = [row for row in rows if self._is_of(row, job)]
            if old and not again and all(map(self.is_current, old)):
                continue
            rows = [row for row in rows if row not in old] + list(self.measure(job))
            write_rows(rows, self.columns, self.table)
            yield job

    def _is_of(self, row: Record, job: Job) -> bool:
        return tuple(row[name] for name in self.columns[: len(job)]) == job

    def main(self) -> None:
        """Read the command line, measure what is missing, and write the page."""
        parser = argparse.ArgumentParser(description=f"Make results/{self.name}.csv and its page.")
        parser.add_argument("--only", default="", metavar="NAME", help="jobs whose names begin so")
        parser.add_argument("--seeds", type=int, default=3, help="trainings of each policy (3)")
        parser.add_argument("--again", action="store_true", help="rows that are there, too")
        parser.add_argument("--page", action="store_true", help="the page alone")
        given = parser.parse_args()
        jobs = [
            job
            for job in (() if given.page else self.jobs(given.seeds))
            if "/".join(map(str, job)).startswith(given.only)
        ]
        for job in self.fill(jobs, given.again):
            print(*job, flush=True)
        print(write_text(RESULTS / f"{self.name}.md", self.page(self.read())))


def trained(name: str, recipe: str, env: str, settings: Sequence[str] = (), seed: int = 0) -> Path:
    """Return the run folder of a training below runs/NAME, which is resumed or started.

    Exits as a shell expects where the training is interrupted.
    """
    from spikedeploy.trainers.progress import Interrupt
    from spikedeploy.trainers.train import train

    runs, stopped = ROOT / "runs" / name, Interrupt()
    found = sorted(runs.glob("*/checkpoints/last.*"))
    if found:
        run = train(None, resume=found[0].parents[1], quiet=True, interrupt=stopped)
    else:
        run = train(
            recipe, env=env, overrides=settings, seed=seed, runs=runs, quiet=True, interrupt=stopped
        )
    if stopped.share is not None:
        raise SystemExit(stopped.exit_code)
    return run


def read_rows(path: Path, texts: Sequence[str]) -> list[Record]:
    """Return the rows of a CSV; missing fields are None. Columns other than `texts` hold JSON."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {
                name: text if name in texts else json.loads(text or "null")
                for name, text in row.items()
            }
            for row in csv.DictReader(file)
        ]


def write_rows(rows: Iterable[Record], columns: Sequence[str], path: Path) -> None:
    """Write rows as CSV with every digit; lists are JSON, missing fields empty."""
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {n: json.dumps(v) if isinstance(v, list) else v for n, v in row.items()} for row in rows
        )


# pages


def number(value: float | None, form: str = ",.0f") -> str:
    """Return a number, or a dash where there is none."""
    return ABSENT if value is None else format(value, form)


def share(found: Estimate) -> str:
    """Return `99.5% [99.2%, 99.8%]`."""
    low, high = found.ci95
    return f"{found.mean:.1%} [{low:.1%}, {high:.1%}]"


_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).with_name("templates")),
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    autoescape=False,
    keep_trailing_newline=True,
)
_TEMPLATES.filters |= {"number": number, "share": share, "form": format}


def render(template: str, **facts: Any) -> str:  # noqa: ANN401
    """Return the page of a template."""
    return _TEMPLATES.get_template(f"{template}.md").render(**facts)
