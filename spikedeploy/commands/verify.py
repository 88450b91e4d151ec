"""`spikedeploy verify`: recorded traces of emulators and chips against the emulator."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.commands.options import Json


def verify(
    traces: Annotated[list[Path], typer.Argument(metavar="TRACE.json…", help="Trace files.")],
    json: Json = False,
) -> None:
    """Replay traces; say equal or the first difference, and exit 1 if any is not equal."""
    from spikedeploy.console import print_json
    from spikedeploy.emulation.trace_replay import replay_trace
    from spikedeploy.reports.terminal import print_replays

    replays = [replay_trace(path) for path in traces]
    if json:
        print_json([each.as_json() for each in replays])
    else:
        print_replays(replays)
    raise typer.Exit(0 if all(each.equal for each in replays) else 1)
