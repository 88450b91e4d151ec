"""`policies`, `chips`, `energy`, `envs`, `recipes`, and `doctor`: what there is to choose from."""

import os
import platform
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spikedeploy.commands.options import Json
from spikedeploy.console import print_json

if TYPE_CHECKING:
    from spikedeploy.policies.registry import Candidate
    from spikedeploy.reports.table import Table


def _show(data: object, tables: Iterable["Table"], json: bool, note: str = "") -> None:
    if json:
        print_json(data)
        return
    for table in tables:
        table.print()
    if note:
        typer.echo(note)


def policies(
    *,
    name: Annotated[str, typer.Argument(metavar="[NAME]")] | None = None,
    json: Json = False,
) -> None:
    """List the shipped policies, by the names that the commands take.

    name: one policy in full (default: all)
    """
    if name is not None:
        _policy(name, json)
        return
    from spikedeploy import zoo
    from spikedeploy.policies.registry import BUILT_IN
    from spikedeploy.reports.table import Table

    rows: list[dict[str, Any]] = []
    apart = [f"{zoo.FOR_CHIPS}/{file.parent.name}/{file.stem}" for file in zoo.for_chips()]
    for name in [*zoo.names(), *BUILT_IN, *apart]:
        candidate, card = _shipped(name), zoo.card(name)
        row = {"name": name, "kind": candidate.kind, "env": candidate.env, "file": candidate.path}
        rows.append({**row, "recipe": card.get("recipe"), "chip": candidate.chip})
        rows[-1]["return_mean"] = zoo.mean_return(card) if card.get("evaluation") else None
    columns = ("name", "kind", "env", "recipe", "return_mean")
    cells = [[_text(row[column]) for column in columns] for row in rows if row["name"] not in apart]
    folders: dict[str, list[str]] = {}
    for folder, _, last in (name.rpartition("/") for name in apart):
        folders.setdefault(f"{folder}/", []).append(last)
    tables = [
        Table(("name", "kind", "environment", "recipe", "return"), cells, "Policies"),
        Table(
            ("name begins with", "and ends with one of"),
            [[folder, ", ".join(names)] for folder, names in folders.items()],
            "For one chip each, and the teachers that they imitate",
        ),
    ]
    _show(rows, tables, json)


def _policy(name: str, json: bool) -> None:
    from spikedeploy import zoo
    from spikedeploy.reports.datasheets import policy_facts
    from spikedeploy.reports.terminal import print_rows

    candidate, card = _shipped(name), zoo.card(name)
    facts = card or {"file": candidate.path, "kind": candidate.kind, "env": candidate.env}
    _show({"name": name, **facts}, [policy_facts(name, facts)], json)
    if card.get("evaluation") and not json:
        print_rows("As it was evaluated", card["evaluation"])


def _shipped(name: str) -> "Candidate":
    """The shipped policy of a name, whatever lies at that path here; else the one at the path."""
    from spikedeploy import zoo
    from spikedeploy.policies.registry import find

    return find(str(zoo.path(name) or name))


def _text(value: object) -> str:
    return f"{value:,.0f}" if isinstance(value, float) else str(value or "–")


def chips(
    *,
    name: Annotated[str, typer.Argument(metavar="[NAME]")] | None = None,
    json: Json = False,
    markdown: bool = False,
) -> None:
    """List the chips: their arithmetic, and what it was compared with.

    Fields can be changed wherever a chip is named: --chip int:weight_bits=4,membrane=12. The file
    of a datasheet can be named instead: --chip ./mine.toml.

    name: one chip in full (default: all)

    Output:
        markdown: print the table of docs/chips.md
    """
    from spikedeploy.reports.datasheets import chip_list, chip_summaries, chip_table, datasheet
    from spikedeploy.runtime.chips.chip import CHIPS, chip

    if name is not None:
        found = chip(name)
        _show(chip_list([found])[0], datasheet(found), json)
        return
    known = [chip(each) for each in CHIPS]
    if markdown and not json:
        typer.echo(chip_table(known).markdown())
    else:
        _show(chip_list(known), (chip_summaries(known), chip_table(known)), json)


def energy(
    *,
    name: Annotated[str, typer.Argument(metavar="[NAME]")] | None = None,
    json: Json = False,
) -> None:
    """List the energy tables: prices of events, sources, uncertainty.

    name: one energy table in full (default: all)
    """
    from spikedeploy.reports import datasheets
    from spikedeploy.runtime.metrics.energy import energy_table

    if name is not None:
        table = energy_table(name)
        priced = next(each for each in datasheets.price_list()["tables"] if each["name"] == name)
        _show(priced, datasheets.energy_sheet(table), json)
    else:
        tables, note = datasheets.energy_overview(), datasheets.energy_choice()
        _show(datasheets.price_list(), tables, json, note)


