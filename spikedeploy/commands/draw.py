"""`spikedeploy draw`: a window to draw a track in."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.commands.options import Json


def draw(
    file: Annotated[
        Path, typer.Argument(metavar="[FILE.json]", dir_okay=False, help="New, or to be edited.")
    ] = Path("track.json"),
    copy: Annotated[
        str | None,
        typer.Option(metavar="TRACK", help="Begin a new file with this track, by name or file."),
    ] = None,
    json: Json = False,
) -> None:
    """Draw or edit a track; an invalid track is kept as a draft."""
    from spikedeploy.console import print_json
    from spikedeploy.play.track_editor import TrackEditor
    from spikedeploy.play.window import show

    app = TrackEditor(file, copy)
    try:
        show(app)
    finally:
        draft = app.close()
    if json:
        result = {"track": str(file) if app.saved else None, "draft": str(draft) if draft else None}
        print_json(result)
        return
    if app.saved:
        typer.echo(f"wrote {file}; drive it: spikedeploy play kart-grid --track {file}")
    if draft:
        typer.echo(f"kept {draft}; `spikedeploy draw {file}` goes on with it")
