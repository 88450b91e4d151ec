"""The zoo: the shipped policies, `spikedeploy/zoo/<env>/<name>`, with a card beside each.

Policies that were trained in the integers of one chip stand apart from line-ups, with the teachers
that they imitate: `spikedeploy/zoo/chips/<env>/<chip>`.
"""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from spikedeploy.runtime.files import read_json, suffix

FOLDER = Path(__file__).parent
SUFFIXES = (".onnx", ".nir")
FOR_CHIPS = "chips"  # folder of policies for single chips
TEACHER = "teacher"  # in a folder of policies for chips


def policies(env: str | None = None) -> list[Path]:
    """The shipped policy files, of one environment (short name) or of all, ordered by name."""
    found = (p for p in FOLDER.glob(f"{env or '*'}/*") if p.suffix in SUFFIXES)
    return sorted(found, key=lambda p: (p.parent, p.stem))


def names() -> list[str]:
    """Names of the shipped policies on the command line: `hexapod/popsan`."""
    return [_name(file) for file in policies()]


def path(name: str) -> Path | None:
    """The file of a shipped policy by name, with or without suffix; None where there is none."""
    wanted = Path(name).with_suffix("").as_posix() if suffix(name) in SUFFIXES else name
    return next((p for p in (*policies(), *for_chips()) if _name(p) == wanted), None)


def for_chips() -> list[Path]:
    """The files of policies for single chips and of their teachers, ordered by name."""
    return sorted(p for p in (FOLDER / FOR_CHIPS).glob("*/*") if p.suffix in SUFFIXES)


def teacher(env: str) -> str | None:
    """The name of the shipped float policy of an environment that others imitate, if there is one.

    env: short name; the first of those that are no controls.
    """
    own = FOLDER / FOR_CHIPS / env / f"{TEACHER}.onnx"
    if own.is_file():
        return _name(own)
    return next((_name(p) for p in policies(env) if card(_name(p)).get("kind") == "ann"), None)


def _name(file: Path) -> str:
    return file.relative_to(FOLDER).with_suffix("").as_posix()


def resolve(reference: str) -> Path | None:
    """The existing path, else the shipped policy of that name; None where there is neither."""
    return Path(reference) if Path(reference).exists() else path(reference)


def name_in_reports(file: str) -> str:
    """A policy's file as reports name it: `hexapod/popsan.nir` where it is shipped."""
    place = Path(file)
    return str(place.relative_to(FOLDER)) if place.is_relative_to(FOLDER) else file


def name_in_exports(file: Path) -> str:
    """A policy's file as exports name it, without the folders of the machine that made them."""
    named = name_in_reports(str(file))
    return file.name if named == str(file) else named


def sha256(file: Path) -> str:
    """The hash of a policy's bytes, in hexadecimal."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def hashes(files: Iterable[str]) -> dict[str, str]:
    """File as reports name it -> its sha256; built-ins and run folders have none."""
    places = {file: resolve(file) for file in dict.fromkeys(files)}
    return {file: sha256(place) for file, place in places.items() if place and place.is_file()}


def card(name: str) -> dict[str, Any]:
    """The card of a shipped policy as data; empty without one."""
    file = path(name)
    if file is None or not file.with_suffix(".json").is_file():
        return {}
    return read_json(file.with_suffix(".json"), "install spikedeploy again")


def mean_return(card: Mapping[str, Any]) -> float | None:
    """The mean return on a card; of a spiking policy that of the float twin."""
    return card["evaluation"][0]["return_mean"] if card else None
