"""`spikedeploy replay`: recorded episodes again."""

from pathlib import Path
from typing import Annotated, Any

import typer

from spikedeploy.commands.options import Json


def replay(
    source: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE...",
            help="Run folder, ghost file, or recorded drive; several are shown on one track.",
        ),
    ],
    mode: Annotated[
        str, typer.Option(help="'batch': batch by batch of a training; 'all': at once.")
    ] = "batch",
    batch: Annotated[int, typer.Option(min=1, help="Batch to begin with.")] = 1,
    spikes: Annotated[
        str | None,
        typer.Option(metavar="POLICY", help="Show the spikes of this policy beside the leader."),
    ] = None,
    chip: Annotated[
        str, typer.Option(help="Chip of that policy; 'float' for its float twin.")
    ] = "loihi1",
    speed: Annotated[float, typer.Option(help="1 is real time.")] = 1.0,
    video: Annotated[
        Path | None, typer.Option(dir_okay=False, help=".mp4 or .gif, instead of a window.")
    ] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Of the video, at most.")] = 60.0,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="An option of the environment."),
    ] = None,
    json: Json = False,
) -> None:
    """Replay a training's episodes as ghosts, or an episode that `play --record` wrote."""
    from spikedeploy.console import print_json
    from spikedeploy.make_env import parse_options
    from spikedeploy.play.replay_app import open_replay
    from spikedeploy.play.replay_film import save_film
    from spikedeploy.play.window import show

    first, *beside = source
    app = open_replay(first, mode, batch, spikes, chip, speed, parse_options(set_ or ()), beside)
    if video is None:
        show(app)
    else:
        save_film(app, video, seconds)
    result: dict[str, Any] = {"source": str(first), "batches": app.playback.batches}
    if beside:
        result["beside"] = [str(path) for path in beside]
    if json:
        print_json({**result, "video": str(video) if video else None})
    elif video:
        typer.echo(f"wrote {video}")
