"""`spikedeploy play`: a window to drive in."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy import seeds
from spikedeploy.commands.options import EnvOptions, Json, PolicyChip, Seed


def play(
    env: Annotated[str, typer.Argument(metavar="ENV", help="Environment; `envs` lists them.")],
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
        Path | None, typer.Option(dir_okay=False, help=".npz for `replay`, one for each drive.")
    ] = None,
    set_: EnvOptions = None,
    seed: Seed = seeds.EVALUATION,
    json: Json = False,
) -> None:
    """Drive a kart with WASD or the arrows, command a hexapod, or watch a policy."""
    from spikedeploy.console import print_json
    from spikedeploy.make_env import parse_options
    from spikedeploy.play.drive_app import DriveApp, open_session
    from spikedeploy.play.window import show

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
