"""The registry of policies: files, run folders and built-ins, one table of formats.

A new format is a module with the functions of interface.PolicyFormat, and a line in FORMATS.
"""

import difflib
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from spikedeploy import zoo
from spikedeploy.envs.foreign import is_target
from spikedeploy.policies.interface import FLOAT, Candidate, Player, PolicyFormat, check_fit
from spikedeploy.runtime.errors import ConfigError

if TYPE_CHECKING:
    import gymnasium

    from spikedeploy.envs.rollout import Rollout
    from spikedeploy.policies.costs import Costs

FORMATS = {
    ".onnx": "spikedeploy.policies.onnx",
    ".nir": "spikedeploy.policies.nir",
    ".so": "spikedeploy.policies.native",
    "run": "spikedeploy.policies.run",
    "gait": "spikedeploy.policies.gait",
    "random": "spikedeploy.policies.random",
    "gap": "spikedeploy.policies.gap",
    "teacher": "spikedeploy.policies.teacher",
    "function": "spikedeploy.policies.teacher",
}
BUILT_IN = ("gait", "random", "gap")
UNTRAINED = (*BUILT_IN, "function")  # formats of scripts


def find(reference: str) -> Candidate:
    """The candidate at a path, in the zoo (`hexapod/popsan`), or built in (`gait`, `gap`)."""
    if reference in BUILT_IN:
        return _format(reference).describe(Path(reference))
    path = zoo.resolve(reference)
    if path is None:
        raise ConfigError(_unknown(reference, zoo.names()))
    return _format(_format_of(path)).describe(path)


def open_policy(
    candidate: Candidate,
    chip: str | None,
    env: "gymnasium.Env[Any, Any]",
    sampled: bool = False,
) -> Player:
    """The player of the candidate in `env`; `chip` "float" is the float twin."""
    check_fit(candidate, env)
    if candidate.kind == "snn" and chip is None:
        raise ConfigError(f"{candidate.name} is a spiking policy: name a chip, or '{FLOAT}'")
    if candidate.kind != "snn" and chip is not None:
        raise ConfigError(f"{candidate.name} does not spike, so no chip runs it: leave --chip out")
    return _format(candidate.format).controller(candidate, chip, env, sampled)


def price(candidate: Candidate, player: Player, played: "Rollout") -> "Costs":
    """What an inference cost the player in the rollout that it has just played."""
    return _format(candidate.format).costs(player, played)


def _format(name: str) -> PolicyFormat:
    """The module of a format, imported now."""
    return cast(PolicyFormat, import_module(FORMATS[name]))


def _format_of(path: Path) -> str:
    if path.is_dir():
        return "run"
    if path.suffix in FORMATS:
        return path.suffix
    raise ConfigError(
        f"{path} is neither .onnx, .nir nor a run folder; a teacher plays in "
        f"`spikedeploy compare ENV --teacher {path}`"
        if path.suffix == ".zip"
        else f"{path} is neither .onnx, .nir nor a run folder"
    )


def _unknown(reference: str, known: list[str]) -> str:
    if is_target(reference):
        return (
            f"no policy at {reference!r}: a function of yours plays as a teacher, in "
            f"`spikedeploy compare ENV --teacher {reference}`"
        )
    close = difflib.get_close_matches(reference, [*known, *BUILT_IN], n=1)
    hint = (
        f"did you mean {close[0]!r}?" if close else "`spikedeploy policies` lists what is shipped"
    )
    return f"no policy at {reference!r}: no such file, run folder or shipped policy; {hint}"
