"""`play`, `replay` and `draw`: the commands that open a window."""

from pathlib import Path
from typing import Annotated, Any

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import EnvOptions, Force, Json, PolicyChip, Seed


def play(
    env: Annotated[
        str,
        typer.Argument(
            metavar="ENV",
            help="Environment; `envs` lists ours; or an id of gymnasium, or module:Class.",
        ),
    ],
    track: Annotated[
        str | None,
        typer.Option(help="Track of a kart: a name, or a .json file.", show_default="big_S"),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Policy to watch.", show_default="you drive a kart"),
    ] = None,
    chip: PolicyChip = None,
    record: Annotated[
        Path | None, typer.Option(help=".npz for `replay`, one for each drive.")
    ] = None,
    set_: EnvOptions = None,
    seed: Seed = seeds.EVALUATION,
    force: Force = False,
    json: Json = False,
) -> None:
    """Drive a kart with WASD or the arrows, command a hexapod, or watch a policy."""
    from spikedeploy.outputs import check_output
    from spikedeploy.play.display import check_display

    if record is not None:
        check_output("--record", record, (policy, track), force)
    check_display()
    from spikedeploy.console import print_json
    from spikedeploy.make_env import parse_options
    from spikedeploy.play.drive import DriveApp, open_session
    from spikedeploy.play.window import show
    from spikedeploy.shipping.exported_run import runnable

    policy = policy and runnable(policy)
    options = parse_options(set_ or ()) | ({} if track is None else {"track": track})
    drive = open_session(env, options, policy, chip, seed, record)
    show(DriveApp(drive, env))
    drive.close()
    if json:
        files = [str(path) for path in drive.files]
        print_json({"episodes": [vars(outcome) for outcome in drive.outcomes], "files": files})
        return
    for number, outcome in enumerate(drive.outcomes, 1):
        typer.echo(f"{number}: {outcome.line}")
    for path in drive.files:
        typer.echo(f"wrote {path}")


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
    video: Annotated[Path | None, typer.Option(help=".mp4 or .gif, instead of a window.")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Of the video, at most.")] = 60.0,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="An option of the environment."),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Replay a training's episodes as ghosts, or an episode that `play --record` wrote."""
    from spikedeploy.play.display import check_display

    if video is None:
        check_display()
    from spikedeploy.console import print_json
    from spikedeploy.outputs import check_output, mark, marked

    if video is not None:
        own = mark("replay")
        check_output("--video", video, (*source, spikes), force, lambda path: marked(path, own))

    from spikedeploy.make_env import parse_options
    from spikedeploy.play.replay import open_replay, save_film
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
    from spikedeploy.play.display import check_display

    check_display()
    from spikedeploy.console import name_program, print_json, program_name
    from spikedeploy.play.draw import TrackEditor
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
        typer.echo(f"wrote {file}; drive it: {program_name()} play kart-grid --track {file}")
    if draft:
        typer.echo(name_program(f"kept {draft}; `spikedeploy draw {file}` goes on with it"))
