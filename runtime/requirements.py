"""Packages that spikedeploy needs, and the sentence for one that is missing or of a wrong version.

The ranges are those of pyproject.toml, as the installed metadata hold them.
"""

import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version

from spikedeploy.runtime.errors import ConfigError

_LINE = re.compile(r"(?P<name>[\w.-]+)(\[.*?\])?\s*(?P<range>[^;]*)(;(?P<marker>.*))?")
_BOUND = re.compile(r"(>=|<)\s*([\d.]+)")


def check_requirements() -> None:
    """Raise ConfigError with one sentence where a package that every command needs is wrong."""
    for sentence in wrong_requirements():
        raise ConfigError(sentence)


def wrong_requirements(extras: bool = False) -> Iterator[str]:
    """A sentence for each package that is missing or outside its range.

    extras: those of extras too, where they are installed.
    """
    needed = list(_requirements())
    always = {name for name, _, is_extra in needed if not is_extra}
    for name, wanted, is_extra in needed:
        if is_extra and (not extras or name in always):
            continue  # an extra of another environment may narrow the range
        found = _installed(name)
        if found is None and not is_extra:
            yield f"spikedeploy needs {name}, which is not installed: {_remedy(name, wanted)}"
        elif found is not None and not _fits(found, wanted):
            yield (
                f"{name} {found} is installed, and spikedeploy needs {name} {wanted}: "
                f"{_remedy(name, wanted)}"
            )


def _remedy(name: str, wanted: str) -> str:
    return f"pip install '{name}{wanted}'"


def is_required(module: str) -> bool:
    """Return True for the module of a package that every command needs."""
    return any(name.replace("-", "_") == module for name, _, extra in _requirements() if not extra)


def _requirements() -> Iterator[tuple[str, str, bool]]:
    """Name, range such as ">=1.0.8,<2", and whether it is of an extra."""
    try:
        lines = requires("spikedeploy") or []
    except PackageNotFoundError:  # a checkout that is not installed says nothing
        return
    for line in lines:
        found = _LINE.fullmatch(line)
        marker = (found["marker"] or "") if found else ""
        if found and ("extra" in marker or not marker):
            bounds = sorted(_BOUND.findall(found["range"]), reverse=True)
            yield found["name"], ",".join(map("".join, bounds)), bool(marker)


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _fits(found: str, wanted: str) -> bool:
    have = _numbers(found)
    return all(
        have >= _numbers(bound) if kind == ">=" else have < _numbers(bound)
        for kind, bound in _BOUND.findall(wanted)
    )


def _numbers(text: str) -> tuple[int, ...]:
    """The leading numbers of a version; 2.13.0+cpu is 2.13.0, whose trailing zeros do not count."""
    numbers = [int(part) for part in re.match(r"[\d.]*", text)[0].split(".") if part]  # type: ignore[index]
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)
