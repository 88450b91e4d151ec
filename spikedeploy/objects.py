"""Python objects by the names that commands take: module:name.

A class or function of a module is called by its own name. Anything else, such as an instance or a
function within another, is kept here for this process, as in `spikedeploy.objects:Net_1`.
"""

import copy
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikedeploy.evaluation_setup import option_texts
from spikedeploy.runtime.errors import ConfigError

if TYPE_CHECKING:
    import gymnasium


def target(thing: object) -> str:
    """The name of an object; text and paths are names already."""
    if isinstance(thing, str | Path):
        return str(thing)
    module, name = getattr(thing, "__module__", ""), getattr(thing, "__qualname__", "")
    if name.isidentifier() and getattr(sys.modules.get(module), name, None) is thing:
        return f"{module}:{name}"
    kind = (name or type(thing).__name__).rpartition(".")[2]
    kind = kind if kind.isidentifier() else "function"  # a lambda
    here = sys.modules[__name__]
    known = [key for key, value in vars(here).items() if value is thing]
    number = next(n for n in range(1, sys.maxsize) if f"{kind}_{n}" not in vars(here))
    key = known[0] if known else f"{kind}_{number}"
    setattr(here, key, thing)
    return f"{__name__}:{key}"


def is_of_process(name: str) -> bool:
    """True for a name that means something in one process alone, a script's or a notebook's."""
    return name.partition(":")[0] in (__name__, "__main__")


def env_target(env: "str | type | Callable[..., Any] | gymnasium.Env[Any, Any]") -> str:
    """The name of an environment: a name, a class, a function that makes one, or an instance.

    Of an instance each episode in parallel plays in a copy; one that `gymnasium.make` made is made
    again with the same arguments.
    """
    if isinstance(env, str | type) or not hasattr(env, "step"):
        return target(env)
    spec = getattr(env, "spec", None)
    if spec is not None and spec.entry_point is not None:
        return target(_maker(env, spec.make))
    return target(_maker(env, lambda: copy.deepcopy(env)))


_MAKERS: dict[int, tuple[object, Callable[..., Any]]] = {}  # of instances, by identity


def _maker(env: object, make: Callable[..., Any]) -> Callable[..., Any]:
    """Return one function for each instance."""

    def maker(**options: Any) -> Any:  # noqa: ANN401
        if options:
            raise ConfigError(
                f"options {', '.join(options)} with an instance of an environment: give its class"
            )
        return make()

    maker.__name__ = maker.__qualname__ = type(env).__name__
    return _MAKERS.setdefault(id(env), (env, maker))[1]


def teacher_target(teacher: object) -> str:
    """The name of a teacher: a name, a function of an observation, or a model with `predict`.

    The latter is that of Stable-Baselines3: (observations, deterministic) -> actions, states.
    """
    if isinstance(teacher, str | Path) or not hasattr(teacher, "predict"):
        return target(teacher)

    def predict(observation: object) -> object:
        return teacher.predict(observation, deterministic=True)[0]

    predict.__qualname__ = f"{type(teacher).__name__}.predict"
    predict.vectorised = True  # type: ignore[attr-defined]
    return target(_PREDICT.setdefault(id(teacher), (teacher, predict))[1])


_PREDICT: dict[int, tuple[object, Callable[[object], object]]] = {}


def overrides_of(settings: Mapping[str, Any] | Sequence[str]) -> list[str]:
    """Return settings as `--set` takes them, of text or of a dict, nested or with dots."""
    return option_texts(settings) if isinstance(settings, Mapping) else list(settings)
