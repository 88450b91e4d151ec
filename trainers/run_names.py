"""What names of runs mean: a path, a name in a folder of runs, or the beginning of one."""

from pathlib import Path

from spikedeploy.runtime.errors import ConfigError

_LISTED = 8


def run_named(name: str | Path, runs: str | Path = "runs") -> Path | None:
    """Return the run folder of a path, of a name in `runs`, or of one that begins so; else None.

    ConfigError lists the runs where several begin so.
    """
    places = (Path(name), Path(runs) / name)
    for place in places:
        if is_run(place):
            return place
    # a folder or file that is there is meant itself
    if not Path(name).name or any(place.exists() for place in places):
        return None
    found = {run.resolve(): run for place in places for run in _beginning(place)}
    if len(found) > 1:
        raise ConfigError(_ambiguous(str(name), sorted(map(str, found.values()))))
    return next(iter(found.values()), None)


def existing_run(name: str | Path, runs: str | Path = "runs") -> Path:
    """Return the run folder that a name means; ConfigError where there is none."""
    if (path := run_named(name, runs)) is not None:
        return path
    beside = "" if Path(name).is_absolute() else f", nor in {Path(runs) / name}"
    raise ConfigError(f"'{name}' is no run folder: no config.json in it{beside}")


def is_beginning(name: str, runs: str | Path = "runs") -> bool:
    """Return whether a name is the beginning of a run's, and not all of it."""
    return run_named(name, runs) not in (None, Path(name), Path(runs) / name)


def is_run(path: Path) -> bool:
    """Return whether a path is a run folder."""
    return (path / "config.json").is_file()


def runs_in(folder: Path) -> list[Path]:
    """Return the run folders in a folder, by name."""
    return sorted(path for path in folder.iterdir() if is_run(path)) if folder.is_dir() else []


def _beginning(place: Path) -> list[Path]:
    """Return the runs beside a path whose names begin with its last part."""
    return [run for run in runs_in(place.parent) if run.name.startswith(place.name)]


def _ambiguous(name: str, found: list[str]) -> str:
    more = f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
    return f"{name!r} is the beginning of {len(found)} runs: {', '.join(found[:_LISTED])}{more}"
