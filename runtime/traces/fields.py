"""A JSON object of another program, read by name, with errors that name the field."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.files import read_text

Integers = NDArray[np.int64]

_EXACT = 1 << 53  # JSON numbers below are exact in float64
_HUGE = 1e300
_NUMBERS = {int, float, bool}
_MOST_LAYERS = 256
_SHOWN = 5  # names in a message


def read_json(path: Path) -> "Fields":
    """Return the object in a JSON file."""
    try:
        found = json.loads(read_text(path, "utf-8-sig"))
    except UnicodeDecodeError as error:
        raise TraceError(
            f"{path}: not a text file. A trace is JSON, see docs/traces.md."
        ) from error
    except (ValueError, RecursionError) as error:
        reason = str(error) or type(error).__name__
        raise TraceError(f"{path}: not JSON: {reason}. Write the trace again.") from error
    return Fields(found, path.name)


class Fields:
    """One JSON object.

    where: its place, for messages.
    unread: names of the fields that were not asked for.
    assumed: what was taken for fields that are missing, as in "refractory 1", in order.
    """

    def __init__(self, found: object, where: str) -> None:
        if not isinstance(found, Mapping):
            raise TraceError(f"{where}: expected an object {{...}}, found {type(found).__name__}.")
        self._found = {str(key): value for key, value in found.items() if value is not None}
        self.where = where
        self.unread = set(self._found)
        self.assumed = list[str]()

    def __contains__(self, name: str) -> bool:
        return name in self._found

    def assume(self, name: str, value: object) -> None:
        """Note what is taken for a field that is missing."""
        if (taken := f"{name} {value}") not in self.assumed:
            self.assumed.append(taken)

    def spelled(self, spellings: Mapping[str, str], alone: bool = False) -> "Fields":
        """Return the fields by our names, from those of a tool (its name -> ours).

        alone: whether our names mean something else in the file.
        """
        hidden = {*spellings, *(spellings.values() if alone else ())}
        kept = {name: value for name, value in self._found.items() if name not in hidden}
        renamed = {ours: self._found[name] for name, ours in spellings.items() if name in self}
        return Fields(kept | renamed, self.where)

    def merged_with(self, *others: "Fields", where: str = "") -> "Fields":
        """Return these fields and those of the others, which go before."""
        everything: dict[str, object] = {}
        for each in (self, *others):
            everything.update(each._found)
        return Fields(everything, where or self.where)

    def layers(self) -> list["Fields"]:
        """Return the fields of each layer, and those that the file gives for all layers."""
        shared = self.merged_with(self.group("params"))
        if "layers" not in self:
            return [shared]
        return [
            shared.merged_with(layer, layer.group("params"), where=layer.where)
            for layer in self.groups("layers")
        ]

    def text(self, name: str, default: str = "") -> str:
        """Return the text called `name`; the default where there is none."""
        self.unread.discard(name)
        found = str(self._found.get(name, ""))
        if default and not found:
            self.assume(name, default)
        return found or default

    def choice(self, name: str, choices: Sequence[str], default: str = "") -> str:
        """Return the text called `name`, one of the choices; the default where there is none."""
        if (found := self.text(name, default)) not in choices:
            raise self.wrong(name, f"is {found[:40]!r}", f"Write one of {', '.join(choices)}.")
        return found

    def has_content(self, name: str) -> bool:
        """Return True if there is anything in the field; an empty list is nothing."""
        self.unread.discard(name)
        if not (found := bool(self._found.get(name))):
            self.assume(name, "none")
        return found

    def flag(self, name: str, default: bool) -> bool:
        """Return the true or false called `name`; the default where it is missing."""
        if name not in self:
            self.assume(name, str(default).lower())
            return default
        found = self._take(name)
        if not isinstance(found, bool):
            raise self.wrong(name, f"is {_short(found)}", "Write true or false.")
        return found

    def group(self, name: str) -> "Fields":
        """Return the object called `name`; empty where there is none."""
        return Fields(self._take(name) if name in self else {}, f"{self.where}: {name}")

    def groups(self, name: str) -> list["Fields"]:
        """Return the list of objects called `name`."""
        found = self.rows(name)
        if not 1 <= len(found) <= _MOST_LAYERS:
            raise self.wrong(name, f"has {len(found)}", f"Write a list of 1 to {_MOST_LAYERS}.")
        return [Fields(each, f"{self.where}: {name}[{k}]") for k, each in enumerate(found)]

    def rows(self, name: str) -> list[Any]:
        """Return the list called `name`, of anything; it may be empty."""
        found = self._take(name)
        if not isinstance(found, list):
            raise self.wrong(name, f"is {_short(found)}", "Write a list.")
        return found

    def lists(self, name: str, *, count: int, most: int) -> list[list[int]]:
        """Return lists of whole numbers from 0 to `most`, of any lengths; there must be `count`."""
        found = self.rows(name)
        if len(found) != count:
            raise self.wrong(name, f"has {len(found)} lists", f"Write {count}.")
        for each in found:
            if not isinstance(each, list) or any(
                type(x) is not int or not 0 <= x <= most for x in each
            ):
                remedy = f"Write lists of whole numbers within 0 and {most}."
                raise self.wrong(name, f"holds {_short(each)}", remedy)
        return found

    def floats(self, name: str, size: int | None = None) -> NDArray[np.float64]:
        """Return (size,) finite numbers; without a size a single one."""
        value = self._take(name)
        found = value if size is not None else [value]
        if not isinstance(found, list) or len(found) != (size or 1):
            raise self.wrong(name, f"is {_short(value)}", f"Write a list of {size} numbers.")
        if not all(type(each) in (int, float) and -_HUGE < each < _HUGE for each in found):
            raise self.wrong(name, f"is {_short(value)}", "Write finite numbers.")
        return np.array(found, np.float64)

    def integer(self, name: str, *, default: int, least: int, most: int) -> int:
        """Return a single whole number within its range."""
        return int(self.row(name, size=1, default=default, least=least, most=most)[0])

    def row(
        self, name: str, *, size: int, default: int | None = None, least: int, most: int
    ) -> Integers:
        """Return (size,) whole numbers within a range; one in the file stands for all."""
        if default is not None and name not in self:
            self.assume(name, default)
            return np.full(size, default, np.int64)
        found = self.array(name, axes=1, least=least, most=most)
        if found.size not in (1, size):
            raise self.wrong(name, f"has {found.size} values", f"Write one, or {size}.")
        return np.full(size, found, np.int64)

    def refuse_axes(self, name: str, other: str) -> None:
        """Refuse a text on the order of axes, called `name`, that has the other order (a regex)."""
        if re.search(other, found := self.text(name).strip()):
            raise self.wrong(name, f"is {found[:40]!r}", "Write them in the other order.")

    def table(self, name: str, *, least: int, most: int) -> Integers:
        """Return (T, N) whole numbers; a list of numbers is that of a single neuron."""
        for index in ("trace_index", f"{name}_index"):
            self.refuse_axes(index, r"\]\[t\]$")
        found = self.array(name, axes=2, least=least, most=most)
        if found.ndim == 0:
            raise self.wrong(name, "is a single number", "Write a row for each timestep.")
        return found[:, None] if found.ndim == 1 else found

    def array(self, name: str, *, axes: int, least: int, most: int) -> Integers:
        """Return whole numbers within a range, of at most so many axes."""
        value = self._take(name)
        no_numbers = self.wrong(name, f"holds {_short(value)}", "Write whole numbers of 64 bits.")
        try:
            if not _is_numeric(value):
                raise no_numbers
            found = np.array(value)
        except (ValueError, OverflowError, RecursionError):  # ragged, or too deep
            raise self.wrong(name, "has rows of different lengths", "Write a full table.") from None
        if found.dtype.kind == "f" and np.isfinite(found).all() and (found == np.rint(found)).all():
            found = found if (np.abs(found) > _EXACT).any() else found.astype(np.int64)
        if found.dtype.kind not in "biu" or not found.size:
            raise no_numbers
        if found.ndim > axes:
            raise self.wrong(name, f"has shape {found.shape}", f"Write lists {axes} deep at most.")
        if (outside := found[(found < least) | (found > most)]).size:
            remedy = f"It must be within {least} and {most}."
            raise self.wrong(name, f"holds {outside.flat[0]}", remedy)
        return found.astype(np.int64)

    def wrong(self, name: str, found: str, remedy: str) -> TraceError:
        """Return the error of a field."""
        return TraceError(f"{self.where}: {name} {found}. {remedy}")

    def _take(self, name: str) -> Any:  # noqa: ANN401
        if name not in self:
            raise self.wrong(name, "is missing", "Add it; docs/traces.md lists the fields.")
        self.unread.discard(name)
        return self._found[name]


def _is_numeric(value: object) -> bool:
    """Return True for numbers in lists of lists.

    NumPy gives every text of an array the length of the longest, which may be terabytes.
    """
    if not isinstance(value, list):
        return type(value) in _NUMBERS
    kinds = set(map(type, value))
    return kinds <= _NUMBERS or (kinds <= {*_NUMBERS, list} and all(map(_is_numeric, value)))


def escape(text: str, most: int = 80) -> str:
    """Return an untrusted text on one line of a terminal, control characters escaped."""
    line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[: most + 1])
    return line if len(line) <= most else f"{line[:most]}…"


def shown_names(names: Sequence[str]) -> str:
    """Return the first names, and how many more there are."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(escape(name) for name in names[:_SHOWN]) + more


def _short(value: object) -> str:
    found = repr(value)
    return found if len(found) <= 40 else f"{found[:40]}…"
