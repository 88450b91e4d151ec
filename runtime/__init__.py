"""The chips: what a `.nir` file holds, what a chip does with it, and what that costs.

Runs on numpy, nir and h5py alone. This table is the public interface; a name is imported when it
is first used, so `import runtime` is instant.
"""

from importlib import import_module

EXPORTS = {
    # the file
    "Artifact": "spikedeploy.runtime.artifact.artifact:Artifact",
    "Codec": "spikedeploy.runtime.codec.codec:Codec",
    "Convention": "spikedeploy.runtime.convention:Convention",
    "FloatGraph": "spikedeploy.runtime.float_model.graph:FloatGraph",
    "Normaliser": "spikedeploy.runtime.codec.codec:Normaliser",
    "Origin": "spikedeploy.runtime.metadata:Provenance",
    "PRESETS": "spikedeploy.runtime.artifact.presets.preset:PRESETS",
    "PopulationEncoder": "spikedeploy.runtime.codec.population:PopulationEncoder",
    "RateEncoder": "spikedeploy.runtime.codec.rate:RateEncoder",
    "load": "spikedeploy.runtime.artifact.artifact:load",
    "save": "spikedeploy.runtime.artifact.artifact:save",
    # the chip
    "CHIPS": "spikedeploy.runtime.chips.chip:CHIPS",
    "Chip": "spikedeploy.runtime.chips.chip:Chip",
    "EnergyTable": "spikedeploy.runtime.metrics.energy:EnergyTable",
    "Ledger": "spikedeploy.runtime.emulator.ledger:Ledger",
    "Machine": "spikedeploy.runtime.emulator.machine:Machine",
    "Program": "spikedeploy.runtime.compiler.program:Program",
    "SpikingController": "spikedeploy.runtime.emulator.controllers:SpikingController",
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
