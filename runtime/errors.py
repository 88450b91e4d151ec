"""Errors of networks, chips and files, beside those of every package in spikedeploy.errors."""

from spikedeploy.errors import ConfigError, SpikedeployError

__all__ = [
    "ArtifactError",
    "ChipError",
    "ConfigError",
    "ConventionError",
    "ObservationError",
    "RuleError",
    "SpikedeployError",
    "TraceError",
]


class ArtifactError(SpikedeployError):
    """A `.nir` file or graph that is damaged, inconsistent or not supported."""


class ConventionError(SpikedeployError):
    """A convention (dt, reset, integrator, ...) that is unknown, or impossible for the graph."""


class ChipError(SpikedeployError):
    """A chip, or an option of one, that does not exist."""


class RuleError(SpikedeployError):
    """A network that breaks a design rule of the chip it is compiled for."""


class ObservationError(SpikedeployError):
    """An observation or raster of the wrong shape, or with NaN or infinity in it."""


class TraceError(SpikedeployError):
    """A trace file that is damaged, inconsistent, or of an unknown chip."""
