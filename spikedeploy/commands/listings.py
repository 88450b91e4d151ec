"""`policies`, `chips`, `energy`, `envs`, `recipes`, and `doctor`: what there is to choose from."""

import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import typer

from spikedeploy.commands.options import Json


def _name(what: str) -> Any:  # noqa: ANN401 - an argument of typer
    return typer.Argument(metavar="[NAME]", help=f"One {what} in full.", show_default="all")


def policies(
    name: Annotated[str | None, _name("policy")] = None,
    json: Json = False,
) -> None:
    """List the shipped policies, by the names that the commands take."""
    if name is not None:
        _policy(name, json)
        return
    from spikedeploy import zoo
    from spikedeploy.console import print_json
    from spikedeploy.policies.registry import BUILT_IN, find
    from spikedeploy.reports.table import Table

    rows: list[dict[str, Any]] = []
    apart = [f"{zoo.FOR_CHIPS}/{file.parent.name}/{file.stem}" for file in zoo.for_chips()]
    for name in [*zoo.names(), *BUILT_IN, *apart]:
        candidate, card = find(name), zoo.card(name)
        row = {"name": name, "kind": candidate.kind, "env": candidate.env, "file": candidate.path}
        rows.append({**row, "recipe": card.get("recipe"), "chip": candidate.chip})
        rows[-1]["return_mean"] = zoo.mean_return(card) if card.get("evaluation") else None
    if json:
        print_json(rows)
        return
    columns = ("name", "kind", "env", "recipe", "return_mean")
    cells = [[_text(row[column]) for column in columns] for row in rows if row["name"] not in apart]
    Table(("name", "kind", "environment", "recipe", "return"), cells, "Policies").print()
    folders: dict[str, list[str]] = {}
    for folder, _, last in (name.rpartition("/") for name in apart):
        folders.setdefault(f"{folder}/", []).append(last)
    cells = [[folder, ", ".join(names)] for folder, names in folders.items()]
    heads = ("name begins with", "and ends with one of")
    Table(heads, cells, "For one chip each, and the teachers that they imitate").print()


def _policy(name: str, json: bool) -> None:
    """Print the card of a policy, and its evaluation."""
    from spikedeploy import zoo
    from spikedeploy.console import print_json
    from spikedeploy.policies.registry import find
    from spikedeploy.reports.datasheets import policy_facts
    from spikedeploy.reports.terminal import print_rows

    candidate, card = find(name), zoo.card(name)
    facts = card or {"file": candidate.path, "kind": candidate.kind, "env": candidate.env}
    if json:
        print_json({"name": name, **facts})
        return
    policy_facts(name, facts).print()
    if card.get("evaluation"):
        print_rows("As it was evaluated", card["evaluation"])


def _text(value: object) -> str:
    return f"{value:,.0f}" if isinstance(value, float) else str(value or "–")


def chips(
    name: Annotated[str | None, _name("chip")] = None,
    json: Json = False,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the table of docs/chips.md.")
    ] = False,
) -> None:
    """List the chips: their arithmetic, and what it was compared with.

    Fields can be changed wherever a chip is named: --chip int:weight_bits=4,membrane=12. The file
    of a datasheet can be named instead: --chip ./mine.toml.
    """
    from spikedeploy.console import print_json
    from spikedeploy.reports.datasheets import chip_list, chip_summaries, chip_table
    from spikedeploy.runtime.chips.chip import CHIPS, chip

    if name is not None:
        _chip(name, json)
        return
    known = [chip(each) for each in CHIPS]
    if json:
        print_json(chip_list(known))
    elif markdown:
        typer.echo(chip_table(known).markdown())
    else:
        chip_summaries(known).print()
        chip_table(known).print()


def _chip(name: str, json: bool) -> None:
    """Print everything about a chip, with the source of every number."""
    from spikedeploy.console import print_json
    from spikedeploy.reports.datasheets import chip_list, datasheet
    from spikedeploy.runtime.chips.chip import chip

    found = chip(name)
    if json:
        print_json(chip_list([found])[0])
        return
    for table in datasheet(found):
        table.print()


def energy(
    name: Annotated[str | None, _name("energy table")] = None,
    json: Json = False,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the table of docs/energy.md.")
    ] = False,
    break_even: Annotated[
        bool, typer.Option("--break-even", help="Spike rates below which spiking costs less.")
    ] = False,
) -> None:
    """List the energy tables: prices of events, sources, uncertainty."""
    from spikedeploy.console import print_json
    from spikedeploy.reports import datasheets

    if name is not None:
        _energy(name, json)
    elif break_even:
        _break_even(json, markdown)
    elif json:
        print_json(datasheets.price_list())
    elif markdown:
        typer.echo(datasheets.energy_markdown())
    else:
        for table in datasheets.energy_overview():
            table.print()
        typer.echo(datasheets.energy_choice())


def _energy(name: str, json: bool) -> None:
    """Print everything about an energy table."""
    from spikedeploy.console import print_json
    from spikedeploy.reports.datasheets import energy_sheet, price_list
    from spikedeploy.runtime.metrics.energy import energy_table

    table = energy_table(name)
    if json:
        print_json(next(each for each in price_list()["tables"] if each["name"] == name))
        return
    for each in energy_sheet(table):
        each.print()


