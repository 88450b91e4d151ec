"""Requests such as `noise:2` or `payload=0.4`: a name with a level, or with a number of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

LEVELS = (1, 2, 3)


@dataclass(frozen=True)
class Scale:
    """The numbers that a request of one name can have.

    levels: numbers of levels 1, 2 and 3; level 0 is 0.
    bounds: (lowest, highest) number that may be given.
    unit: of the number.
    """

    levels: tuple[float, float, float]
    bounds: tuple[float, float]
    unit: str


@dataclass(frozen=True)
class Request:
    """A request.

    name: as in the table of its kind.
    number: in the unit of its scale.
    text: as the command line takes it.
    """

    name: str
    number: float
    text: str

    @property
    def is_level_0(self) -> bool:
        """True where the request asks for nothing, as `noise:0`."""
        return self.text.partition(":")[2] == "0"


def parse_requests(
    texts: Sequence[str], option: str, owner: str, scales: Mapping[str, Scale]
) -> list[Request]:
    """The requests in texts such as `name:level` and `name=number`, without those of level 0.

    option: of the command line, such as "--fault".
    owner: noun for messages, as in "a chip has no fault 'burnt'".

    Raises ValueError with a sentence for the user.
    """
    found = [_parse(text, option, owner, scales) for text in texts]
    names = [request.name for request in found]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ValueError(f"{option} {twice[0]} is given twice: give each once")
    return [request for request in found if not request.is_level_0]


def _parse(text: str, option: str, owner: str, scales: Mapping[str, Scale]) -> Request:
    mark = ":" if ":" in text else "="
    name, separator, given = text.partition(mark)
    if not separator:
        example = f"{next(iter(scales))}:2" if scales else "name:2"
        raise ValueError(f"{option} takes name:level or name=number, as in {example}; got {text!r}")
    if name not in scales:
        raise ValueError(f"{option} {text}: {owner} has no {name!r}; it has {', '.join(scales)}")
    scale = scales[name]
    if mark == ":":
        if given not in ("0", *map(str, LEVELS)):
            raise ValueError(
                f"{option} {text}: {given!r} is no level from 0 to {LEVELS[-1]}; a number is "
                f"written {name}={given}"
            )
        return Request(name, (0.0, *scale.levels)[int(given)], text)
    return Request(name, _number(f"{option} {text}", given, scale), text)


def _number(request: str, given: str, scale: Scale) -> float:
    lowest, highest = scale.bounds
    try:
        number = float(given)
    except ValueError:
        number = float("nan")
    if not lowest <= number <= highest:
        raise ValueError(
            f"{request}: {given!r} is not a number from {lowest:g} to {highest:g} [{scale.unit}]"
        )
    return number