def envs(*, json: Json = False) -> None:
    """List the environments."""
    from spikedeploy.envs import ENVS
    from spikedeploy.reports.table import Table

    rows = [(spec.short, spec.id, spec.summary) for spec in ENVS.values()]
    data = [dict(zip(("name", "id", "summary"), row, strict=True)) for row in rows]
    _show(data, [Table(("name", "id", "task"), rows, "Environments")], json)


def recipes(*, json: Json = False) -> None:
    """List the training recipes, by algorithm."""
    from spikedeploy.reports.table import Table
    from spikedeploy.trainers import ALGORITHMS
    from spikedeploy.trainers.recipes import RECIPES, budget

    rows = [(name, recipe.algorithm, recipe.summary) for name, recipe in RECIPES.items()]
    tables = []
    for algorithm in ALGORITHMS:
        cells = [
            (name, summary, budget(RECIPES[name])) for name, of, summary in rows if of == algorithm
        ]
        heads = ["name", "trains", "operations"][: 3 if any(cell[2] for cell in cells) else 2]
        shown = [cell[: len(heads)] for cell in cells]
        tables.append(Table(heads, shown, f"Recipes of the algorithm {algorithm}"))
    _show([dict(zip(("name", "algorithm", "summary"), row, strict=True)) for row in rows], tables,
          json)  # fmt: skip


RUN = ("numpy", "nir", "h5py", "gymnasium", "mujoco", "onnxruntime", "matplotlib", "av")
TRAIN = ("torch", "snntorch", "pydantic", "safetensors", "onnx")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class DoctorFinding:
    """One line of the report.

    name: what was examined
    ok: whether it works; None for information
    detail: what was found, and what to do about it
    """

    name: str
    ok: bool | None
    detail: str


def doctor(*, json: Json = False) -> None:
    """Check versions, threads, rendering and the shipped policies; exit 1 if one fails."""
    from spikedeploy import zoo
    from spikedeploy.reports.table import Table

    found = [*_versions(), *_wrong(), _threads(), _tried("rendering", _draw)]
    for policy in (_tried(name, partial(_opened, name)) for name in zoo.names()):
        if policy.ok or policy.detail not in {each.detail for each in found}:
            found.append(policy)
    marks = {True: "✓", False: "✗", None: " "}
    rows = [(marks[f.ok], f.name, f.detail) for f in found]
    _show(
        [vars(finding) for finding in found], [Table(("", "what", "found"), rows, "Doctor")], json
    )
    raise typer.Exit(1 if any(finding.ok is False for finding in found) else 0)


def _versions() -> Iterator[DoctorFinding]:
    from spikedeploy.trainers.versions import installed_version, own

    yield DoctorFinding("spikedeploy", None, f"{own()} on Python {platform.python_version()}")
    for package in RUN:
        found = installed_version(package)
        yield DoctorFinding(package, found is not None, found or 'missing: pip install "."')
    for package in TRAIN:
        missing = 'not installed: pip install ".[train]" to train and export'
        yield DoctorFinding(package, None, installed_version(package) or missing)


def _wrong() -> Iterator[DoctorFinding]:
    """A finding for each package that is missing or of a version that is not supported."""
    from spikedeploy.runtime.requirements import wrong_requirements

    for sentence in wrong_requirements(extras=True):
        yield DoctorFinding("version", False, sentence)


def _threads() -> DoctorFinding:
    from spikedeploy.jobs import cores

    limits = {name: os.environ.get(name, "all") for name in THREADS}
    limit = ", ".join(f"{name}={value}" for name, value in limits.items())
    return DoctorFinding("threads", None, f"{cores()} cores; {limit}")


def _draw() -> str:
    from spikedeploy import envs

    env = envs.make("hexapod", render_mode="rgb_array")
    env.reset(seed=0)
    height, width, _ = env.render().shape  # type: ignore[union-attr]
    env.close()
    return f"{width} × {height} pixels through MUJOCO_GL={os.environ.get('MUJOCO_GL', 'default')}"


def _opened(name: str) -> str:
    return f"opens, kind {_shipped(name).kind}"


def _tried(name: str, attempt: Callable[[], str]) -> DoctorFinding:
    try:
        return DoctorFinding(name, True, attempt())
    except Exception as error:  # a doctor reports whatever is wrong
        from spikedeploy.user_errors import one_line

        return DoctorFinding(name, False, one_line(error) or f"{type(error).__name__}: {error}")
