"""`play`: the command that opens a window."""

from pathlib import Path

from spikedeploy import seeds
from spikedeploy.console import print_result


def play(
    *,
    env: str,
    track: str | None = None,
    policy: str | None = None,
    chip: str | None = None,
    beside: list[str] | None = None,
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
    from spikedeploy.play.session import open_session
    from spikedeploy.play.window import DriveApp, show
    from spikedeploy.shipping.exported_run import runnable

    policy = policy and runnable(policy)
    options = parse_options(set_ or ()) | ({} if track is None else {"track": track})
    drive = open_session(env, options, policy, chip, seed, record, beside or ())
    show(DriveApp(drive, env))
    drive.close()
    files = [str(path) for path in drive.files]
    lines = [f"{number}: {outcome.line}" for number, outcome in enumerate(drive.outcomes, 1)]
    lines += [f"wrote {path}" for path in files]
    outcomes = [vars(outcome) for outcome in drive.outcomes]
    print_result(json, {"episodes": outcomes, "files": files}, *lines)
