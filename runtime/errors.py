"""The errors that every package may raise.

A message names the layer or option, the value found, the limit, and the remedy. The command line
prints it without a traceback and exits with 2. Any other exception is a bug.
"""


class SpikedeployError(Exception):
    """Any error that a user can act on."""


class ConfigError(SpikedeployError):
    """A configuration, option, name or file that does not exist or cannot be used."""


class ArtifactError(SpikedeployError):
    """A `.nir` file or graph that is damaged, inconsistent or not supported."""


def node_error(
    name: str,
    found: str,
    remedy: str = "Export the network again, or correct the node.",
    kind: type[SpikedeployError] = ArtifactError,
) -> SpikedeployError:
    """The error of a node: what was found there, and what to do."""
    return kind(f"node {name!r}: {found}. {remedy}")


class ConventionError(SpikedeployError):
    """A convention (dt, reset, integrator, ...) that is unknown, or impossible for the graph."""


class ChipError(SpikedeployError):
    """A chip, or an option of one, that does not exist."""


class RuleError(SpikedeployError):
    """A network that breaks a design rule of the chip it is compiled for."""


class ObservationError(SpikedeployError):
    """An observation or raster of the wrong shape, or with NaN or infinity in it."""


class EnvError(SpikedeployError):
    """An environment, an option, an action or a file of one that is not valid."""


class TraceError(SpikedeployError):
    """A trace file that is damaged, inconsistent, or of an unknown chip."""
