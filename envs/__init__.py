"""The worlds: gymnasium environments that policies are trained and compared in.

errors.py           EnvError
gait.py             the central pattern generator
terrain.py          rough ground
disturbances.py     randomised bodies and pushes
robot.py            the hexapod (hexapod.xml), its servos and sensors
observation.py      what policies are shown of it
reward.py           what they are paid for
hexapod.py          walk straight ahead at 0.4 m/s
hexapod_command.py  follow a commanded speed and turn rate
camera.py           pictures of them
track.py            walls, gates and a start; tracks/*.json are the shipped ones
track_rules.py      which tracks can be driven
corridor.py         random ones
lidar.py            distances to walls along rays
kart.py             what karts have in common: the episode
kart_options.py     what their options stand for
kart_world.py       their physics
kart_situation.py   where one is and how it moves
kart_ends.py        when one has given up
kart_grid.py        pushed in four directions
kart_gazebo.py      drives or turns
kart_steer.py       throttle, brake and steering
kart_observation.py what their drivers are shown
kart_reward.py      what they are paid for
gap.py              a scripted driver
kart_scene.py       a track on a surface
kart_picture.py     pictures of karts
ghosts.py           the drives of a whole training, in small files
ghost_recorder.py   keeps them
archive.py          arrays in files
rollout.py          one episode of a controller, recorded

A new environment is one file and one line in ENVS.
"""

from __future__ import annotations

import ctypes
import difflib
import os
import sys
from dataclasses import dataclass
from typing import Any

import gymnasium

from spikedeploy.envs.errors import EnvError

# drawing karts needs pygame, which would greet everybody on stdout
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")


def _loads(library: str) -> bool:
    """Whether a shared library is installed."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
    # MuJoCo reads it once, at its import: without a display, draw through EGL. Where that library
    # is missing, trying it would break the import itself
    os.environ.setdefault("MUJOCO_GL", "egl" if _loads("libEGL.so.1") else "disable")


@dataclass(frozen=True)
class EnvSpec:
    """What is known of an environment before it is loaded.

    short    key in ENVS, as the command line takes it
    id       gymnasium's identifier
    target   "module:class"
    summary  one line for people
    controls built-in players that every comparison shows; the first is the zero of its score
    """

    short: str
    id: str
    target: str
    summary: str
    controls: tuple[str, ...] = ()


ENVS: dict[str, EnvSpec] = {
    spec.short: spec
    for spec in (
        EnvSpec(
            "hexapod",
            "spikedeploy/Hexapod-v0",
            "spikedeploy.envs.hexapod.env:HexapodEnv",
            "walk straight ahead at 0.4 m/s over 3 cm bumps",
            controls=("gait",),
        ),
        EnvSpec(
            "hexapod-command",
            "spikedeploy/HexapodCommand-v0",
            "spikedeploy.envs.hexapod.command:HexapodCommandEnv",
            "follow commanded speed and turn rate over 5-9 cm bumps",
            controls=("gait",),
        ),
        EnvSpec(
            "kart-grid",
            "spikedeploy/KartGrid-v0",
            "spikedeploy.envs.kart.grid:KartGridEnv",
            "race a kart that is pushed up, down, left and right",
            controls=("random", "gap"),
        ),
        EnvSpec(
            "kart-gazebo",
            "spikedeploy/KartGazebo-v0",
            "spikedeploy.envs.kart.gazebo:KartGazeboEnv",
            "race a kart that either drives or turns",
            controls=("random", "gap"),
        ),
        EnvSpec(
            "kart-steer",
            "spikedeploy/KartSteer-v0",
            "spikedeploy.envs.kart.steer:KartSteerEnv",
            "race a kart with throttle, brake and steering",
            controls=("random", "gap"),
        ),
    )
}


def spec(name: str) -> EnvSpec:
    """Return the entry with this short name or id."""
    for entry in ENVS.values():
        if name in (entry.short, entry.id):
            return entry
    known = [text for entry in ENVS.values() for text in (entry.short, entry.id)]
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(ENVS)}"
    raise EnvError(f"unknown environment {name!r}; {hint}")


def make(name: str, **options: Any) -> gymnasium.Env[Any, Any]:  # noqa: ANN401
    """Build the environment with this short name or id, with its options."""
    return gymnasium.make(spec(name).id, **options)


def register() -> None:
    """Tell gymnasium of every environment; a second call changes nothing."""
    for entry in ENVS.values():
        if entry.id not in gymnasium.registry:
            gymnasium.register(entry.id, entry_point=entry.target)


register()