def _break_even(json: bool, markdown: bool) -> None:
    """Print the break-even lines."""
    from spikedeploy.console import print_json
    from spikedeploy.reports import datasheets
    from spikedeploy.runtime.metrics.energy import YAN2024

    if json:
        print_json({"rates": datasheets.break_even_list(), "yan2024": YAN2024})
    elif markdown:
        typer.echo(datasheets.break_even_table().markdown())
    else:
        datasheets.break_even_table().print()
        typer.echo(datasheets.BREAK_EVEN_NOTE)


def envs(json: Json = False) -> None:
    """List the environments."""
    from spikedeploy.console import print_json
    from spikedeploy.envs import ENVS
    from spikedeploy.reports.table import Table

    rows = [(spec.short, spec.id, spec.summary) for spec in ENVS.values()]
    if json:
        print_json([dict(zip(("name", "id", "summary"), row, strict=True)) for row in rows])
    else:
        Table(("name", "id", "task"), rows, "Environments").print()


def recipes(json: Json = False) -> None:
    """List the training recipes, by algorithm."""
    from spikedeploy.console import print_json
    from spikedeploy.reports.table import Table
    from spikedeploy.trainers import ALGORITHMS
    from spikedeploy.trainers.recipes import RECIPES, budget

    rows = [(name, recipe.algorithm, recipe.summary) for name, recipe in RECIPES.items()]
    if json:
        print_json([dict(zip(("name", "algorithm", "summary"), row, strict=True)) for row in rows])
        return
    for algorithm in ALGORITHMS:
        cells = [
            (name, summary, budget(RECIPES[name])) for name, of, summary in rows if of == algorithm
        ]
        heads = ["name", "trains", "operations"][: 3 if any(cell[2] for cell in cells) else 2]
        shown = [cell[: len(heads)] for cell in cells]
        Table(heads, shown, f"Recipes of the algorithm {algorithm}").print()


RUN = ("numpy", "nir", "h5py", "gymnasium", "mujoco", "onnxruntime", "matplotlib", "av")
TRAIN = ("torch", "snntorch", "pydantic", "safetensors", "onnx")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class DoctorFinding:
    """One line of the report.

    name    what was examined
    ok      whether it works; None for information
    detail  what was found, and what to do about it
    """

    name: str
    ok: bool | None
    detail: str


def doctor(json: Json = False) -> None:
    """Check versions, threads, rendering and the shipped policies; exit 1 if one fails."""
    from spikedeploy.console import print_json
    from spikedeploy.reports.table import Table

    found = findings()
    if json:
        print_json([vars(finding) for finding in found])
    else:
        marks = {True: "✓", False: "✗", None: " "}
        rows = [(marks[f.ok], f.name, f.detail) for f in found]
        Table(("", "what", "found"), rows, "Doctor").print()
    raise typer.Exit(1 if any(finding.ok is False for finding in found) else 0)


def findings() -> list[DoctorFinding]:
    """Everything that is examined, in order."""
    return [*_versions(), _tested(), _threads(), _tried("rendering", _draw), *_policies()]


def _versions() -> Iterator[DoctorFinding]:
    from spikedeploy.trainers.versions import installed, own

    yield DoctorFinding("spikedeploy", None, f"{own()} on Python {platform.python_version()}")
    for package in RUN:
        found = installed(package)
        yield DoctorFinding(package, found is not None, found or 'missing: pip install "."')
    for package in TRAIN:
        missing = 'not installed: pip install ".[train]" to train and export'
        yield DoctorFinding(package, None, installed(package) or missing)


def _tested() -> DoctorFinding:
    """Which versions differ from the tested set."""
    from spikedeploy.tested_set import differences, tested

    of, differ = len(tested()), differences()
    if not differ:
        return DoctorFinding("tested set", None, f"no version differs, of {of} packages")
    remedy = "if something fails: pip install -c constraints.txt, from a checkout"
    return DoctorFinding("tested set", None, f"{len(differ)} differ: {', '.join(differ)}; {remedy}")


def _threads() -> DoctorFinding:
    from spikedeploy.jobs.pool import cores

    limits = {name: os.environ.get(name, "all") for name in THREADS}
    limit = ", ".join(f"{name}={value}" for name, value in limits.items())
    return DoctorFinding("threads", None, f"{cores()} cores; {limit}")


def _draw() -> str:
    """A rendered picture in words."""
    from spikedeploy import envs

    env = envs.make("hexapod", render_mode="rgb_array")
    env.reset(seed=0)
    height, width, _ = env.render().shape  # type: ignore[union-attr]
    env.close()
    return f"{width} × {height} pixels through MUJOCO_GL={os.environ.get('MUJOCO_GL', 'default')}"


def _policies() -> Iterator[DoctorFinding]:
    """Return True if every shipped policy opens."""
    from spikedeploy import zoo

    for name in zoo.names():
        yield _tried(name, partial(_opened, name))


def _opened(name: str) -> str:
    from spikedeploy.policies.registry import find

    return f"opens, kind {find(name).kind}"


def _tried(name: str, attempt: Callable[[], str]) -> DoctorFinding:
    try:
        return DoctorFinding(name, True, attempt())
    except Exception as error:  # a doctor reports whatever is wrong
        return DoctorFinding(name, False, f"{type(error).__name__}: {error}")
