"""A run folder as a file that chips run: exported into the folder, unless that was done already."""

import shlex

from spikedeploy import zoo
from spikedeploy.console import say
from spikedeploy.outputs import no_link
from spikedeploy.policies import run_record
from spikedeploy.policies.registry import BUILT_IN
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.trainers.run_folder import RunFolder, find_run


def runnable(reference: str) -> str:
    """The reference of a policy; a run folder, a name of one, or "last" as its file.

    The file has the name of the run, and is written anew where a checkpoint is newer.
    """
    if reference in BUILT_IN or not _is_run(reference):
        return reference
    folder = RunFolder.find(reference)
    run = folder.path
    to = run_record.format_of(run)
    name = folder.deployed()
    checkpoint = folder.checkpoint(name)
    if folder.begun and not checkpoint.is_file():
        folder.load(name)  # which says what is missing
    if not checkpoint.is_file():
        raise ConfigError(
            f"{run} has no checkpoint yet: train it further, --resume {shlex.quote(run.name)}"
        )
    file = run / f"{run.resolve().name}.{to}"
    if file.is_file() and file.stat().st_mtime_ns >= checkpoint.stat().st_mtime_ns:
        return str(file)
    from spikedeploy.shipping.export_run import export_run

    written = export_run(str(run), to, no_link(file), force=True)
    if not written.passed:
        file.unlink()
    remedy = f"; `spikedeploy export {shlex.quote(str(run))} --to {to}` shows all checks"
    written.require_passed(str(run), remedy)
    say(f"exported {file}")
    return str(file)


def trained_in(reference: str) -> str | None:
    """Name of the environment that a run folder was trained in; None for any other reference."""
    if reference in BUILT_IN or not _is_run(reference):
        return None
    return str(run_record.settings(RunFolder.find(reference).path)["env"]["name"])


def _is_run(reference: str) -> bool:
    if reference == "last":
        return True
    place = zoo.resolve(reference)
    return place.is_dir() if place else find_run(reference) is not None
