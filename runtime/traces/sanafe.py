"""Counts and energies that SANA-FE gives for a network of one layer, against our ledger."""

import math
import re
from dataclasses import replace

import numpy as np

from spikedeploy.runtime.chips.chip import chip
from spikedeploy.runtime.chips.layer import Synapses, plain_layer
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.convention import Convention
from spikedeploy.runtime.emulator.ledger import Ledger
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.metrics.energy_tables import TABLES
from spikedeploy.runtime.traces.fields import Fields
from spikedeploy.runtime.traces.verdict import TraceDifference, Verdict, nothing_to_compare

_NUMBER = r"([1-9]\d{0,2})"
_SETUP = re.compile(
    rf"{_NUMBER} input neurons spiking \[([01](?:, *[01])*)\] *-> *all-to-all *-> *"
    rf"{_NUMBER} loihi_lif neurons \(threshold 1e9\), one core, {_NUMBER} steps"
)
# what SANA-FE calls a part of the energy -> our events
_ENERGIES = {
    "synapse": ("sop", "bias_sop"),
    "dendrite": (),
    "soma": ("neuron_update", "neuron_idle", "spike_out"),
    "network": ("message",),
}
_COUNTS = {
    "spikes(synops)": ("sop",),
    "packets_sent": ("message",),
    "neurons_fired": ("spike_in", "spike_out"),
    "neurons_updated": ("neuron_update", "spike_in"),
}
_NEVER = ((1 << 17) - 1) << 6  # a threshold that so few inputs do not reach
_TOLERANCE = 1e-6


def sanafe_verdict(fields: Fields, _: str) -> Verdict:
    """The verdict on SANA-FE's counts and energies, by our ledger and its table."""
    text = fields.text("setup").strip()
    setup = _SETUP.fullmatch(text)
    if setup is None:
        raise TraceError(
            f"{fields.where}: setup is {text[:60]!r}, which cannot be read. docs/traces.md has the "
            "sentence that can."
        )
    inputs, bits, neurons, steps = setup.groups()
    spikes = [int(bit) for bit in bits.split(",")]
    if len(spikes) != int(steps) or int(inputs) * sum(spikes) << 6 > _NEVER:
        remedy = "Write one for each step, and so few that no neuron spikes."
        raise fields.wrong("setup", f"has {len(spikes)} steps, {sum(spikes)} of spikes", remedy)
    result = fields.group("result")
    energy = result.group("energy")
    known = [(result, name) for name in _COUNTS] + [(energy, n) for n in ("total", *_ENERGIES)]
    expected = {name: float(group.floats(name)[0]) for group, name in known if name in group}
    if not expected:
        raise nothing_to_compare(fields, ())
    found = _totals(_run(int(inputs), int(neurons), spikes))
    different = (
        TraceDifference(None, None, None, name, value, found[name])
        for name, value in expected.items()
        if not math.isclose(value, found[name], rel_tol=_TOLERANCE, abs_tol=1e-15)
    )
    return Verdict(
        chip="loihi1",
        source=fields.text("source"),
        steps=len(spikes),
        compared=len(expected),
        passed_over=int("sim_time" in result),
        why="time, of which ours is an upper bound",
        difference=next(different, None),
        unread=(),
    )


def _run(inputs: int, neurons: int, spikes: list[int]) -> Ledger:
    synapses = Synapses("input", np.ones((inputs, neurons), np.int16), 1)
    ones = np.ones(neurons, np.int64)
    layer = replace(
        plain_layer("lif", [synapses], _NEVER * ones), membrane_decay=4096 * ones, start=1
    )
    machine = Machine(
        Program(chip("loihi1"), Convention(1e-3), "input", inputs, (layer,), "lif", None)
    )
    for spiking in spikes:
        machine.step(np.full((1, inputs), spiking, np.uint8))
    return machine.ledger


def _totals(ledger: Ledger) -> dict[str, float]:
    """Return counts and energies [J]; SANA-FE's inputs send messages and cost nothing else."""
    prices = TABLES["sanafe"].joules
    counts = {name: sum(map(ledger.total, events)) for name, events in _COUNTS.items()}
    parts = {
        name: sum(ledger.total(event) * prices[event] for event in events)
        for name, events in _ENERGIES.items()
    }
    return {**counts, **parts, "total": sum(parts.values())}
