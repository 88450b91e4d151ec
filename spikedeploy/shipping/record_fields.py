"""What cards and reports have to say, checked before anything of them is used.

A form is a FieldKind, a table of forms by field (`name?` may be missing), or a list with the form
of each item. Fields that no form names are passed over.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spikedeploy.runtime.errors import ConfigError


@dataclass(frozen=True)
class FieldKind:
    """What a value has to be.

    says   in words
    holds  whether a value is one
    """

    says: str
    holds: Callable[[Any], bool]


Form = FieldKind | Mapping[str, Any] | Sequence[Any]


def _whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63


def _finite(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 2**1000 if isinstance(value, int) else math.isfinite(value)


def _table_of_texts(value: object) -> bool:
    return isinstance(value, dict) and all(isinstance(v, str | None) for v in value.values())


_TEXT = FieldKind("a text", lambda value: isinstance(value, str))
_TEXT_OR_NULL = FieldKind("a text or null", lambda value: isinstance(value, str | None))
_NAME = FieldKind(
    "the name of a file beside it",
    lambda value: isinstance(value, str) and value not in ("", "..") and Path(value).name == value,
)
_BOOLEAN = FieldKind("true or false", lambda value: isinstance(value, bool))
_WHOLE = FieldKind("a whole number from 0 up", _whole)
_TABLE = FieldKind("a table", lambda value: isinstance(value, dict))
_TEXTS = FieldKind("a table of texts", _table_of_texts)
_LIST_OF_TEXTS = FieldKind(
    "a list of texts", lambda value: isinstance(value, list) and all(map(_TEXT.holds, value))
)
_LIST = FieldKind("a list", lambda value: isinstance(value, list))
_RETURNS = FieldKind(
    "a list of finite numbers, one an episode",
    lambda value: isinstance(value, list) and all(map(_finite, value)),
)
_ROW = {
    "returns": _RETURNS,
    "episodes": _WHOLE,
    "policy": _TEXT,
    "chip": _TEXT_OR_NULL,
    "limits?": _BOOLEAN,
    "reference?": _TEXT_OR_NULL,
}
_CARD = {
    "file": _NAME,
    "env": _TEXT,
    "sha256?": _TEXT_OR_NULL,
    "config?": {"env?": {"name": _TEXT, "options?": _TABLE}},
    "seeds?": {"first": _WHOLE},
    "versions?": _TEXTS,
    "evaluated_with?": _TEXTS,
    "evaluation": [_ROW],
}
_REPORT = {
    "env": _TEXT,
    "command": _TEXT,
    "seeds": {"first": _WHOLE},
    "sha256?": _TEXTS,
    "versions?": _TEXTS,
    "rows": [{**_ROW, "file": _TEXT}],
}
_TRAINING = {
    "recipe": _TEXT,
    "seed": _WHOLE,
    "overrides": _LIST_OF_TEXTS,
    "steps": _WHOLE,
    "steps_unit": _TEXT,
}
_PAGE = {
    **_TRAINING,
    "checkpoint": _TEXT,
    "commit": _TEXT_OR_NULL,
    "created": _TEXT,
    "note": _TEXT,
}


def check_card(path: Path, record: Mapping[str, Any]) -> None:
    """Refuse a card of which an evaluation cannot be made again."""
    if "file" not in record:
        raise ConfigError(f"{path} is no card of a policy: it has no 'file'")
    _check(path, record, _CARD)


def check_report(path: Path, record: Mapping[str, Any]) -> None:
    """Refuse a report of which an evaluation cannot be made again."""
    _check(path, record, _REPORT)


def check_page(path: Path, record: Mapping[str, Any], kinds: Sequence[str]) -> None:
    """Refuse a card that lacks what its page says; kinds: those of policies."""
    _check(path, record, _PAGE)
    among = FieldKind(f"one of {', '.join(kinds)}", lambda value: value in list(kinds))
    check = {"name": _TEXT, "detail": _TEXT, "passed": _BOOLEAN}
    _check(path, record, {"kind": among, "before": _LIST, "parity": _LIST})
    for each in record["parity"]:
        _check(path, each, check, "an item of 'parity'")
    for each in record["before"]:
        _check(path, each, {**_TRAINING, "gives": _TEXT}, "an item of 'before'")


def _check(path: Path, value: Any, form: Form, place: str = "") -> None:  # noqa: ANN401
    """Refuse a value that is not of its form."""
    if isinstance(form, FieldKind):
        _require(form.holds(value), path, place, value, form.says)
    elif isinstance(form, Mapping):
        _require(isinstance(value, dict), path, place, value, "a table")
        for key, inner in form.items():
            name = key.removesuffix("?")
            if name in value:
                _check(path, value[name], inner, f"{place}.{name}".removeprefix("."))
            elif name == key:
                raise ConfigError(f"{path}: {place or 'it'} has no {name!r}. {_REMEDY}")
    else:
        _require(isinstance(value, list) and bool(value), path, place, value, "a list of rows")
        for index, item in enumerate(value):
            _check(path, item, form[0], f"{place}[{index}]")


_REMEDY = "Restore the file, or evaluate the policy anew."


def _require(holds: bool, path: Path, place: str, value: object, says: str) -> None:
    if not holds:
        raise ConfigError(f"{path}: {place} is {_shown(value)}, not {says}. {_REMEDY}")


def _shown(value: object) -> str:
    """A value in a few words."""
    if value is None:
        return "null"
    if isinstance(value, int) and value.bit_length() > 100:
        return "a number of many digits"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
