"""Teachers: policies to imitate, from a run folder or a file."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.envs.rollout import rollout
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.config import EnvConfig, ValidationConfig
from spikedeploy.trainers.policies import DeltaSnnPolicy, Policy
from spikedeploy.trainers.run_folder import RunFolder, load_policy

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Teacher:
    """A policy to imitate; also a controller of one robot.

    act_all: actions (B, act) for observations (B, obs), or logits of discrete ones
    observations, actions: their numbers
    env: short name or id of its environment, empty if unknown
    """

    act_all: Callable[[FloatArray], FloatArray]
    observations: int
    actions: int
    env: str = ""

    def reset(self, seed: int) -> None:
        """Do nothing: teachers have no state."""

    def act(self, observation: FloatArray) -> FloatArray:
        """Return the action (act,) for one observation (obs,)."""
        action: FloatArray = self.act_all(observation[None])[0]
        return action


def teacher(path: str, env: str) -> Teacher:
    """Return the teacher in a run folder or file, which must match the environment.

    path: or the name of a shipped policy, such as "hexapod/sac"
    """
    if not path:
        raise ConfigError(
            "distillation needs a teacher: --set teacher=PATH, where PATH is a run folder, an "
            ".onnx or .nir file, or a shipped policy such as hexapod/sac"
        )
    path = str(_shipped(path) or path)
    read = _FILES.get(Path(path).suffix, _from_run)
    if read is not _from_run and not Path(path).is_file():
        raise ConfigError(f"there is no teacher at {path}")
    found = read(path)
    if found.env and envs.spec(found.env).id != envs.spec(env).id:
        raise ConfigError(f"the teacher {path} was trained in {found.env}, not in {env}")
    return found


def _shipped(name: str) -> Path | None:
    """Return the file of a shipped policy; None where a path is meant."""
    return None if Path(name).exists() else _zoo().get(name)


def _zoo() -> dict[str, Path]:
    """Files of the shipped policies by name, such as "hexapod/sac"."""
    folder = Path(str(files("spikedeploy"))) / "zoo"
    found = [path for suffix in _FILES for path in sorted(folder.glob(f"*/*{suffix}"))]
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in found}


def same_teacher(one: str, other: str) -> bool:
    """Return whether two settings name the same teacher: equal words, paths or files."""
    first, second = (Path(_shipped(each) or each) for each in (one, other))
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
    name = "max_episode_steps" if envs.spec(env.name).foreign else "max_steps"
    limit: Mapping[str, Any] = {} if config.limit is None else {name: config.limit}
    made = envs.make(env.name, **{**env.options, **limit})
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


def _from_onnx(path: str) -> Teacher:
    from spikedeploy.trainers.onnx_session import session

    network = session(path)
    entry, exit_ = network.get_inputs()[0], network.get_outputs()[0]

    def act_all(observation: FloatArray) -> FloatArray:
        feed = {entry.name: observation.astype(np.float32)}
        action: FloatArray = network.run([exit_.name], feed)[0].astype(np.float64)
        return action

    env = network.get_modelmeta().custom_metadata_map.get("env", "")
    return Teacher(act_all, entry.shape[1], exit_.shape[1], env)


def _from_nir(path: str) -> Teacher:
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.runtime.float_model.graph import FloatGraph

    artifact = load(path)
    codec, graph = artifact.codec, FloatGraph(artifact)
    if codec is None:
        raise ConfigError(f"{path} has no codec, so it cannot act on observations")
    encoder = codec.encoder
    if artifact.convention.state == "kept" or (encoder.remembers and not encoder.random):
        raise _remembers(path)

    def act_all(observation: FloatArray) -> FloatArray:
        output = graph.run(codec.encode(observation))["output"].astype(np.float64)
        return codec.decode(output).astype(np.float64)

    actions = graph.outputs[0].size
    env = artifact.provenance.env if artifact.provenance else ""
    return Teacher(act_all, encoder.observed, actions, env)


def _remembers(path: str) -> ConfigError:
    return ConfigError(
        f"the teacher {path} acts on the observations before, too, and a teacher labels single "
        "ones. Give the float policy that it was made from"
    )


_FILES: dict[str, Callable[[str], Teacher]] = {".onnx": _from_onnx, ".nir": _from_nir}
