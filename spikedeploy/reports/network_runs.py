"""Runs of a network in open loop, over rasters and recordings: tables, and a page that replays."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from spikedeploy.console import print_text
from spikedeploy.emulation.event_replay import Replay
from spikedeploy.emulation.event_stream import EventRun
from spikedeploy.emulation.raster_emulation import CountedRun, Emulation, describe
from spikedeploy.reports.columns import energy_hint
from spikedeploy.reports.page import provenance, render
from spikedeploy.reports.table import ABSENT, HeadlineNumber, Table, format_bounds, format_si

_COUNTS = {
    "spikes": "spikes",
    "sops": "SOPs",
    "bias_sops": "bias SOPs",
    "neuron_updates": "neuron updates",
    "saturations": "saturations",
}


def print_emulation(run: Emulation, everything: bool = False) -> None:
    """Print the outputs, the counts, the costs and the layers of a run over a raster.

    everything: NeuroBench's measures too.
    """
    found = run.as_json()
    facts = _emulation_facts(run)
    facts |= _neurobench(found["neurobench"]) if everything else {}
    Table(("what", "found"), list(facts.items()), f"One inference on {run.chip}").print()
    _print_notes(run)
    rows = [
        (
            name,
            f"{layer['neurons']:,}",
            f"{layer['spikes']:,}",
            f"{layer['rate']:.4g}",
            _count(layer["sops"]),
        )
        for name, layer in found["layers"].items()
    ]
    rows += [
        (name, f"{readout['neurons']:,}", ABSENT, ABSENT, f"{readout['sops']:,}")
        for name, readout in found["readouts"].items()
    ]
    if rows:
        heads = ("layer", "neurons", "spikes", "rate", "SOPs")
        Table(heads, rows, "Layers; rate per neuron and timestep", numbers=True).print()
    if found["neurobench"] and not everything:
        print_text("NeuroBench's measures: --tables all")


def print_event_run(run: EventRun) -> None:
    """Print the recording, the counts, the costs, and the layers of a run over a recording."""
    for table in _event_tables(run):
        table.print()
    _print_notes(run)


def _print_notes(run: CountedRun) -> None:
    if hint := energy_hint([{"energy_per_inference_j": run.energies}]):
        print_text(hint)
    for remark in run.remarks:
        print(f"  {remark}")


def event_page(name: str, run: EventRun, replay: Replay) -> str:
    """The page of a run over a recording: name is the network's."""
    facts, layers = _event_tables(run)
    return render(
        "events",
        title=f"{name} on {run.chip} sees {run.given.recording.path.name}",
        lead=f"{run.given.seen:,} events in {run.seconds:.4g} s.",
        numbers=list(_headline(run)),
        episodes=[replay.as_json(run)],
        shown=replay.describe(),
        layers=layers,
        remarks=run.remarks,
        measured=[*facts.rows, *provenance()],
    )


def _headline(run: EventRun) -> Iterator[HeadlineNumber]:
    found, seconds = run.as_json(), run.seconds
    for key, title in (("spikes", "spikes"), ("sops", "synaptic operations")):
        if found[key] is not None:
            rate = f"{found[key] / seconds:,.0f}"
            yield HeadlineNumber(f"{title} a second", rate, (f"{found[key]:,} in all",))
    for table, power in list(found["power_w"].items())[:1]:
        yield HeadlineNumber("power of what it does", f"{format_si(power)}W", (f"by {table}",))


def _emulation_facts(run: Emulation) -> dict[str, str]:
    found = run.as_json()
    host = found.get("host") or {}
    facts = {
        "sums of outputs": ", ".join(
            f"{name} {describe(values)}" for name, values in run.outputs.items()
        ),
        **{said: f"{found[name]:,}" for name, said in _COUNTS.items() if found[name] is not None},
        **_energies(run),
        "timesteps": f"{found['timesteps']:,}",
        "convention": run.artifact.convention.describe(),
        "tuned": run.artifact.tuned or "",
        "clock": run.clock,
        "host": ", ".join(f"{host[k]:,} {k}" for k in ("multiplications", "additions") if host),
        "not counted": run.uncounted,
    }
    return {name: fact for name, fact in facts.items() if fact}


def _energies(run: CountedRun, seconds: float | None = None) -> dict[str, str]:
    """Energies with their bounds, and the power where they are of so many seconds."""
    return {
        f"energy, {name}": format_bounds(f"{format_si(e.value)}J", e.value, e.low, e.high)
        + (f", {format_si(e.value / seconds)}W" if seconds else "")
        for name, e in run.energies.items()
    }


def _neurobench(measures: Mapping[str, Any] | None) -> dict[str, str]:
    if measures is None:
        return {}
    flat = {**measures, **measures["SynapticOperations"]}
    return {name: f"{x:,.4g}" for name, x in flat.items() if isinstance(x, int | float)}


def _event_tables(run: EventRun) -> tuple[Table, Table]:
    """The tables of the results, and of the layers."""
    title = f"{run.seconds:.4g} s of events on {run.chip}"
    return Table(("what", "found"), list(_event_facts(run).items()), title), _event_layers(run)


def _event_facts(run: EventRun) -> dict[str, str]:
    found, seconds, given = run.as_json(), run.seconds, run.given
    size = given.recording.size
    channels, height, width = given.view.shape
    step = given.step_us
    facts = {
        "recording": f"{given.recording.path}, {given.events:,} events",
        "camera": f"{size[0]}x{size[1]} pixels (height x width)" if size else "",
        "seen": f"{given.seen:,} events, as {channels}x{height}x{width}",
        "not taken": f"{run.clipped:,} events" if run.clipped else "",
        "timesteps": f"{given.timesteps:,} of {step / 1e3:g} ms" if step else "",
        "convention": run.artifact.convention.describe(),
        "clock": run.clock,
        **{
            said: f"{found[name]:,}, {found[name] / seconds:,.4g} per s"
            for name, said in _COUNTS.items()
            if found[name]
        },
        **_energies(run, seconds),
        **{
            f"static, {name}": f"{format_si(joules)}J, not in the energies above"
            for name, joules in found["static_energy_j"].items()
        },
        **{name: f"sums {describe(np.ravel(sums)[None])}" for name, sums in run.outputs.items()},
        "not counted": run.uncounted,
    }
    return {name: fact for name, fact in facts.items() if fact}


def _event_layers(run: EventRun) -> Table:
    found, seconds = run.as_json(), run.seconds
    tables = list(found["energy_j"])
    rows = []
    for name, each in found["layers"].items():
        keys = ("neurons", "spikes", "spikes_per_s", "sops", "sops_per_s")
        joules = [each["energy_j"].get(table) for table in tables]
        powers = [ABSENT if j is None else f"{format_si(j / seconds)}W" for j in joules]
        rows.append([name, *(_count(each[key]) for key in keys), *powers])
    heads = ("layer", "neurons", "spikes", "per s", "SOPs", "per s", *tables)
    return Table(heads, rows, "Layers; per second of the recording", numbers=True)


def _count(value: float | None) -> str:
    return ABSENT if value is None else f"{value:,.0f}"
