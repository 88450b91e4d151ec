"""A JSON object of another program, read by name, with errors that name the field.

`Work` sums up what a replay computes, layer by layer, before anything of it is allocated.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikedeploy.runtime.errors import TraceError
from spikedeploy.runtime.files import read_text

Integers = NDArray[np.int64]

# JSON numbers that float64 holds exactly
_EXACT = 1 << 53
_HUGE = 1e300
_KINDS = {int, float, bool}  # of numbers in JSON
# what a trace needs at most; a file of more would take hours or all memory
_MOST_FIELDS = 1000
_MOST_LAYERS = 256
_SHOWN = 5  # names in a message
_MOST_READ = 1 << 24  # numbers; those that layers share are read for each layer


def read_json(path: Path) -> "Fields":
    """Return the object in a JSON file."""
    try:
        found = json.loads(read_text(path, "utf-8-sig"))
    except UnicodeDecodeError as error:
        raise TraceError(
            f"{path}: this is not a text file. A trace is JSON, as docs/traces.md shows."
        ) from error
    except (ValueError, RecursionError) as error:
        reason = str(error) or type(error).__name__
        raise TraceError(f"{path}: this is not JSON: {reason}. Write the trace again.") from error
    return Fields(found, path.name)


class Fields:
    """One JSON object.

    where: its place, for messages.
    unread: names of the fields that were not asked for.
    assumed: what was taken for fields that are missing, as in "refractory 1", in order.
    """

    def __init__(self, found: object, where: str, read: list[int] | None = None) -> None:
        if not isinstance(found, Mapping):
            raise TraceError(
                f"{where}: expected an object {{...}}, found {type(found).__name__}. A trace file "
                "is an object with the fields that docs/traces.md lists."
            )
        if len(found) > _MOST_FIELDS:
            raise TraceError(
                f"{where}: there are {len(found)} fields. Write {_MOST_FIELDS} at most."
            )
        self._found = {str(key): value for key, value in found.items() if value is not None}
        self.where = where
        self.unread = set(self._found)
        self.assumed = list[str]()
        self._read = [0] if read is None else read  # numbers so far, of all objects of a file

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
        return Fields(kept | renamed, self.where, self._read)

    def merged_with(self, *others: "Fields", where: str = "") -> "Fields":
        """Return these fields and those of the others, which go before."""
        everything: dict[str, object] = {}
        for each in (self, *others):
            everything.update(each._found)
        return Fields(everything, where or self.where, self._read)

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

    def choice(self, name: str, choices: Sequence[str]) -> str:
        """Return the text called `name`, one of the choices; the first where there is none."""
        if (found := self.text(name, choices[0])) not in choices:
            raise self.wrong(name, f"is {found[:40]!r}", f"Write one of {', '.join(choices)}.")
        return found

    def has_content(self, name: str) -> bool:
        """Return True if there is anything in the field; an empty list is nothing."""
        self.unread.discard(name)
        if not (found := bool(self._found.get(name))):
            self.assume(name, "none")
        return found

    def flag(self, name: str, default: bool | None = None) -> bool | None:
        """Return the true or false called `name`; the default where it is missing."""
        if name not in self:
            if default is not None:
                self.assume(name, str(default).lower())
            return default
        found = self._take(name)
        if not isinstance(found, bool):
            raise self.wrong(name, f"is {_short(found)}", "Write true or false.")
        return found

    def group(self, name: str) -> "Fields":
        """Return the object called `name`; empty where there is none."""
        found = self._take(name) if name in self else {}
        return Fields(found, f"{self.where}: {name}", self._read)

    def groups(self, name: str) -> list["Fields"]:
        """Return the list of objects called `name`."""
        found = self.rows(name)
        if not found or len(found) > _MOST_LAYERS:
            raise self.wrong(name, f"has {len(found)}", f"Write a list of 1 to {_MOST_LAYERS}.")
        return [Fields(o, f"{self.where}: {name}[{k}]", self._read) for k, o in enumerate(found)]

    def rows(self, name: str) -> list[Any]:
        """Return the list called `name`, of anything; it may be empty."""
        found = self._take(name)
        if not isinstance(found, list):
            raise self.wrong(name, f"is {_short(found)}", "Write a list.")
        return found

    def lists(self, name: str, *, least: int, most: int) -> tuple[tuple[int, ...], ...]:
        """Return lists of whole numbers within a range, of any lengths."""
        found = self.rows(name)
        for each in found:
            if not isinstance(each, list):
                raise self.wrong(name, f"is {_short(found)}", "Write a list of lists.")
            if wrong := [x for x in each if type(x) is not int or not least <= x <= most]:
                remedy = f"Write whole numbers within {least} and {most}."
                raise self.wrong(name, f"holds {_short(wrong[0])}", remedy)
        return tuple(map(tuple, found))

    def numbers(self, *names: str) -> dict[str, float]:
        """Return those of the finite numbers that are there, by name."""
        found = {name: self._take(name) for name in names if name in self}
        for name, value in found.items():
            if type(value) not in (int, float) or not -_HUGE < value < _HUGE:
                raise self.wrong(name, f"is {_short(value)}", "Write a finite number.")
        return found

    def floats(self, name: str, size: int) -> NDArray[np.float64]:
        """Return (size,) finite numbers."""
        found = self._take(name)
        if not isinstance(found, list) or len(found) != size:
            raise self.wrong(name, f"is {_short(found)}", f"Write a list of {size} numbers.")
        if not all(type(each) in (int, float) and -_HUGE < each < _HUGE for each in found):
            raise self.wrong(name, f"holds {_short(found)}", "Write finite numbers.")
        self._count(name, found)
        return np.array(found, np.float64)

    def integer(self, name: str, *, default: int, least: int, most: int) -> int:
        """Return a single whole number within its range."""
        if name not in self:
            self.assume(name, default)
            return default
        return int(self.array(name, axes=0, least=least, most=most))

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
        found = self._numbers(name)
        if found.ndim > axes:
            raise self.wrong(name, f"has shape {found.shape}", f"Write lists {axes} deep at most.")
        outside = found[(found < least) | (found > most)]
        if outside.size:
            remedy = f"It must be within {least} and {most}."
            raise self.wrong(name, f"holds {outside.flat[0]}", remedy)
        return found.astype(np.int64)

    def wrong(self, name: str, found: str, remedy: str) -> TraceError:
        """Return the error of a field."""
        return TraceError(f"{self.where}: {name} {found}. {remedy}")

    def _take(self, name: str) -> Any:  # noqa: ANN401
        if name not in self:
            remedy = "Add it; docs/traces.md lists the fields of a trace."
            raise self.wrong(name, "is missing", remedy)
        self.unread.discard(name)
        return self._found[name]

    def _count(self, name: str, value: object) -> None:
        """Refuse what is no table of numbers, or one more than can be read."""
        count = _counted(value)
        if count is None:
            raise self.wrong(name, f"holds {_short(value)}", "Write whole numbers of 64 bits.")
        self._read[0] += count
        if self._read[0] > _MOST_READ:
            raise self.wrong(name, f"makes {self._read[0]} numbers in all layers", "Record less.")

    def _numbers(self, name: str) -> NDArray[Any]:
        value = self._take(name)
        try:
            self._count(name, value)
            found = np.array(value)
        except (ValueError, OverflowError, RecursionError):  # ragged, or too deep
            raise self.wrong(name, "has rows of different lengths", "Write a full table.") from None
        if found.dtype.kind == "f" and np.isfinite(found).all() and (found == np.rint(found)).all():
            found = found if (np.abs(found) > _EXACT).any() else found.astype(np.int64)
        if found.dtype.kind not in "biu" or not found.size:
            raise self.wrong(name, f"holds {_short(value)}", "Write whole numbers of 64 bits.")
        return found.astype(np.int64) if found.dtype.kind == "b" else found


def _counted(value: object) -> int | None:
    """Number of numbers in lists of lists; None where there is anything else.

    NumPy gives every text of an array the length of the longest, which may be terabytes.
    """
    if not isinstance(value, list):
        return 1 if type(value) in _KINDS else None
    kinds = set(map(type, value))
    if kinds <= _KINDS:
        return len(value)
    counts = [_counted(each) for each in value] if kinds <= {*_KINDS, list} else [None]
    # an empty list costs a place too
    return None if None in counts else sum(each or 1 for each in counts)


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


# what a replay computes at most, together about five seconds of one core and 500 MB; axons and
# aliases are taken one by one
MOST = {
    "layers times timesteps": 1 << 15,
    "neurons times timesteps": 1 << 22,
    "neurons": 1 << 17,
    "synapses times timesteps": 1 << 27,
    "axons and aliases times timesteps": 1 << 17,
}
_MOST_SPIKES = 1 << 16  # of the input, each an event of its own
MOST_NUMBERS = 1 << 24  # membranes after each event of a crossbar


@dataclass
class Work:
    """The work of a replay of so many timesteps.

    spec: the fields, for messages.
    inference: timesteps of each of those that are computed side by side; 0 where there is one.
    """

    spec: Fields
    timesteps: int
    inference: int = 0
    layers: int = 0
    neurons: int = 0
    synapses: int = 0
    axons: int = 0

    def add(self, neurons: int, synapses: int, axons: int = 0) -> None:
        """Add another layer; refused where the replay would take too long.

        axons: those whose events a chip adds one after another, and aliases.
        """
        self.layers += 1
        self.neurons, self.synapses = self.neurons + neurons, self.synapses + synapses
        self.axons += axons
        turns, rows = self.inference or self.timesteps, self.timesteps
        found = (
            self.layers * turns,
            self.neurons * rows,
            self.neurons,
            self.synapses * rows,
            self.axons * turns,
        )
        for (what, most), number in zip(MOST.items(), found, strict=True):
            if number > most:
                remedy = f"At most {most} are replayed: record less, or in parts."
                raise self.spec.wrong("replay", f"has {number} {what}", remedy)

    def check_input(self, counts: Integers) -> None:
        """Refuse more input spikes (T, M) than are replayed one by one."""
        if (found := int(counts.sum())) > _MOST_SPIKES:
            remedy = f"Record {_MOST_SPIKES} spikes at most."
            raise self.spec.wrong("input_spikes", f"has {found} spikes", remedy)
