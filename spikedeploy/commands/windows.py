"""`play`, `replay` and `draw`: the commands that open a window."""

import shlex
from pathlib import Path
from typing import Any

import typer

from spikedeploy import seeds
from spikedeploy.console import name_program, print_json, print_result, program_name


def play(
    *,
    env: str,
    track: str | None = None,
    policy: str | None = None,
    chip: str | None = None,
    record: Path | None = None,
    set_: list[str] | None = None,
    seed: int = seeds.EVALUATION,
    force: bool = False,
    json: bool = False,
) -> None:
    """Drive a kart with WASD or the arrows, command a hexapod, or watch a policy."""
    from spikedeploy.outputs import check_output
    from spikedeploy.play.display import check_display

    if record is not None:
        check_output("--record", record, (policy, track), force)
    check_display()
    from spikedeploy.make_env import parse_options
    from spikedeploy.play.drive import DriveApp, open_session
    from spikedeploy.play.window import show
    from spikedeploy.shipping.exported_run import runnable

    policy = policy and runnable(policy)
    options = parse_options(set_ or ()) | ({} if track is None else {"track": track})
    drive = open_session(env, options, policy, chip, seed, record)
    show(DriveApp(drive, env))
    drive.close()
    files = [str(path) for path in drive.files]
    lines = [f"{number}: {outcome.line}" for number, outcome in enumerate(drive.outcomes, 1)]
    lines += [f"wrote {path}" for path in files]
    outcomes = [vars(outcome) for outcome in drive.outcomes]
    print_result(json, {"episodes": outcomes, "files": files}, *lines)


def replay(
    *,
    source: list[Path],
    mode: str = "batch",
    batch: int = 1,
    spikes: str | None = None,
    chip: str = "loihi1",
    speed: float = 1.0,
    video: Path | None = None,
    seconds: float = 60.0,
    set_: list[str] | None = None,
    force: bool = False,
    json: bool = False,
) -> None:
    """Replay a training's episodes as ghosts, or an episode that `play --record` wrote."""
    from spikedeploy.play.display import check_display

    if video is None:
        check_display()
    from spikedeploy.outputs import check_output, has_text, mark

    if video is not None:
        own = mark("replay")
        check_output("--video", video, (*source, spikes), force, lambda path: has_text(path, own))

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
    *,
    file: Path = Path("track.json"),
    copy: str | None = None,
    json: bool = False,
) -> None:
    """Draw or edit a track; an invalid track is kept as a draft."""
    from spikedeploy.play.display import check_display

    check_display()
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
    named = shlex.quote(str(file))
    if app.saved:
        typer.echo(f"wrote {file}; drive it: {program_name()} play kart-grid --track {named}")
    if draft:
        typer.echo(name_program(f"kept {draft}; `spikedeploy draw {named}` goes on with it"))
