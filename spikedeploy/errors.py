"""The errors that every package may raise; runtime.errors has those of networks and chips.

A message names what, what was found, the limit, and the remedy. The command line prints it without
a traceback and exits with 2. Any other exception is a bug.
"""


class SpikedeployError(Exception):
    """Any error that a user can act on."""


class ConfigError(SpikedeployError):
    """A configuration, option, name or file that does not exist or cannot be used."""
