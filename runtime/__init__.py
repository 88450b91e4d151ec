"""Neuromorphic chips in software: read a `.nir` file, compile it, emulate it, count what it costs.

NumPy, nir, h5py, pydantic and filelock are required; numba is optional. EXPORTS is the
public interface; a name is imported when it is first used, so that importing this package loads
nothing heavy.

errors           the errors that every package may raise
files            atomic writes, JSON, locks
schema           data from files, checked
choices          choices that a user has, by name
requests         requests such as noise:2 or payload=0.4
requirements     packages that are needed, and the sentence for one that is missing
camera_events    events of cameras, and the file they are recorded to
copies           copies of objects with states
metadata         metadata of a `.nir` file, and the provenance of a policy
convention       dt, reset, integrator, delay: what NIR leaves open
graph/           the NIR graph: neurons, order, shapes, validation
codec/           observations to spikes, network output to actions
dialects/        what other tools mean by a NIR file
artifact/        the `.nir` file: reading and writing
float_model      the graph in floating point: the reference
chips/           datasheets, the classes of a chip, a layer and its state
compiler/        graph and chip to an integer program
faults           chips with broken parts, and with upsets while they run
emulator/        programs run on observations; the ledger of events
families/        arithmetics: quantiser, neuron update, kernels
metrics/         energy, time, memory, messages, NeuroBench
analysis/        activity, drift from float, diagnosis
traces/          recorded traces of chips and simulators, compared with the emulation
"""

from functools import cache
from importlib import import_module

from spikedeploy.runtime.requirements import check_requirements

EXPORTS = {
    # the file
    "Artifact": "spikedeploy.runtime.artifact.artifact:Artifact",
    "Codec": "spikedeploy.runtime.codec.codec:Codec",
    "Convention": "spikedeploy.runtime.convention:Convention",
    "DeltaEncoder": "spikedeploy.runtime.codec.delta:DeltaEncoder",
    "FloatGraph": "spikedeploy.runtime.float_model:FloatGraph",
    "Normaliser": "spikedeploy.runtime.codec.codec:Normaliser",
    "PRESETS": "spikedeploy.runtime.dialects.tools:PRESETS",
    "PopulationEncoder": "spikedeploy.runtime.codec.population:PopulationEncoder",
    "Provenance": "spikedeploy.runtime.metadata:Provenance",
    "RateEncoder": "spikedeploy.runtime.codec.rate:RateEncoder",
    "load": "spikedeploy.runtime.artifact.artifact:load",
    "save": "spikedeploy.runtime.artifact.artifact:save",
    # the chip
    "CHIPS": "spikedeploy.runtime.chips.chip:CHIPS",
    "Chip": "spikedeploy.runtime.chips.chip:Chip",
    "EnergyTable": "spikedeploy.runtime.metrics.energy_tables:EnergyTable",
    "EventMachine": ("spikedeploy.runtime.families.integrate_and_fire.event_machine:EventMachine"),
    "Ledger": "spikedeploy.runtime.emulator.ledger:Ledger",
    "Machine": "spikedeploy.runtime.emulator.machine:Machine",
    "Program": "spikedeploy.runtime.compiler.program:Program",
    "SpikingController": "spikedeploy.runtime.emulator.controllers:SpikingController",
}

__all__ = sorted(EXPORTS)

_check_once = cache(check_requirements)


def __getattr__(name: str) -> object:
    """The public object called `name`, imported now."""
    if name not in EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    _check_once()  # a package of a wrong version is a sentence, not a traceback
    module, attribute = EXPORTS[name].split(":")
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted({*globals(), *EXPORTS})
