"""One job of a sweep as data, from which its result follows, and the key that names its file."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from typing import Any

from spikedeploy import envs
from spikedeploy.policies.registry import FLOAT
from spikedeploy.trainers.versions import installed

_VERSION = 1  # of what a result holds; a higher one makes all results again
# what an episode is computed with, by world; other people's worlds may stand on MuJoCo
_PHYSICS = {"hexapod": ("mujoco",), "kart": ("pymunk",)}
_OTHERS = ("gymnasium", "mujoco")
_ALWAYS = ("spikedeploy", "numpy", "onnxruntime")


@dataclass(frozen=True)
class JobSpecification:
    """All that the result of a job depends on, JSON types.

    env       short name or id
    options   of the environment
    policy    its name
    format    key of policies.registry.FORMATS
    sha256    of its file; empty for a built-in
    chip      of a spiking policy, or "float"; None for what does not spike
    bits      of the weights; None for the chip's own
    disturb   disturbances of the world
    fault     faults of the chip
    specimen  which faulty chip
    seed      first
    episodes  from that seed on
    limits    whether the design rules of the chip are enforced
    quantisation  fields of Quantisation
    metrics   of the step infos
    versions  package -> version that computes it
    version   of what a result holds
    """

    env: str
    options: Mapping[str, Any]
    policy: str
    format: str
    sha256: str
    chip: str | None
    bits: int | None
    disturb: tuple[str, ...]
    fault: tuple[str, ...]
    specimen: int
    seed: int
    episodes: int
    limits: bool
    quantisation: Mapping[str, Any]
    metrics: tuple[str, ...] = ()
    versions: Mapping[str, str | None] = field(default_factory=dict)
    version: int = _VERSION

    @cached_property
    def record(self) -> dict[str, Any]:
        """The fields as JSON has them."""
        record: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return record

    @cached_property
    def key(self) -> str:
        """SHA-256 of the fields, in hexadecimal."""
        text = json.dumps(self.record, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def place(self) -> str | None:
        """The chip as the command line takes it: `loihi1:weight_bits=4`."""
        if self.bits is None or self.chip in (None, FLOAT):
            return self.chip
        return f"{self.chip}{',' if ':' in self.chip else ':'}weight_bits={self.bits}"

    @property
    def label(self) -> str:
        """`kart-grid · snn · loihi1 · noise:2 · seed 10000`, for messages."""
        faults = [*self.fault, *([f"specimen {self.specimen}"] if self.fault else [])]
        parts = [self.env, self.policy, self.place, *self.disturb, *faults, f"seed {self.seed}"]
        return " · ".join(part for part in parts if part)

    @cached_property
    def cell(self) -> str:
        """What jobs have in common that differ in their seeds alone."""
        return replace(self, seed=0).key


@cache
def versions_for(env: str) -> dict[str, str | None]:
    """Package -> version of what computes an episode in an environment, here."""
    packages = (*_ALWAYS, *_PHYSICS.get(envs.spec(env).world, _OTHERS))
    return {package: installed(package) for package in packages}
