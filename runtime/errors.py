"""The errors raised on purpose: each names the thing, what was found and what to do.

The command line prints them without a traceback. Anything else that is raised is a bug.
"""


class SpikedeployError(Exception):
    """Any error that a user can act on."""


class ArtifactError(SpikedeployError):
    """A `.nir` file that is broken, contradicts itself, or holds what is not supported."""


class ConventionError(SpikedeployError):
    """A dt, reset, integrator, delay or state that is unknown or impossible."""


class ChipError(SpikedeployError):
    """A chip, or an option of one, that does not exist."""


class RuleError(SpikedeployError):
    """A network that breaks a design rule of the chip it is compiled for."""


class ObservationError(SpikedeployError):
    """An observation or raster with the wrong shape, or with NaN or infinity in it."""


class ConfigError(SpikedeployError):
    """A configuration, option or name that the product does not know."""


class TraceError(SpikedeployError):
    """A trace file that is broken, contradicts itself, or is of a chip that is not known."""
