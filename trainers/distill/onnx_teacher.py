"""Teachers from ONNX files: ours, whose metadata name the environment, and anybody's.

Anybody's has one input, the observation, and one output, or one that is named action or actions,
as rsl_rl and Isaac Lab export it ("obs" to "actions", a batch of one, normaliser inside).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill.own_spaces import OwnSpaces, Units
from spikedeploy.trainers.distill.teacher import FloatArray, Teacher
from spikedeploy.trainers.onnx_session import says_how_it_acts, session

_TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}
_NAMES = ("action", "actions")


def onnx_teacher(path: str, spaces: Callable[[], OwnSpaces], units: Units | None) -> Teacher:
    """Return the teacher in a file; units None are those that its kind has.

    spaces: called for files that are not ours
    """
    network = session(path)
    if says_how_it_acts(network):
        if units is not None:
            raise ConfigError(
                f"the teacher {path} says itself how it acts: leave teacher_units out"
            )
        return _ours(network)
    return _theirs(path, network, spaces(), units or "own")


def _ours(network: Any) -> Teacher:  # noqa: ANN401
    env: str = network.get_modelmeta().custom_metadata_map["env"]
    entry, exit_ = network.get_inputs()[0], network.get_outputs()[0]

    def act_all(observation: FloatArray) -> FloatArray:
        feed = {entry.name: observation.astype(np.float32)}
        action: FloatArray = network.run([exit_.name], feed)[0].astype(np.float64)
        return action

    return Teacher(act_all, entry.shape[1], exit_.shape[1], env)


def _theirs(path: str, network: Any, spaces: OwnSpaces, units: Units) -> Teacher:  # noqa: ANN401
    entry, exit_ = _entry(path, network), _exit(path, network)
    shape = entry.shape or [None, None]
    form = _form(shape, spaces)
    single = len(shape) == 1 or shape[0] == 1  # exporters often fix the batch at one

    def run(rows: FloatArray) -> NDArray[Any]:
        feed = rows.reshape(form if len(shape) == 1 else (len(rows), *form))
        return np.asarray(network.run([exit_.name], {entry.name: feed.astype(_TYPES[entry.type])}))

    def act_all(observation: FloatArray) -> FloatArray:
        count = len(observation)
        given = [run(row[None]) for row in observation] if single else run(observation)
        return spaces.labels(path, given, count, units)

    observations = int(np.prod(form))
    if observations == spaces.observations:  # else refused where sizes are compared
        act_all(np.zeros((1, observations)))
    return Teacher(act_all, observations, spaces.actions)


def _form(shape: list[Any], spaces: OwnSpaces) -> tuple[int, ...]:
    """Return the shape of one observation: as the file says, else as the environment gives it."""
    inner = shape[1:] if len(shape) > 1 else shape
    if all(isinstance(size, int) for size in inner):
        return tuple(inner)
    own = spaces.observation.shape or ()
    return own if len(own) == len(inner) else (spaces.observations,)


def _entry(path: str, network: Any) -> Any:  # noqa: ANN401
    """Return the input, or refuse the file."""
    entries = network.get_inputs()
    if len(entries) != 1:
        names = ", ".join(entry.name for entry in entries)
        raise ConfigError(
            f"the teacher {path} has {len(entries)} inputs ({names}), and a teacher sees one "
            "observation: recurrent policies, which keep a state, cannot teach. Export a policy "
            "without"
        )
    (entry,) = entries
    if entry.type not in _TYPES:
        raise ConfigError(f"the teacher {path} takes {entry.type}: export it with float inputs")
    if len(entry.shape) > 1 and isinstance(entry.shape[0], int) and entry.shape[0] != 1:
        raise ConfigError(
            f"the teacher {path} takes {entry.shape[0]} observations at once: export it with a "
            "batch of one, or of any size"
        )
    return entry


def _exit(path: str, network: Any) -> Any:  # noqa: ANN401
    """Return the output, the action of several, or refuse the file."""
    exits = network.get_outputs()
    found = exits if len(exits) == 1 else [each for each in exits if each.name in _NAMES]
    if len(found) != 1:
        names = ", ".join(each.name for each in exits)
        raise ConfigError(
            f"the teacher {path} has {len(exits)} outputs ({names}), none or several of them named "
            "action: export it with one output, or name it so"
        )
    return found[0]
