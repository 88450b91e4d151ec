"""EnvError, the exception of this package."""


class EnvError(Exception):
    """An environment, an option, an action or a file that is not valid."""
