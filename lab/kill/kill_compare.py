"""Two run folders compared, file by file."""

import csv
from pathlib import Path

# with the folder's name
_TITLED = ("curve.png", "curve.svg", "card.md", "report.html")


def differences(whole: Path, other: Path | None) -> list[str]:
    """Return what differs between the folder of an unbroken run and another, in words."""
    if other is None:
        return ["there is no run folder"]
    ours, theirs = _files(whole), _files(other)
    found = [f"{name} is missing" for name in sorted(ours - theirs)]
    found += [f"{name} is left over" for name in sorted(theirs - ours)]
    return found + [
        f"{name} differs"
        for name in sorted(ours & theirs)
        if _content(whole / name) != _content(other / name)
    ]


def _files(run: Path) -> set[str]:
    """Return the names of a run's files but TensorBoard's."""
    found = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    return {name for name in found if not name.startswith("events.out.")}


def _content(path: Path) -> object:
    """Return what must be equal of a file."""
    if path.name in _TITLED:
        return None
    if path.name != "metrics.csv":
        return path.read_bytes()
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if not k.endswith("_per_s")} for row in rows]
