"""The policies of the robustness experiment: shipped ones, or those that the user names."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from spikedeploy import zoo
from spikedeploy.policies.registry import BUILT_IN, Candidate, check_fit, find
from spikedeploy.runtime.errors import ConfigError

# float controls beside the float ANN, as far as they are shipped, from the strongest on
_SMALL = ("mlp-32", "pruned", "small", "linear")


@dataclass(frozen=True)
class Tested:
    """A policy of the line-up.

    candidate  the policy
    chip       on which it runs if it spikes, else None
    """

    candidate: Candidate
    chip: str | None

    @cached_property
    def digest(self) -> str:
        """SHA-256 of its file."""
        return hashlib.sha256(Path(self.candidate.path).read_bytes()).hexdigest()

    @property
    def label(self) -> str:
        """`popsan · loihi1`, `sac`."""
        return f"{self.candidate.name} · {self.chip}" if self.chip else self.candidate.name


def shipped(env: str, chip: str) -> list[Tested]:
    """The shipped float ANNs, small float networks, and spiking policies on the chip."""
    every = [find(str(path)) for path in zoo.policies(env)]
    small = [c for name in _SMALL for c in every if c.name == name and c.kind != "snn"]
    found = [c for c in every if c.kind == "ann" and c not in small]
    spiking = [c for c in every if c.kind == "snn" and c.format == ".nir"]
    return [Tested(c, None) for c in [*found, *small]] + [Tested(c, chip) for c in spiking]


def named(paths: Sequence[str], chip: str) -> list[Tested]:
    """Files, float ones first, as `files_of` gave them; those that spike on the chip."""
    found = [find(path) for path in paths]
    tested = [Tested(each, chip if each.kind == "snn" else None) for each in found]
    return sorted(tested, key=lambda each: each.chip is not None)


def files_of(names: Sequence[str], env: str, options: Mapping[str, Any]) -> list[str]:
    """Files of policies by name; run folders are exported. ConfigError where one does not fit."""
    from spikedeploy.make_env import make_env
    from spikedeploy.shipping.exported_run import runnable

    if own := [name for name in names if name in BUILT_IN]:
        raise ConfigError(f"--policies {own[0]} is built in and has no file. Leave it out.")
    candidates = [find(runnable(name)) for name in names]
    world = make_env(env, options)
    for candidate in candidates:
        check_fit(candidate, world)
    world.close()
    short = [candidate.name for candidate in candidates]
    if twice := [name for name in short if short.count(name) > 1]:
        raise ConfigError(f"--policies: two are called {twice[0]}. Give one of them another name.")
    return [candidate.path for candidate in candidates]
