"""Copies of objects with states: a copy acts as the original would, and shares nothing with it.

This holds for copy.copy, copy.deepcopy and pickle. Parts that Python's default would copy wrongly
are built again from their arguments and states, as a Machine does its backends, or refused.
"""

from copy import deepcopy
from typing import Any, ClassVar, TypeVar

from spikedeploy.runtime.errors import ConfigError

AnyCopyable = TypeVar("AnyCopyable", bound="Copyable")


class NotCopyable:
    """Base of objects that cannot be copied exactly: a copy raises ConfigError.

    instead: what to do, a sentence.
    """

    instead: ClassVar[str] = "Make another of what it was made of."

    def __reduce_ex__(self, protocol: Any) -> Any:  # noqa: ANN401
        raise ConfigError(
            f"a {type(self).__name__} cannot be copied or pickled: the copy would act differently, "
            f"or on the original. {self.instead}"
        )


class Copyable:
    """Base of objects that share no changing part with any copy, even a shallow one."""

    # also where a base refuses
    __reduce_ex__ = object.__reduce_ex__

    def __copy__(self: AnyCopyable) -> AnyCopyable:
        return deepcopy(self)
