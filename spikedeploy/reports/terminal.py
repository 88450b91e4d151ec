"""What people and machines read: tables and JSON on stdout, progress on stderr."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from spikedeploy.files import as_text

if TYPE_CHECKING:
    from rich.console import Console

    from spikedeploy.drift import DriftReport
    from spikedeploy.emulate import Emulation
    from spikedeploy.exporters.check import ParityCheck
    from spikedeploy.verify import ReplayedTrace

PIPE_WIDTH = 120


def print_json(data: object) -> None:
    """Write `data` as JSON, and nothing else."""
    print(as_text(data), end="")


def say(line: str) -> None:
    """Write a line on stderr, beside whatever goes to stdout."""
    console(stderr=True).print(line, markup=False)


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], numbers: bool = False
) -> None:
    """Write a table; with `numbers` every column after the first is set flush right."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False
    )
    for place, column in enumerate(columns):
        table.add_column(
            escape(column),
            justify="right" if numbers and place else "left",
            no_wrap=numbers and not place,
        )
    for row in rows:
        table.add_row(*row)
    console().print(table)


def print_checks(checks: "Iterable[ParityCheck]") -> None:
    """Write a line for each check: ✓ or ✗, what was compared, the numbers behind it."""
    for check in checks:
        mark = "[green]✓[/]" if check.passed else "[red]✗[/]"
        console().print(f"{mark} {check.name}: {check.detail}")


def print_replays(replays: "Iterable[ReplayedTrace]") -> None:
    """Write a line for each trace: ✓ or ✗, what was found, and what was passed over."""
    for replay in replays:
        print(f"{'✓' if replay.equal else '✗'} {replay.path}: {replay.describe()}")
        for remark in replay.remarks():
            print(f"    not compared: {remark}")


def print_comparison(document: Mapping[str, Any]) -> None:
    """Write the tables of a comparison, and what they mean."""
    from spikedeploy.reports.columns import tables

    rows = document["rows"]
    console().print(f"{document['env_id']}, episodes of each policy: {rows[0]['episodes']}\n")
    for title, columns in tables(rows).items():
        heads = [column.title for column in columns]
        cells = [[column.cell(row) for column in columns] for row in rows]
        print_table(title, heads, cells, numbers=True)
    for name, convention in document["conventions"].items():
        console().print(f"{name} is stepped with {convention}", markup=False)
    for label, remarks in document["remarks"].items():
        for remark in remarks:
            console().print(f"{label}: {remark}", markup=False)
    if document["meaning"]:
        console().print(document["meaning"])


def print_emulation(emulation: "Emulation") -> None:
    """Write how the network was stepped, what it did, and what that costs."""
    from rich.markup import escape

    from spikedeploy.reports.columns import bounded, scaled

    found = emulation.as_json()
    energies = {
        f"energy, {name}": bounded(f"{scaled(each.value)}J", each.value, each.low, each.high)
        for name, each in emulation.energies.items()
    }
    counts = ("timesteps", "spikes", "sops", "bias_sops", "neuron_updates", "saturations")
    lines = {
        "convention": escape(emulation.artifact.convention.describe()),
        **{
            name.replace("_", " "): f"{found[name]:,}" for name in counts if found[name] is not None
        },
        **{name: f"{value:,.4g}" for name, value in _operations(found["neurobench"]).items()},
        **energies,
        **({"not counted": escape(emulation.uncounted)} if emulation.uncounted else {}),
    }
    print_table(f"One inference on {emulation.chip}", ("what", "found"), lines.items())
    for remark in emulation.remarks:
        print(f"  {remark}")
    rows = [
        (
            escape(name),
            f"{layer['neurons']:,}",
            f"{layer['spikes']:,}",
            f"{layer['rate']:.4g}",
            "–" if layer["sops"] is None else f"{layer['sops']:,}",
        )
        for name, layer in found["layers"].items()
    ]
    if rows:
        heads = ("layer", "neurons", "spikes", "rate", "SOPs")
        print_table("Layers; rate per neuron and timestep", heads, rows, numbers=True)


def _operations(measures: Mapping[str, Any] | None) -> dict[str, float]:
    """Those of NeuroBench's numbers that are one each, by its names."""
    if measures is None:
        return {}
    flat = {**measures, **measures["SynapticOperations"]}
    return {name: value for name, value in flat.items() if isinstance(value, int | float)}


def print_drift(report: "DriftReport") -> None:
    """Write where a chip leaves the float twin, and what makes the difference."""
    from spikedeploy.reports.drift_tables import tables

    for title, heads, rows in tables(report):
        print_table(title, heads, rows)


def console(stderr: bool = False) -> "Console":
    """A console as wide as the terminal, or `PIPE_WIDTH` columns where there is none."""
    from rich.console import Console

    made = Console(stderr=stderr, highlight=False)
    if not made.is_terminal:
        made.width = PIPE_WIDTH
    return made


@contextmanager
def progress(description: str, total: int) -> Iterator[Callable[[], None]]:
    """A progress bar on stderr, and the function that moves it on by one."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console(stderr=True), transient=True) as bar:
        task = bar.add_task(description, total=total)
        yield lambda: bar.advance(task)
