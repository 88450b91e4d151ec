"""Copies of what holds states: each acts as the original would, and none acts on another.

By copy.copy, copy.deepcopy and pickle alike. What Python's default would take apart is made anew
from what it was made of and its states, as a Machine makes its backends, or refused.
"""

from copy import deepcopy
from typing import Any, ClassVar, TypeVar

from spikedeploy.runtime.errors import ConfigError

AnyCopied = TypeVar("AnyCopied", bound="Copied")


class Uncopied:
    """What cannot be copied exactly, and refuses with ConfigError.

    instead: what to do, a sentence.
    """

    instead: ClassVar[str] = "Make another of what it was made of."

    def __reduce_ex__(self, protocol: Any) -> Any:  # noqa: ANN401
        raise ConfigError(
            f"a {type(self).__name__} cannot be copied or pickled: the copy would act differently, "
            f"or on the original. {self.instead}"
        )


class Copied:
    """What shares nothing that changes with a copy of it, a shallow one included."""

    # also where a base refuses
    __reduce_ex__ = object.__reduce_ex__

    def __copy__(self: AnyCopied) -> AnyCopied:
        return deepcopy(self)
