"""Graphics libraries: chosen before they are imported, and loaded when something is drawn.

MuJoCo loads what MUJOCO_GL names when it is imported, and its import fails where that cannot be
loaded. Programs that draw nothing need neither. SDL, which pygame draws with, looks for a desktop
and complains on stderr where there is none.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from spikedeploy.runtime.errors import EnvError

_NONE = ("disable", "disabled", "off", "false", "0")
_LIBRARIES = {
    "egl": ("libEGL.so.1",),
    "osmesa": ("libOSMesa.so.8", "libOSMesa.so", "libOSMesa.so.6"),
}
_KNOWN = ("", "enable", "enabled", "on", "true", "1", "glfw", "glx", *_LIBRARIES, "cgl", "wgl")
_IN_MEMORY = "dummy"  # SDL's driver without a desktop
_sdl_is_ours = False


def _without_desktop() -> bool:
    displays = ("DISPLAY", "WAYLAND_DISPLAY")
    return sys.platform == "linux" and not any(map(os.environ.get, displays))


def _loads(*libraries: str) -> bool:
    """Return True if one of some shared libraries can be loaded."""
    for library in libraries:
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return True
    return False


def _is_usable(name: str) -> bool:
    """Return True if MuJoCo can be imported with this MUJOCO_GL."""
    libraries = _LIBRARIES.get(name, ()) if sys.platform == "linux" else ()
    return name in (*_KNOWN, *_NONE) and (not libraries or _loads(*libraries))


_asked = os.environ.get("MUJOCO_GL")  # by the user; None where it is not set


def choose() -> None:
    """Set variables of MuJoCo, SDL and pygame that are unset, or name a missing library.

    Without a desktop MuJoCo renders through EGL. A MUJOCO_GL that cannot be loaded is set aside
    until something is drawn, which `explain` then tells.
    """
    global _sdl_is_ours
    # pygame would print a greeting to stdout
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    if _asked is None and _without_desktop():
        os.environ["MUJOCO_GL"] = "egl" if _is_usable("egl") else "disable"
    elif _asked is not None and not _is_usable(_asked.lower().strip()):
        os.environ["MUJOCO_GL"] = "disable"
    if _without_desktop() and not sdl_driver():
        os.environ["SDL_VIDEODRIVER"], _sdl_is_ours = _IN_MEMORY, True


def sdl_driver() -> str:
    """The driver of SDL that the user has chosen; empty where `choose` did, or nobody."""
    found = os.environ.get("SDL_VIDEODRIVER") or os.environ.get("SDL_VIDEO_DRIVER") or ""
    return "" if _sdl_is_ours and found == _IN_MEMORY else found


@contextmanager
def without_renderer() -> Iterator[None]:
    """Import MuJoCo in this block without its renderer, which `load_renderer` loads later."""
    before = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "disable"
    try:
        yield
    finally:
        if before is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = before


def check_variable() -> None:
    """Refuse a MUJOCO_GL that cannot be loaded, before any object is made with it."""
    if _asked is not None and not _is_usable(_asked.lower().strip()):
        raise explain(ImportError("it cannot be loaded"))


def load_renderer() -> Any:  # noqa: ANN401
    """MuJoCo's GLContext, as MUJOCO_GL names it; EnvError where there is none."""
    check_variable()
    try:
        try:
            module = importlib.import_module("mujoco.rendering.classic.gl_context")
        except ModuleNotFoundError:  # before MuJoCo 3.4
            module = importlib.import_module("mujoco.gl_context")
        if not hasattr(module, "GLContext"):
            importlib.reload(module)
        if not hasattr(module, "GLContext"):
            raise ImportError("it is turned off")
        return module.GLContext
    except Exception as error:  # every GL library raises its own type
        raise explain(error) from error


def explain(error: Exception) -> EnvError:
    """Return the sentence for a picture of MuJoCo's or pygame's that cannot be drawn."""
    if type(error).__module__.startswith("pygame"):
        driver = os.environ.get("SDL_VIDEODRIVER", "not set")
        return EnvError(
            f"pygame cannot draw ({error}); SDL_VIDEODRIVER is {driver}: leave it unset, or set it "
            "to dummy, which draws in memory"
        )
    found = "not set" if _asked is None else repr(_asked)
    return EnvError(
        f"no OpenGL to draw with: MUJOCO_GL is {found} ({error}). Set it to egl, to osmesa, or "
        "with a desktop to glfw, and have its library; on Debian: apt-get install libegl1 libgl1, "
        "or libosmesa6"
    )
