"""The one exception of the worlds."""


class EnvError(Exception):
    """An environment was asked for, built or driven in a way that it cannot obey."""
