"""Where the energy of an inference goes, for a report: terms, totals, unknowns, break-even."""

from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any

from spikedeploy import envs
from spikedeploy.policies.costs import Costs
from spikedeploy.runtime.emulator.network import chip_called
from spikedeploy.runtime.metrics.break_even import BREAK_EVEN_TABLES, break_even_sops
from spikedeploy.runtime.metrics.energy import STATIC, TABLES, static_energy


def accounted(found: Costs, tables: Sequence[str]) -> dict[str, Any]:
    """The fields of a row that say where its energy goes, by the tables."""
    return {
        "macs_effective": found.effective_macs,
        "energy_zero_skipping_j": _of(found.energy_zero_skipping_j, tables),
        "energy_terms_j": _of(found.energy_terms_j, tables),
        "energy_unknown": {n: list(each) for n, each in _of(found.energy_unknown, tables).items()},
        "energy_total_j": {n: found.total_j(n) for n in _of(found.energy_terms_j, tables)},
        "neuron_updates_per_inference": found.neuron_updates,
        "neuron_idle_per_inference": found.neuron_idle,
        "messages_per_inference": found.messages,
        "messages_placed": found.messages_placed,
        "messages_placed_j": _of(found.messages_placed_j, tables),
    }


def _of(found: Mapping[str, Any], tables: Iterable[str]) -> dict[str, Any]:
    """The entries of the tables that are asked for."""
    return {name: found[name] for name in tables if name in found}


def static(chip: str | None, env: str, period: float | None = None) -> dict[str, float]:
    """Measurement -> energy [J] of the chip's static power in a control step; never added.

    period  of a control step [s] where it is known, else as the environment's class says
    """
    called = chip_called(chip) if chip else None
    powers = STATIC.get(called.name, ()) if called else ()
    period = period or (control_period(env) if powers else None)
    return {power.name: static_energy(period, power) for power in powers} if period else {}


def control_period(env: str) -> float | None:
    """Time of a control step [s], as the class of one of ours says; None where it does not."""
    if envs.spec(env).foreign:
        return None
    module, _, name = envs.spec(env).target.partition(":")
    world = getattr(import_module(module), name)
    rate = world.metadata.get("render_fps")
    return getattr(world, "CONTROL_DT", 1.0 / rate if rate else None)


def break_even(found: Costs, ann: Costs | None, tables: Sequence[str]) -> dict[str, Any]:
    """Synaptic operations at which a spiking row would cost what the float ANN costs, by table.

    Of all known terms; against the dense network, and against the one that skips zeros.
    """
    dense: dict[str, float] = {}
    skipping: dict[str, float] = {}
    for name in (n for n in tables if n in BREAK_EVEN_TABLES):
        terms, sops = found.energy_terms_j.get(name), found.sops
        total = ann.total_j(name) if ann else None
        if ann is None or terms is None or sops is None or total is None:
            continue
        dense[name] = break_even_sops(terms, sops, total, TABLES[name])
        if name in ann.energy_zero_skipping_j:
            saved = ann.energy_terms_j[name]["operations"] - ann.energy_zero_skipping_j[name]
            skipping[name] = break_even_sops(terms, sops, total - saved, TABLES[name])
    return {"break_even_sops": dense, "break_even_sops_zero_skipping": skipping}
