"""Data from files checked by pydantic, with one sentence for all that is wrong."""

import reprlib
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from spikedeploy.runtime.errors import ConfigError, SpikedeployError

T = TypeVar("T")
_SHOWN = 3  # faults in a message


def validate(kind: type[T], data: object, source: object, remedy: str = "") -> T:
    """`data` as an instance of `kind`; ConfigError of `source` names what is wrong."""
    try:
        return TypeAdapter(kind).validate_python(data)
    except ValidationError as error:
        faults = [_sentence(**fault) for fault in error.errors(include_url=False)]
        more = f"; and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
        raise ConfigError(f"{source}: {'; '.join(faults[:_SHOWN])}{more}{remedy}") from error
    except SpikedeployError as error:  # of a validator
        raise ConfigError(f"{source}: {error}") from error


def _sentence(loc: tuple[int | str, ...], msg: str, input: Any, **_: object) -> str:  # noqa: ANN401
    """Format one of pydantic's errors as `a.b: what is wrong, got x`."""
    what = msg.removeprefix("Value error, ")
    # one of values that do not go together has no place, and names what it found itself
    return f"{'.'.join(map(str, loc))}: {what}, got {reprlib.repr(input)}" if loc else what
