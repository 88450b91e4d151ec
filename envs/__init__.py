"""Environments: gymnasium environments that policies are trained and compared in.

A hexapod on MuJoCo and karts on pymunk, and what records their episodes. ENVS is the table of
environments; `make` builds one by its short name or gymnasium id, and likewise those of other
people: any id that is registered with gymnasium, and targets such as my_module:MyEnv.

hexapod/          a walking robot: on rough ground, by velocity commands
kart/             three kinds of kart on tracks, with a LIDAR and a scripted driver
event_camera.py   an event camera by v2e's model, for any frames
event_camera_wrapper.py  an event camera for any environment that renders
disturbances.py   noise, delays, weak motors and so on, of any environment
rollout.py        one episode of a controller, recorded and saved
finite.py         a check for numbers that are not finite
archive.py        .npz files, written atomically
foreign.py        environments of other packages, as policies expect them
returned.py       what their reset and step return, as numbers
repeats.py        a check that they repeat an episode when its seed is repeated
drawing.py        graphics libraries, loaded only when something is drawn

A new environment is one file and one line in ENVS.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium

from spikedeploy.envs import drawing
from spikedeploy.runtime.errors import EnvError

drawing.choose()


@dataclass(frozen=True)
class EnvSpec:
    """Entry of an environment, which is imported only when it is made.

    short: key in ENVS, as the command line takes it
    id: gymnasium's identifier
    target: "module:class"
    summary: one line
    controls: built-in baselines of every comparison; the first is the zero of its score
    remark: what its returns can and cannot show, for reports
    foreign: True of an environment of another package, which is not in ENVS
    """

    short: str
    id: str
    target: str
    summary: str
    controls: tuple[str, ...] = ()
    remark: str = ""
    foreign: bool = False

    @property
    def world(self) -> str:
        """Folder of the environment: "hexapod", "kart"; of a foreign one its name."""
        return self.short if self.foreign else self.target.partition(":")[0].split(".")[-2]


ENVS: dict[str, EnvSpec] = {
    spec.short: spec
    for spec in (
        EnvSpec(
            "hexapod",
            "spikedeploy/Hexapod-v0",
            "spikedeploy.envs.hexapod.env:HexapodEnv",
            "walk straight ahead at 0.4 m/s over 3 cm bumps",
            controls=("gait",),
            remark="Hexapod-v0 is a reconstruction from Spikerman's text, which has no environment "
            "file: returns cannot be compared with Spikerman's.",
        ),
        EnvSpec(
            "hexapod-command",
            "spikedeploy/HexapodCommand-v0",
            "spikedeploy.envs.hexapod.command:HexapodCommandEnv",
            "follow commanded speed and turn rate over 5-9 cm bumps",
            controls=("gait",),
            remark="The reward of HexapodCommand-v0 has a peaked kernel, chosen so that it "
            "separates controls without feedback from policies with it: shares of a return are not "
            "shares of the tracking, which success and the errors measure.",
        ),
        *(
            EnvSpec(
                f"kart-{kind.lower()}",
                f"spikedeploy/Kart{kind}-v0",
                f"spikedeploy.envs.kart.karts:Kart{kind}Env",
                summary,
                controls=("random", "gap"),
            )
            for kind, summary in (
                ("Grid", "race a kart that is pushed up, down, left and right"),
                ("Gazebo", "race a kart that either drives or turns"),
                ("Steer", "race a kart with throttle, brake and steering"),
            )
        ),
    )
}


def spec(name: str) -> EnvSpec:
    """Return the entry of a short name, a registered id or a target; nothing is imported."""
    for entry in ENVS.values():
        if name in (entry.short, entry.id):
            return entry
    from spikedeploy.envs.foreign import entry_point, nearest

    target = entry_point(name)
    if target is not None:
        return EnvSpec(name, name, target, f"{target}, not of ours", ("random",), foreign=True)
    close = nearest(name, (text for entry in ENVS.values() for text in (entry.short, entry.id)))
    hint = (
        f"did you mean {close!r}?"
        if close
        else f"known: {', '.join(ENVS)}, the ids of gymnasium, and module:Class of your own"
    )
    raise EnvError(f"unknown environment {name!r}; {hint}")


def make(
    name: str,
    *,
    disturb: Sequence[str] = (),
    success: str | None = None,
    **options: Any,  # noqa: ANN401
) -> gymnasium.Env[Any, Any]:
    """Build the environment of a short name, id or target, with options.

    disturb: disturbances such as "noise:2" or "payload=0.4", see envs.disturbances
    success: key of the step infos that says success, of an environment that is not ours
    """
    entry = spec(name)
    if success is not None and not entry.foreign:
        raise EnvError(f"{entry.short} defines success itself: leave --success out")
    undisturbed = partial(_make, entry, success)
    if not disturb:
        return undisturbed(options)
    from spikedeploy.envs.disturbances import make_disturbed

    return make_disturbed(entry, disturb, options, undisturbed)


def _make(entry: EnvSpec, success: str | None, options: dict[str, Any]) -> gymnasium.Env[Any, Any]:
    if entry.foreign:
        from spikedeploy.envs.foreign import make_foreign

        return make_foreign(entry.id, options, success)
    try:
        return gymnasium.make(entry.id, **options)
    except TypeError as error:
        wrong = re.search(r"unexpected keyword argument '([^']+)'", str(error))
        if wrong is None:
            raise
        raise EnvError(
            f"{entry.short} has no option {wrong[1]!r}; the docstring of "
            f"{entry.target.replace(':', '.')} lists those that it has"
        ) from error


def register() -> None:
    """Register every environment with gymnasium; a second call changes nothing."""
    for entry in ENVS.values():
        if entry.id not in gymnasium.registry:
            gymnasium.register(entry.id, entry_point=entry.target)


register()
