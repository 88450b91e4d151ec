"""Detection of a display, before pygame is imported.

Without one SDL would open its window in memory, where nobody sees it.
"""

import os
import sys

from spikedeploy.envs.drawing import sdl_driver
from spikedeploy.runtime.errors import ConfigError

_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
_INVISIBLE = ("dummy", "offscreen")
_REMEDY = "`spikedeploy run --video` needs none"


def check_display() -> None:
    """Refuse to open a window where there is no display."""
    if not (_has_display() or _is_chosen()):
        raise ConfigError(f"no display: neither {' nor '.join(_DISPLAYS)} is set; {_REMEDY}")


def has_desktop() -> bool:
    """Return True if somebody sits at a terminal on a desktop, where a page can be opened."""
    return sys.stdout.isatty() and _has_display()


def check_driver(driver: str) -> None:
    """Refuse a window that SDL opened in memory, because the display could not be reached."""
    if driver in _INVISIBLE and not _is_chosen():
        display = next(filter(None, map(os.environ.get, _DISPLAYS)), "")
        raise ConfigError(f"no display: {display or 'it'} cannot be reached; {_REMEDY}")


def _has_display() -> bool:
    return sys.platform in ("darwin", "win32") or any(map(os.environ.get, _DISPLAYS))


def _is_chosen() -> bool:
    return bool(sdl_driver())  # the user's own choice, "dummy" too
