"""Metadata of a `.nir` file: typed reading, dataclasses that it stores, and the provenance."""

from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any, ClassVar, Literal, TypeAlias, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import DTypeLike, NDArray

from spikedeploy.runtime.errors import ArtifactError

# what NIR metadata can hold: nir refuses None and loses the type of lists
Tree: TypeAlias = dict[str, "str | int | float | NDArray[np.float64] | Tree"]
_LARGEST = float(np.finfo(np.float64).max)
_S = TypeVar("_S", bound="StoredRecord")


class Record:
    """A group of metadata fields, read by name and type: HDF5 types in, Python types out.

    fields: by name.
    where: path of the group, for messages.

    Every reader raises ArtifactError where the field is missing or of another type.
    """

    def __init__(self, fields: Mapping[str, object], where: str) -> None:
        self.fields = fields
        self.where = where

    def __contains__(self, name: str) -> bool:
        return name in self.fields

    def group(self, name: str) -> "Record":
        """The nested group called `name`."""
        value = self._field(name)
        if not isinstance(value, Mapping):
            raise self._wrong(name, value, "a group of fields")
        return Record(value, f"{self.where}.{name}")

    def text(self, name: str) -> str:
        """The string called `name`."""
        value = self._field(name)
        if not isinstance(value, str):
            raise self._wrong(name, value, "text")
        return value

    def integer(self, name: str) -> int:
        """The integer called `name`."""
        value = self._field(name)
        if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
            raise self._wrong(name, value, "a whole number")
        return int(value)

    def number(self, name: str) -> float:
        """The finite number called `name`."""
        value = self._field(name)
        if not isinstance(value, (float, int, np.floating, np.integer)):
            raise self._wrong(name, value, "a finite number")
        if not abs(value) <= _LARGEST:  # NaN is not, and whole ones can have any length
            raise self._wrong(name, value, "a finite number")
        return float(value)

    def array(self, name: str, infinite: bool = False) -> NDArray[np.float64]:
        """The array of numbers called `name`, float64; finite, or with infinity if `infinite`."""
        value = self._field(name)
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
            raise self._wrong(name, value, "an array of numbers")
        if np.isnan(value).any() or not (infinite or np.isfinite(value).all()):
            raise self._wrong(name, "NaN or infinity", "an array of finite numbers")
        return value.astype(np.float64)

    def only(self, *names: str) -> None:
        """Refuse any other field: ignoring one could change what the file means."""
        unknown = sorted(set(self.fields) - set(names))
        if unknown:
            raise ArtifactError(
                f"metadata {self.where} has the unknown field {unknown[0]!r}; known are "
                f"{', '.join(names)}. If a newer spikedeploy wrote the file, update; otherwise "
                "export the policy again."
            )

    def _field(self, name: str) -> object:
        if name not in self.fields:
            raise ArtifactError(
                f"metadata {self.where}.{name} is missing; the file is incomplete. "
                "Export the policy again."
            )
        return self.fields[name]

    def _wrong(self, name: str, found: object, wanted: str) -> ArtifactError:
        return ArtifactError(
            f"metadata {self.where}.{name} must be {wanted}, found {str(found)[:60]}. "
            "Export the policy again."
        )


# of a field that a file has only where it is not the default
OPTIONAL = {"optional": True}
# of an array that may hold infinity
INFINITE = {"infinite": True}


@dataclass(frozen=True, eq=False)
class StoredRecord:
    """A dataclass that a file stores as a group of its fields: arrays, numbers, texts, groups.

    label: what it is called in messages.
    """

    label: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for each in fields(self):
            if get_origin(each.type) is Literal:
                known, found = get_args(each.type), getattr(self, each.name)
                if found not in known:
                    raise self.unknown(each.name, found, known)

    def unknown(self, name: str, found: object, known: tuple[object, ...]) -> Exception:
        """The error of a field that is none of the choices that are known."""
        return self.wrong(f"{name} {found!r} is unknown; known are {', '.join(map(str, known))}")

    def wrong(self, found: str) -> ArtifactError:
        """The error of values that a file of ours cannot hold."""
        return ArtifactError(f"{self.label}: {found}. Export the policy again.")

    def to_record(self) -> Tree:
        """The fields as the file stores them; one that is optional only where it says something."""
        found: Tree = {}
        for each in fields(self):
            value = getattr(self, each.name)
            if each.metadata.get("optional") and value == each.default:
                continue
            if isinstance(value, np.ndarray):
                value = value.astype(np.float64)
            found[each.name] = value.to_record() if isinstance(value, StoredRecord) else value
        return found

    @classmethod
    def from_record(cls: type[_S], record: Record) -> _S:
        """The object stored in a file; ArtifactError at fields that are unknown or missing."""
        record.only(*(each.name for each in fields(cls)))
        return cls(
            **{
                each.name: _read(record, each)
                for each in fields(cls)
                if each.name in record or not each.metadata.get("optional")
            }
        )

    def astype(self: _S, dtype: DTypeLike) -> _S:
        """Return the object with arrays of another float type."""
        kinds = (np.ndarray, StoredRecord)
        arrays = {name: value for name, value in vars(self).items() if isinstance(value, kinds)}
        return replace(self, **{name: value.astype(dtype) for name, value in arrays.items()})


def _read(record: Record, each: "Field[Any]") -> object:
    if each.type is int:
        return record.integer(each.name)
    if each.type is float:
        return record.number(each.name)
    if each.type is str or get_origin(each.type) is Literal:
        return record.text(each.name)
    if isinstance(each.type, type) and issubclass(each.type, StoredRecord):
        return each.type.from_record(record.group(each.name))
    return record.array(each.name, infinite=bool(each.metadata.get("infinite")))


@dataclass(frozen=True)
class Provenance(StoredRecord):
    """The origin of a policy: all that is needed to train it again.

    env: id of the training environment.
    recipe: name of the training recipe.
    seed: of the training run.
    steps: environment steps of the training run, or updates where it has walks alone.
    created: UTC time of the export, ISO 8601.
    version: of the spikedeploy that wrote the file.
    sha256: of network, codec and convention; `save` writes it and `load` checks it.
    checkpoint: of the training run; empty for its best, and then not in the file.
    chip: whose integers it was trained in, and on which it runs where no other is asked for; empty
        where it was trained for none, and then not in the file.
    """

    env: str
    recipe: str = ""
    seed: int = 0
    steps: int = 0
    created: str = ""
    version: str = ""
    sha256: str = ""
    checkpoint: str = field(default="", metadata=OPTIONAL)
    chip: str = field(default="", metadata=OPTIONAL)
