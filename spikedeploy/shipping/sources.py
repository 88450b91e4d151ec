"""Inputs of an export: the file of a policy, its chip, observations of an episode."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs, zoo
from spikedeploy.console import say
from spikedeploy.envs.rollout import rollout
from spikedeploy.policies.onnx import OnnxController
from spikedeploy.policies.registry import DEFAULT_CHIP
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.quantisation import PLAIN, Granularity, Quantisation
from spikedeploy.runtime.codec.codec import GIVE_CODEC, Codec
from spikedeploy.runtime.compiler.program import Program
from spikedeploy.runtime.emulator.machine import Machine
from spikedeploy.runtime.emulator.running_network import FloatMachine
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix
from spikedeploy.seeds import VALIDATION
from spikedeploy.shipping import exported_run

Observations = NDArray[np.float64]


def policy_file(policy: str) -> Path:
    """The file of a policy; that of a run is exported first."""
    file = zoo.resolve(policy)
    return Path(exported_run.runnable(policy)) if file is None or file.is_dir() else file


def nir_file(policy: str, to: str) -> Path:
    """The `.nir` file of a policy; ConfigError where it does not spike."""
    file = policy_file(policy)
    if suffix(file) == ".nir" and file.is_file():
        return file
    if suffix(file) in zoo.SUFFIXES and not file.is_file():
        raise ConfigError(f"--to {to}: there is no file {policy}")
    raise ConfigError(
        f"--to {to}: {policy} is no spiking policy; only .nir files can be taken, and runs that "
        "make one."
    )


def is_nir_file(policy: str) -> bool:
    """True where a reference is a `.nir` file or a shipped policy in one."""
    file = zoo.resolve(policy)
    return file is not None and file.is_file() and suffix(file) == ".nir"


def require_output(path: Path | None, what: str, example: str) -> Path:
    """The file or folder to write; ConfigError where none was named."""
    if path is None:
        raise ConfigError(f"this format writes {what}: name it, as in -o {example}")
    return path


def chip_of(artifact: Artifact) -> str:
    """The chip on which a policy runs where none is named: that of its training, or the default."""
    return artifact.trained_for or DEFAULT_CHIP


def named_env(artifact: Artifact) -> str:
    """The environment that a file names; "" where it names none."""
    return artifact.provenance.env if artifact.provenance else ""


def world_of(policy: str, artifact: Artifact) -> str:
    """The environment that a run was trained in, else one of ours that the file names.

    A run folder is the user's, and its environment is imported; what a file names is not.
    """
    named = named_env(artifact)
    return exported_run.trained_in(policy) or (named if is_ours(named) else "")


def is_ours(env: str) -> bool:
    """True for the id of an environment of this package."""
    return env in {entry.id for entry in envs.ENVS.values()}


def observations_of(
    controller: Callable[[], "CodecController | OnnxController"],
    where: str,
    size: int,
    count: int,
    walk: Callable[[], Observations],
    named: str | None = None,
) -> tuple[Observations, str]:
    """Observations (S, obs) of an episode in an environment, and where they come from in words.

    controller: made where there is an episode to play.
    where: name of the environment; "" for none.
    size: numbers of an observation.
    walk: what stands for an episode that cannot be played: a random walk (count, obs).
    named: environment of --env, in place of `where`; ConfigError where it does not fit.
    """
    where = named or where
    env = envs.make(where) if where else None
    if env is None or env.observation_space.shape != (size,):
        if env is not None:
            env.close()
            if named:
                raise ConfigError(
                    f"--env {named}: its observations have shape {env.observation_space.shape}, "
                    f"and the policy takes {size} numbers. Name the one that it was made for."
                )
        return walk(), f"{count} steps of a random walk"
    played = rollout(env, controller(), VALIDATION[0])
    env.close()
    seen = np.asarray(played.observation[:-1], np.float64)[:count]
    return seen, f"{len(seen)} control steps in {where}, seed {VALIDATION[0]}"


class CodecController:
    """A codec acting through a network that has `reset` and `infer`."""

    def __init__(self, codec: Codec, network: Machine | FloatMachine) -> None:
        self._codec, self._network = codec, network

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self._network.reset()
        self._levels = self._codec.encoder.start(seed)

    def act(self, observation: NDArray[Any]) -> NDArray[Any]:
        """The action for an observation."""
        spikes = self._codec.encode(np.asarray(observation)[None], self._levels)
        return np.asarray(self._codec.decode(self._network.infer(spikes))[0])


@dataclass(frozen=True)
class SpikingSource:
    """A spiking policy to be exported.

    name: name as it was given.
    file: file of the policy.
    chip: on which it runs.
    quantisation: quantisation of its numbers there.
    """

    name: str
    file: Path
    artifact: Artifact
    chip: str
    quantisation: Quantisation = PLAIN

    @classmethod
    def read(
        cls,
        policy: str,
        to: str,
        chip: str | None = None,
        quantise: Granularity = PLAIN.granularity,
        **reading: Any,  # noqa: ANN401
    ) -> "SpikingSource":
        """Read a policy for a format; reading: options of artifact.load."""
        file = nir_file(policy, to)
        artifact = load(file, **reading)
        own = chip_of(artifact) if chip is None else chip
        return cls(policy, file, artifact, own, Quantisation(quantise))

    def require_codec(self, remedy: str = "") -> Codec:
        """Return the codec; ConfigError where the file has none."""
        if self.artifact.codec is None:
            raise ConfigError(
                f"{self.name} has no codec (observation to spikes), so that no actions can be "
                f"asked for. {GIVE_CODEC}{remedy}."
            )
        return self.artifact.codec

    @property
    def origin(self) -> str:
        """The name and the digest of the file."""
        return origin_of(self.file)

    @property
    def scales(self) -> str:
        """The scales of the weights where they are not the usual ones, in words."""
        granularity = self.quantisation.granularity
        return "" if granularity == PLAIN.granularity else f", a scale for each {granularity}"

    def episode(
        self, program: Program | None, count: int, env: str | None
    ) -> tuple[Observations, str]:
        """Observations (S, obs) of a program, None for the float twin, and their source in words.

        count, env: as of observations_of.
        """
        codec = self.require_codec()

        def walk() -> Observations:
            world = named_env(self.artifact) or "no environment"
            say(
                f"{world} cannot be played here: a random walk stands for it; name the run, or the "
                "environment with --env, to play it"
            )
            steps = np.random.default_rng(0).normal(0, 0.2, (count, codec.encoder.observed))
            drift = np.clip(np.cumsum(steps, axis=0), -3, 3)
            return np.asarray(drift * codec.normaliser.std + codec.normaliser.mean)

        def controller() -> CodecController:
            if program is None:
                return CodecController(codec, FloatMachine(self.artifact, "none"))
            return CodecController(codec, Machine(program, 1, "none"))

        where = world_of(self.name, self.artifact)
        return observations_of(controller, where, codec.encoder.observed, count, walk, env)


def origin_of(file: Path) -> str:
    """The name and the digest of a policy's file."""
    return f"{zoo.name_in_exports(file)}, sha256 {zoo.sha256(file)[:16]}"
