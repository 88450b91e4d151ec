"""`play`: the command that opens a window."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy import seeds
from spikedeploy.commands import completion
from spikedeploy.commands.options import ChipName, EnvArgument, EnvOptions, Force, Json, Seed
from spikedeploy.console import print_result


def play(
    *,
    env: EnvArgument,
    track: str | None = None,
    policy: Annotated[str, typer.Option(metavar="FILE", autocompletion=completion.policies)]
    | None = None,
    chip: ChipName | None = None,
    record: Path | None = None,
    set_: EnvOptions | None = None,
    seed: Seed = seeds.EVALUATION,
    force: Force = False,
    json: Json = False,
) -> None:
    """Drive a kart with WASD or the arrows, command a hexapod, or watch a policy.

    track: track of a kart: a name, or a .json file (default: big_S)
    policy: policy to watch (default: you drive a kart)
    record: .npz file, one for each drive
    """
    from spikedeploy.outputs import check_output
    from spikedeploy.play.display import check_display

    if record is not None:
        check_output("--record", record, (policy, track), force)
    check_display()
    from spikedeploy.play.session import open_session
    from spikedeploy.play.window import DriveApp, show
    from spikedeploy.setup import parse_options
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
