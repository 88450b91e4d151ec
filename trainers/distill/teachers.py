"""Teachers by name: run folders, files, functions and shipped policies."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Discrete
from numpy.typing import NDArray

from spikedeploy import envs
from spikedeploy.envs.foreign import AdaptedEnv, attribute, contained, import_target, is_target
from spikedeploy.envs.rollout import rollout
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix
from spikedeploy.trainers.config import EnvConfig, ValidationConfig
from spikedeploy.trainers.distill.sb3 import REMEDY, sb3_teacher
from spikedeploy.trainers.distill.teacher import FloatArray, OwnSpaces, Teacher, Units
from spikedeploy.trainers.onnx_session import has_policy_metadata, operators, session
from spikedeploy.trainers.policies import DeltaSnnPolicy, Policy
from spikedeploy.trainers.run_folder import RunFolder


def own_function(name: str, spaces: OwnSpaces, units: Units) -> Teacher:
    """Return the teacher module:function, which takes the environment's own observations.

    It is the user's own code and runs in the user's process: the module that is named is imported.
    Where the function has the attribute `vectorised`, and it is true, it takes a batch of them. Its
    `reset()`, where it has one, is called when an episode begins; it then plays, but cannot teach.
    """
    module, _, within = name.partition(":")
    act = attribute(name, import_target(name, module, "a teacher is module:function"), within)
    if not callable(act):
        raise ConfigError(f"the teacher {name} is no function of an observation, but {act!r}")
    if isinstance(act, type):
        raise ConfigError(
            f"the teacher {name} is a class: name a function of an observation, such as a method "
            "of an instance that the module makes"
        )
    vectorised = bool(getattr(act, "vectorised", False))

    def act_all(observation: FloatArray) -> FloatArray:
        with contained(name, "a call"):
            if vectorised:
                rows = [np.asarray(spaces.observed(vector)) for vector in observation]
                given = act(np.stack(rows))
            else:
                given = [act(spaces.observed(vector)) for vector in observation]
        return spaces.labels(name, given, len(observation), units)

    restart = getattr(act, "reset", None)
    return Teacher(act_all, spaces.observations, spaces.actions, restart=restart)


EXPERT = "expert"  # in place of a path: the environment's own method of this name


def expert_of(spaces: OwnSpaces) -> Teacher:
    """Return the environment's own expert as a teacher, which knows the simulation.

    The environment has a method `expert`, which returns the action that it would take now, in the
    environment's own units; of one of several actions its number, or a logit for each.
    """

    def act_in_envs(worlds: Sequence[Any]) -> FloatArray:
        own = (world.unwrapped for world in worlds)
        inner: list[Any] = [w.inner.unwrapped if isinstance(w, AdaptedEnv) else w for w in own]
        if missing := [world for world in inner if not hasattr(world, EXPERT)]:
            raise ConfigError(
                f"{type(missing[0]).__name__} has no expert: give it a method `expert`, which "
                "returns the action that it would take now"
            )
        with contained(spaces.name, "expert()"):
            given = [world.expert() for world in inner]
        return spaces.labels(EXPERT, given, len(inner), "own")

    def refuse(observation: FloatArray) -> FloatArray:
        raise ConfigError("the expert of an environment acts where it runs, not on observations")

    return Teacher(refuse, spaces.observations, spaces.actions, act_in_envs=act_in_envs)


_TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}
_NAMES = ("action", "actions")


def onnx_teacher(path: str, spaces: Callable[[], OwnSpaces], units: Units | None) -> Teacher:
    """Return the teacher in a file; units None are those that its kind has.

    Metadata of our files name the environment. Others have one input, the observation, and one
    output, or one that is named action or actions, as rsl_rl and Isaac Lab export it ("obs" to
    "actions", a batch of one, normaliser inside).

    spaces: called for files that are not ours
    """
    network = session(path)
    if not has_policy_metadata(network):
        return _onnx_of_others(path, network, spaces(), units or "own")
    if units is not None:
        raise ConfigError(f"the teacher {path} says itself how it acts: leave teacher_units out")
    entry, exit_ = _one_input(path, network), network.get_outputs()[0]

    def act_all(observation: FloatArray) -> FloatArray:
        feed = {entry.name: observation.astype(np.float32)}
        action: FloatArray = network.run([exit_.name], feed)[0].astype(np.float64)
        return action

    env = network.get_modelmeta().custom_metadata_map["env"]
    return Teacher(act_all, entry.shape[1], exit_.shape[1], env)


def _onnx_of_others(path: str, network: Any, spaces: OwnSpaces, units: Units) -> Teacher:  # noqa: ANN401
    entry, exit_ = _ends(path, network)
    shape = entry.shape or [None, None]
    inner = shape[1:] if len(shape) > 1 else shape
    own = spaces.observation.shape or ()
    # the shape of one observation: as the file says, else as the environment gives it
    form = own if len(own) == len(inner) else (spaces.observations,)
    if all(isinstance(size, int) for size in inner):
        form = tuple(inner)
    single = len(shape) == 1 or shape[0] == 1  # exporters often fix the batch at one

    def run(rows: FloatArray) -> NDArray[Any]:
        feed = rows.reshape(form if len(shape) == 1 else (len(rows), *form))
        return np.asarray(network.run([exit_.name], {entry.name: feed.astype(_TYPES[entry.type])}))

    def act_all(observation: FloatArray) -> FloatArray:
        given = [run(row[None]) for row in observation] if single else run(observation)
        return spaces.labels(path, given, len(observation), units)

    observations = int(np.prod(form))
    if observations == spaces.observations:  # else refused where sizes are compared
        act_all(np.zeros((1, observations)))
    widths = operators(Path(path)).widths
    fits = widths[:1] == (observations,) and widths[-1:] == (spaces.actions,)
    return Teacher(act_all, observations, spaces.actions, widths=widths if fits else ())


def _ends(path: str, network: Any) -> tuple[Any, Any]:  # noqa: ANN401
    """Return the input, and the output or the action of several; or refuse the file."""
    entry, exits = _one_input(path, network), network.get_outputs()
    if entry.type not in _TYPES:
        raise ConfigError(f"the teacher {path} takes {entry.type}: export it with float inputs")
    if len(entry.shape) > 1 and isinstance(entry.shape[0], int) and entry.shape[0] != 1:
        raise ConfigError(
            f"the teacher {path} takes {entry.shape[0]} observations at once: export it with a "
            "batch of one, or of any size"
        )
    found = exits if len(exits) == 1 else [each for each in exits if each.name in _NAMES]
    if len(found) != 1:
        names = ", ".join(each.name for each in exits)
        raise ConfigError(
            f"the teacher {path} has {len(exits)} outputs ({names}), none or several of them named "
            "action: export it with one output, or name it so"
        )
    return entry, found[0]


def _one_input(path: str, network: Any) -> Any:  # noqa: ANN401
    """Return the input, or refuse a file that has others, such as states."""
    entries = network.get_inputs()
    if len(entries) != 1:
        names = ", ".join(entry.name for entry in entries)
        raise ConfigError(
            f"the teacher {path} has {len(entries)} inputs ({names}), and a teacher sees one "
            "observation: recurrent policies, which keep a state, cannot teach. Export a policy "
            "without"
        )
    return entries[0]


_SHIPPED = (".onnx", ".nir")
# files that Python reads by running what is in them
_PICKLES = (".pkl", ".pickle", ".pt", ".pth", ".joblib")


def teacher(
    path: str, env: str, options: Mapping[str, Any] | None = None, units: Units | None = None
) -> Teacher:
    """Return the teacher to imitate that a path or name means, which must match the environment.

    path: a run folder, an .onnx, .nir or Stable-Baselines3 .zip file, module:function, the name of
        a shipped policy, such as "hexapod/sac", or "expert", that of the environment itself
    options: of the environment, whose own units teachers of other people act in
    units: units of their actions: "own", or "scaled" to [-1, 1]; None for what the kind of teacher
        has
    """
    if not path:
        raise ConfigError(
            "distillation needs a teacher: --set teacher=PATH, where PATH is a run folder, an "
            ".onnx, .nir or Stable-Baselines3 .zip file, my_module:function, or a shipped policy "
            "such as hexapod/sac"
        )
    found = open_teacher(path, env, lambda: OwnSpaces.from_env(env, options or {}), units)
    if found.restart is not None:
        raise ConfigError(
            f"the teacher {path} has a reset(), so it remembers, and a teacher labels single "
            "observations of many robots: it can be compared (--teacher), not imitated"
        )
    return found


def open_teacher(
    path: str, env: str, spaces: Callable[[], OwnSpaces], units: Units | None
) -> Teacher:
    """Return the teacher as `teacher` does, with spaces of an environment that may be made."""
    path = str(find_shipped(path) or path)
    form = suffix(path)
    if path == EXPERT:
        return expert_of(spaces())
    if is_target(path) and not Path(path).exists():
        return own_function(path, spaces(), units or "own")
    if form in (*_SHIPPED, ".zip", *_PICKLES) and not Path(path).is_file():
        raise ConfigError(f"there is no teacher at {path}")
    if form in _PICKLES:
        raise ConfigError(
            f"the teacher {path} is a pickle, which could run code when it is read, and is not "
            f"read. {REMEDY}"
        )
    if form != ".onnx" and units is not None:
        raise ConfigError(f"the teacher {path} says itself how it acts: leave teacher_units out")
    if form == ".onnx":
        found = onnx_teacher(path, spaces, units)
    elif form == ".zip":
        found = sb3_teacher(path, spaces())
    else:
        found = _from_nir(path) if form == ".nir" else _from_run(path)
    if found.env and envs.spec(found.env).id != envs.spec(env).id:
        raise ConfigError(f"the teacher {path} was trained in {found.env}, not in {env}")
    return found


def find_shipped(name: str) -> Path | None:
    """Return the file of a shipped policy; None where a path is meant."""
    return None if Path(name).exists() else _zoo().get(name)


def _zoo() -> dict[str, Path]:
    """Files of the shipped policies by name, such as "hexapod/sac"."""
    folder = Path(str(files("spikedeploy"))) / "zoo"
    found = [path for ending in _SHIPPED for path in sorted(folder.glob(f"**/*{ending}"))]
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in found}


def same_teacher(one: str, other: str) -> bool:
    """Return whether two settings name the same teacher: equal words, paths or files."""
    first, second = (Path(find_shipped(each) or each) for each in (one, other))
    if one == other or first.resolve() == second.resolve():
        return True
    both = first.is_file() and second.is_file()
    return both and first.read_bytes() == second.read_bytes()


def policy_teacher(policy: Policy, env: str = "") -> Teacher:
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
    teacher = teacher.in_envs([made])
    logits = teacher.act_all
    if isinstance(made.action_space, Discrete):
        teacher = replace(teacher, act_all=lambda seen: logits(seen).argmax(-1))
    seeds = range(config.first_seed, config.first_seed + config.episodes)
    return float(np.mean([rollout(made, teacher, seed).total for seed in seeds]))


def _from_run(path: str) -> Teacher:
    try:
        run = RunFolder.find(path)
        settings = run.settings()
    except ConfigError as error:
        near = get_close_matches(path, _zoo(), n=2)
        hint = f"; did you mean the shipped policy {' or '.join(near)}?" if near else ""
        raise ConfigError(f"{error}{hint}") from error
    policy = run.policy()
    if isinstance(policy, DeltaSnnPolicy):
        raise _remembers(path)
    return policy_teacher(policy, str(settings["env"]["name"]))


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
