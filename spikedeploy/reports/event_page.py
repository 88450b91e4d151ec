"""Runs over recordings of event cameras: tables, and the page that replays them."""

from collections.abc import Iterator
from typing import Any

from spikedeploy.console import print_text
from spikedeploy.emulation.event_replay import Replay
from spikedeploy.emulation.event_stream import EventRun
from spikedeploy.reports.columns import energy_hint
from spikedeploy.reports.page import provenance, render
from spikedeploy.reports.table import ABSENT, HeadlineNumber, Table, format_bounds, format_si


def print_event_run(run: EventRun) -> None:
    """Print the recording, the counts, the costs, and the layers."""
    for table in _tables(run):
        table.print()
    if hint := energy_hint([{"energy_per_inference_j": run.energies}]):
        print_text(hint)
    for remark in run.remarks:
        print_text(f"  {remark}")


def event_page(name: str, run: EventRun, replay: Replay) -> str:
    """The page of a run: name is the network's."""
    facts, layers = _tables(run)
    return render(
        "events",
        title=f"{name} on {run.chip} sees {run.recording.path.name}",
        lead=f"{run.survey.seen:,} events in {run.seconds:.4g} s.",
        numbers=list(_numbers(run)),
        episodes=[replay.as_json(run)],
        shown=replay.describe(),
        layers=layers,
        remarks=run.remarks,
        measured=[*facts.rows, *provenance()],
    )


def _numbers(run: EventRun) -> Iterator[HeadlineNumber]:
    found, seconds = run.as_json(), run.seconds
    yield HeadlineNumber(
        "spikes a second", f"{found['spikes'] / seconds:,.0f}", (f"{found['spikes']:,} in all",)
    )
    if found["sops"] is not None:
        beside = (f"{found['sops']:,} in all",)
        yield HeadlineNumber(
            "synaptic operations a second", f"{found['sops'] / seconds:,.0f}", beside
        )
    for table, power in list(found["power_w"].items())[:1]:
        yield HeadlineNumber("power of what it does", f"{format_si(power)}W", (f"by {table}",))


def _tables(run: EventRun) -> tuple[Table, Table]:
    """The tables of the results, and of the layers."""
    title = f"{run.seconds:.4g} s of events on {run.chip}"
    return Table(("what", "found"), list(_facts(run).items()), title), _layers(run)


def _facts(run: EventRun) -> dict[str, str]:
    found, seconds = run.as_json(), run.seconds
    size, view = run.recording.size, run.view
    channels, height, width = view.shape
    counts = ("spikes", "sops", "bias_sops", "neuron_updates", "saturations")
    facts = {
        "recording": f"{run.recording.path}, {run.survey.events:,} events",
        "camera": f"{size[0]}x{size[1]} pixels (height x width)" if size else "",
        "seen": f"{run.survey.seen:,} events, as {channels}x{height}x{width}",
        "not taken": f"{run.clipped:,} events" if run.clipped else "",
        "timesteps": f"{run.steps.count:,} of {run.steps.us_each / 1e3:g} ms" if run.steps else "",
        "convention": run.artifact.convention.describe(),
        "clock": run.clock,
        **{
            name.replace("_", " "): f"{found[name]:,}, {found[name] / seconds:,.4g} per s"
            for name in counts
            if found[name]
        },
        **{f"energy, {name}": _energy(each, seconds) for name, each in run.energies.items()},
        **{
            f"static, {name}": f"{format_si(joules)}J, not in the energies above"
            for name, joules in found["static_energy_j"].items()
        },
        **{name: _output(values) for name, values in found["outputs"].items()},
        "not counted": run.uncounted,
    }
    return {name: fact for name, fact in facts.items() if fact}


def _energy(found: Any, seconds: float) -> str:  # noqa: ANN401
    bounds = format_bounds(f"{format_si(found.value)}J", found.value, found.low, found.high)
    return f"{bounds}, {format_si(found.value / seconds)}W"


def _output(values: list[Any]) -> str:
    """Sums of an output's elements, and the largest."""
    flat = [float(each) for each in _flat(values)]
    if not flat:
        return ""
    best = max(range(len(flat)), key=flat.__getitem__)
    shown = ", ".join(f"{each:.4g}" for each in flat[:10])
    more = f", … ({len(flat):,} elements)" if len(flat) > 10 else ""
    return f"sum {shown}{more}; largest: element {best}"


def _flat(values: Any) -> Iterator[Any]:  # noqa: ANN401
    if not isinstance(values, list):
        yield values
        return
    for each in values:
        yield from _flat(each)


def _layers(run: EventRun) -> Table:
    found, seconds = run.as_json(), run.seconds
    tables = list(found["energy_j"])
    rows = []
    for name, each in found["layers"].items():
        row = [
            name,
            f"{each['neurons']:,}",
            _count(each["spikes"]),
            _count(each["spikes_per_s"]),
            _count(each["sops"]),
            _count(each["sops_per_s"]),
        ]
        joules = [each["energy_j"].get(table) for table in tables]
        row += [ABSENT if j is None else f"{format_si(j / seconds)}W" for j in joules]
        rows.append(row)
    heads = ("layer", "neurons", "spikes", "per s", "SOPs", "per s", *(f"{t}" for t in tables))
    return Table(heads, rows, "Layers; per second of the recording", numbers=True)


def _count(value: float | None) -> str:
    return ABSENT if value is None else f"{value:,.0f}"
