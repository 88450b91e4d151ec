"""Teachers by name: run folders, files, functions and shipped policies."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Discrete

from spikedeploy import envs
from spikedeploy.envs.foreign import is_target
from spikedeploy.envs.rollout import rollout
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig, ValidationConfig
from spikedeploy.trainers.distill.onnx_teacher import onnx_teacher
from spikedeploy.trainers.distill.own_function import own_function
from spikedeploy.trainers.distill.own_spaces import OwnSpaces, Units
from spikedeploy.trainers.distill.sb3_teacher import REMEDY, sb3_teacher
from spikedeploy.trainers.distill.teacher import FloatArray, Teacher
from spikedeploy.trainers.policies import DeltaSnnPolicy, Policy
from spikedeploy.trainers.run_folder import RunFolder, load_policy

__all__ = ["FloatArray", "Teacher", "of_policy", "opened", "same_teacher", "score", "teacher"]

_SHIPPED = (".onnx", ".nir")
# files that Python reads by running what is in them
_PICKLES = (".pkl", ".pickle", ".pt", ".pth", ".joblib")


def teacher(
    path: str, env: str, options: Mapping[str, Any] | None = None, units: Units | None = None
) -> Teacher:
    """Return the teacher that a path or name means, which must match the environment.

    path: a run folder, an .onnx, .nir or Stable-Baselines3 .zip file, module:function, or the name
        of a shipped policy, such as "hexapod/sac"
    options: of the environment, whose own units teachers of other people act in
    units: of their actions: "own", or "scaled" to [-1, 1]; None for what the kind of teacher has
    """
    if not path:
        raise ConfigError(
            "distillation needs a teacher: --set teacher=PATH, where PATH is a run folder, an "
            ".onnx, .nir or Stable-Baselines3 .zip file, my_module:function, or a shipped policy "
            "such as hexapod/sac"
        )
    return opened(path, env, lambda: OwnSpaces.of(env, options or {}), units)


def opened(path: str, env: str, spaces: Callable[[], OwnSpaces], units: Units | None) -> Teacher:
    """Return the teacher as `teacher` does, with spaces of an environment that may be made."""
    path = str(shipped(path) or path)
    found = _read(path, spaces, units)
    if found.env and envs.spec(found.env).id != envs.spec(env).id:
        raise ConfigError(f"the teacher {path} was trained in {found.env}, not in {env}")
    return found


def _read(path: str, spaces: Callable[[], OwnSpaces], units: Units | None) -> Teacher:
    """Return what a path means by its form."""
    suffix = Path(path).suffix
    if is_target(path) and not Path(path).exists():
        return own_function(path, spaces(), units or "own")
    if suffix in (*_SHIPPED, ".zip", *_PICKLES) and not Path(path).is_file():
        raise ConfigError(f"there is no teacher at {path}")
    if suffix in _PICKLES:
        raise ConfigError(
            f"the teacher {path} is a pickle, which could run code when it is read, and is not "
            f"read. {REMEDY}"
        )
    if suffix == ".onnx":
        return onnx_teacher(path, spaces, units)
    if units is not None:
        raise ConfigError(f"the teacher {path} says itself how it acts: leave teacher_units out")
    if suffix == ".zip":
        return sb3_teacher(path, spaces())
    return _from_nir(path) if suffix == ".nir" else _from_run(path)


def shipped(name: str) -> Path | None:
    """Return the file of a shipped policy; None where a path is meant."""
    return None if Path(name).exists() else _zoo().get(name)


def _zoo() -> dict[str, Path]:
    """Files of the shipped policies by name, such as "hexapod/sac"."""
    folder = Path(str(files("spikedeploy"))) / "zoo"
    found = [path for suffix in _SHIPPED for path in sorted(folder.glob(f"**/*{suffix}"))]
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in found}


def same_teacher(one: str, other: str) -> bool:
    """Return whether two settings name the same teacher: equal words, paths or files."""
    first, second = (Path(shipped(each) or each) for each in (one, other))
    if one == other or first.resolve() == second.resolve():
        return True
    both = first.is_file() and second.is_file()
    return both and first.read_bytes() == second.read_bytes()


def of_policy(policy: Policy, env: str = "") -> Teacher:
    """Return a policy as a teacher."""

    @torch.no_grad()
    def act_all(observation: FloatArray) -> FloatArray:
        seen = torch.from_numpy(observation).float()
        found = policy.scores(seen) if policy.head == "discrete" else policy(seen)
        action: FloatArray = found.double().numpy()
        return action

    return Teacher(act_all, policy.observations, policy.actions, env)


def score(teacher: Teacher, env: EnvConfig, config: ValidationConfig) -> float:
    """Return the teacher's mean return on the validation seeds."""
    logits = teacher.act_all
    name = "max_episode_steps" if envs.spec(env.name).foreign else "max_steps"
    limit: Mapping[str, Any] = {} if config.limit is None else {name: config.limit}
    made = envs.make(env.name, **{**env.options, **limit})
    if isinstance(made.action_space, Discrete):
        teacher = replace(teacher, act_all=lambda seen: logits(seen).argmax(-1))
    seeds = range(config.first_seed, config.first_seed + config.episodes)
    return float(np.mean([rollout(made, teacher, seed).total for seed in seeds]))


def _from_run(path: str) -> Teacher:
    try:
        settings = RunFolder.find(path).settings()
    except ConfigError as error:
        near = get_close_matches(path, _zoo(), n=2)
        hint = f"; did you mean the shipped policy {' or '.join(near)}?" if near else ""
        raise ConfigError(f"{error}{hint}") from error
    policy = load_policy(path)
    if isinstance(policy, DeltaSnnPolicy):
        raise _remembers(path)
    return of_policy(policy, str(settings["env"]["name"]))


def _from_nir(path: str) -> Teacher:
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.runtime.float_model import FloatGraph

    artifact = load(path)
    codec, graph = artifact.codec, FloatGraph(artifact)
    if codec is None:
        raise ConfigError(f"{path} has no codec, so it cannot act on observations")
    encoder = codec.encoder
    if artifact.convention.state == "kept" or (encoder.remembers and not encoder.random):
        raise _remembers(path)

    def act_all(observation: FloatArray) -> FloatArray:
        output = graph.run(codec.encode(observation))["output"].astype(np.float64)
        found = codec.scores(output) if codec.chooses else codec.decode(output)
        return found.astype(np.float64)

    actions = graph.outputs[0].size
    env = artifact.provenance.env if artifact.provenance else ""
    return Teacher(act_all, encoder.observed, actions, env)


def _remembers(path: str) -> ConfigError:
    return ConfigError(
        f"the teacher {path} acts on the observations before, too, and a teacher labels single "
        "ones. Give the float policy that it was made from"
    )
