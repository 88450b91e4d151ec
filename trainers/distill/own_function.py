"""Teachers that are Python functions: my_module:act, from an observation to an action.

It is the user's own code and runs in the user's process. The module that is named is imported, and
nothing else.
"""

from spikedeploy.envs.foreign import attribute, imported
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.distill.own_spaces import OwnSpaces, Units, batched
from spikedeploy.trainers.distill.teacher import FloatArray, Teacher


def own_function(name: str, spaces: OwnSpaces, units: Units) -> Teacher:
    """Return the teacher module:function, which takes the environment's own observations.

    Where the function has the attribute `vectorised`, and it is true, it takes a batch of them.
    """
    module, _, within = name.partition(":")
    act = attribute(name, imported(name, module, "a teacher is module:function"), within)
    if not callable(act):
        raise ConfigError(f"the teacher {name} is no function of an observation, but {act!r}")
    vectorised = bool(getattr(act, "vectorised", False))

    def act_all(observation: FloatArray) -> FloatArray:
        if vectorised:
            given = act(batched(observation, spaces))
        else:
            given = [act(spaces.observed(vector)) for vector in observation]
        return spaces.labels(name, given, len(observation), units)

    return Teacher(act_all, spaces.observations, spaces.actions)
