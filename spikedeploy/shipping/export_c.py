"""A policy as C99 of a chip: the folder, and what it takes of a microcontroller."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy import envs, zoo
from spikedeploy.console import say
from spikedeploy.envs.rollout import rollout
from spikedeploy.exporters.c.to_c import (
    MAKEFILE,
    MARK,
    RECORD,
    CCosts,
    file_names,
    policy_in_c,
    write_texts,
)
from spikedeploy.make_env import make_env
from spikedeploy.outputs import check_output_folder, marked
from spikedeploy.policies.registry import DEFAULT_CHIP
from spikedeploy.runtime.artifact.artifact import Artifact, load
from spikedeploy.runtime.chips.chip import Chip, chip
from spikedeploy.runtime.compiler.compile import compile_program, own_clock
from spikedeploy.runtime.convention import CLOCKS
from spikedeploy.runtime.emulator.controllers import SpikingController
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.seeds import VALIDATION


@dataclass(frozen=True)
class WrittenC:
    """A folder of C.

    folder: with the files.
    names: of the files.
    costs: memory and operations.
    remarks: what of the program is not as in the file.
    source: of the observations behind the typical operations.
    without_int16: why there is no interface in 16-bit integers; "" where there is one.
    """

    folder: Path
    names: tuple[str, ...]
    costs: CCosts
    remarks: tuple[str, ...]
    source: str
    without_int16: str

    def record(self) -> dict[str, Any]:
        """All of it as data."""
        return {
            "path": str(self.folder),
            "files": list(self.names),
            "costs": asdict(self.costs),
            "recorded": self.source,
            "remarks": list(self.remarks),
            "int16": not self.without_int16,
        }

    @property
    def prefix(self) -> str:
        """What names in C begin with."""
        return next(name.removesuffix(".h") for name in self.names if name.endswith(".h"))

    def lines(self) -> list[str]:
        """All of it for a terminal."""
        found, prefix = self.costs, self.prefix
        beside = f"{prefix}_act_i16: observations and actions as 16-bit integers; README.md"
        if self.without_int16:
            beside = f"no interface in 16-bit integers: {self.without_int16}"
        code = "and the code, which has short rows of weights"
        return [
            f"constants (ROM)        {found.rom:,} bytes, {code}",
            f"variables (RAM)        {found.ram:,} bytes, and the stack",
            f"input spikes           {found.events:,.1f}, at most {found.events_max:,}",
            f"synaptic operations    {found.sops:,.1f}, at most {found.sops_max:,}",
            f"neuron updates         {found.neuron_updates:,}",
            f"of an inference, means of {self.source}",
            *self.remarks,
            beside,
            f"wrote {self.folder}: {', '.join(self.names)}",
            f"compare with the interpreter: make -C {self.folder} test",
        ]


def export_c(
    policy: str,
    chip_name: str | None,
    folder: Path | None,
    observations: int = 1000,
    prefix: str = "policy",
    force: bool = False,
) -> WrittenC:
    """Write a policy as C of a chip.

    policy: .nir file, shipped policy, run folder, its name under runs/, or "last".
    chip_name: None is that of its training, or the default.
    folder: to write to.
    observations: of an episode, from which the self-test and the typical operations come.
    prefix: what names in C begin with.
    force: whether files that no earlier export wrote are replaced.
    """
    if folder is None:
        raise ConfigError("--to c writes a folder: name it, as in -o firmware")
    file = nir_file(policy, "c")
    artifact = load(file)
    chip_name = chip_of(artifact) if chip_name is None else chip_name
    on = chip(chip_name)
    if artifact.codec is None:
        raise ConfigError(
            f"{policy} has no codec (observation to spikes), and C of it could not be asked for "
            "actions. Give it one with `spikedeploy run --from`; docs/own-network.md has it."
        )
    names = file_names(prefix, codec=True)
    check_output_folder("-o", folder, names, (file, policy), force, written_before)
    # software updates a layer when it is told to, whatever the chip can; its options come first
    clock, software = on.clock or own_clock(artifact.convention), replace(on, clocks=CLOCKS)
    program = compile_program(artifact, software, clock=clock)
    seen, source = episode_of(artifact, on, observations, world_of(policy, artifact))
    origin = f"{zoo.called(str(file))}, sha256 {zoo.sha256(file)[:16]}, on {chip_name}"
    files = policy_in_c(program, artifact.codec, seen, origin, prefix)
    write(files.text, folder, prefix)
    return WrittenC(
        folder, tuple(files.text), files.costs, program.remarks, source, files.without_int16
    )


def chip_of(artifact: Artifact) -> str:
    """The chip on which a policy runs where none is named: that of its training, or the default."""
    return artifact.trained_for or DEFAULT_CHIP


def nir_file(policy: str, to: str) -> Path:
    """The file of a policy; that of a run is exported first."""
    file = zoo.resolve(policy)
    if file is None or file.is_dir():
        from spikedeploy.shipping.exported_run import runnable

        file = Path(runnable(policy))
    if file.suffix != ".nir" or not file.is_file():
        if file.suffix in (".nir", ".onnx") and not file.is_file():
            raise ConfigError(f"--to {to}: there is no file {policy}")
        raise ConfigError(
            f"--to {to}: {policy} is no spiking policy; only .nir files can be taken, and runs "
            "that make one."
        )
    return file


def written_before(folder: Path) -> bool:
    """Whether the folder has an earlier export, or what one left that was killed."""
    whole = os.path.lexists(folder / MAKEFILE)
    return marked(folder / (MAKEFILE if whole else RECORD), MARK)


def write(texts: Mapping[str, str], folder: Path, prefix: str) -> None:
    """Write the files; those of an earlier export that this one has not are removed.

    They are of another policy, and a firmware that still names them would call both.
    """
    write_texts(texts, folder)
    for name in set(file_names(prefix, codec=True)) - set(texts):
        if not (path := folder / name).is_symlink() and marked(path, MARK):
            path.unlink()


def world_of(policy: str, artifact: Artifact) -> str:
    """The environment that a run was trained in, else one of ours that the file names.

    A run folder is the user's, and its environment is imported; what a file names is not.
    """
    from spikedeploy.shipping.exported_run import trained_in

    named = artifact.provenance.env if artifact.provenance else ""
    ours = named if named in {entry.id for entry in envs.ENVS.values()} else ""
    return trained_in(policy) or ours or ""


def episode_of(
    artifact: Artifact, on: Chip | None, count: int, where: str
) -> tuple[NDArray[np.float64], str]:
    """Observations (S, obs) of an episode in an environment, and where they come from in words."""
    codec = artifact.codec
    if codec is None:
        raise TypeError("an artifact without a codec has no observations")
    env = make_env(where, {}) if where else None
    if env is not None and env.observation_space.shape == (codec.encoder.observed,):
        played = rollout(env, SpikingController(artifact, on, "none"), VALIDATION[0])
        env.close()
        seen = np.asarray(played.observation[:-1], np.float64)[:count]
        return seen, f"{len(seen)} control steps in {where}, seed {VALIDATION[0]}"
    named = (artifact.provenance.env if artifact.provenance else "") or "no environment"
    say(f"{named} cannot be played here: a random walk stands for it; name the run to play it")
    steps = np.random.default_rng(0).normal(0, 0.2, (count, len(codec.normaliser.mean)))
    walk = np.clip(np.cumsum(steps, axis=0), -3, 3)
    return walk * codec.normaliser.std + codec.normaliser.mean, f"{count} steps of a random walk"
