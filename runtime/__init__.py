"""The chips: what a `.nir` file holds, what a chip does with it, and what that costs.

Runs on numpy, nir and h5py alone. This table is the public interface; a name is imported when it
is first used, so `import runtime` is instant.
"""

from importlib import import_module

EXPORTS = {
    # the file
    "Artifact": "runtime.artifact:Artifact",
    "Codec": "runtime.codec:Codec",
    "Convention": "runtime.convention:Convention",
    "FloatGraph": "runtime.float_graph:FloatGraph",
    "Normaliser": "runtime.codec:Normaliser",
    "Origin": "runtime.origin:Origin",
    "PRESETS": "runtime.presets:PRESETS",
    "PopulationEncoder": "runtime.population:PopulationEncoder",
    "RateEncoder": "runtime.rate:RateEncoder",
    "load": "runtime.artifact:load",
    "save": "runtime.artifact:save",
    # the chip
    "CHIPS": "runtime.chip:CHIPS",
    "Chip": "runtime.chip:Chip",
    "EnergyTable": "runtime.energy:EnergyTable",
    "Ledger": "runtime.ledger:Ledger",
    "Machine": "runtime.machine:Machine",
    "Program": "runtime.program:Program",
    "SpikingController": "runtime.controllers:SpikingController",
}

__all__ = sorted(EXPORTS)


def __getattr__(name: str) -> object:
    """The public object called `name`, imported now."""
    if name not in EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = EXPORTS[name].split(":")
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted({*globals(), *EXPORTS})
