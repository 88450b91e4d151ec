"""`reproduce`: recorded evaluations, made again."""

import shlex
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spikedeploy.commands.closed_loop import compare
from spikedeploy.commands.options import Force, Json, Workers, quantisation

if TYPE_CHECKING:
    from spikedeploy.shipping.cards import Settings
    from spikedeploy.shipping.reproduce import Reproduction

# of which the numbers depend most
_PACKAGES = ("mujoco", "pymunk", "numpy", "onnxruntime", "torch")


def reproduce(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[NAME]…",
            help="Shipped policies, paths of cards, folders with a report.json of `compare`.",
            show_default="all shipped policies",
        ),
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Only the first seeds.", show_default="all recorded")
    ] = None,
    env: Annotated[
        str | None,
        typer.Option(
            metavar="module:Class",
            help="Environment of your own that a record names, whose code may be run.",
        ),
    ] = None,
    update: Annotated[
        bool,
        typer.Option(
            "--update", help="Write the numbers found into cards, where all returns are equal."
        ),
    ] = False,
    force: Force = False,
    workers: Workers = None,
    json: Json = False,
) -> None:
    """Evaluate policies again as recorded; say equal or the first difference, and exit 1 then."""
    from spikedeploy import zoo
    from spikedeploy.console import print_json
    from spikedeploy.make_env import confirm
    from spikedeploy.shipping import reproduce as again
    from spikedeploy.shipping.cards import recorded

    evaluations = [recorded(name, settings) for name in names or zoo.names()]
    for evaluation in evaluations:  # before hours of others
        confirm(evaluation.env, env, evaluation.name)
        again.check_episodes(evaluation, episodes or 1)
    found = []
    for evaluation in evaluations:
        found.append(again.reproduce(evaluation, episodes, workers, update, force))
        if not json:
            typer.echo("\n".join(_lines(found[-1])))
    if json:
        print_json([each.as_json() for each in found])
    raise typer.Exit(0 if update or all(each.equal for each in found) else 1)


def settings(command: str) -> "Settings":
    """The settings that a report's command gives, read as `compare` reads it today."""
    from spikedeploy.make_env import parse_options
    from spikedeploy.runtime.errors import ConfigError
    from spikedeploy.runtime.faults import faults
    from spikedeploy.shipping.cards import Settings

    _, verb, *words = [*shlex.split(command), "", ""]
    if verb == "demo":
        return Settings()
    if verb != "compare":
        raise ConfigError(f"the report's command is {command!r}, and not `spikedeploy compare`")
    given = _parsed(command, [word for word in words if word])
    if given["teacher"]:  # which may be code, and no file has that run
        raise ConfigError(
            f"the report has a row of the teacher {given['teacher']}, which a report does not have "
            "played: run its command again instead"
        )
    return Settings(
        parse_options(given["set_"] or (), given["disturb"] or (), given["success"]),
        quantisation(
            given["quantise"],
            given["rounding"],
            given["headroom"],
            given["thresholds"],
            given["weight_shift"],
        ),
        faults(given["fault"] or (), given["specimen"]),
        tuple(given["energy"] or ()),
        tuple(given["metric"] or ()),
    )


def _parsed(command: str, words: list[str]) -> dict[str, Any]:
    """The parameters of a `compare`."""
    from spikedeploy.runtime.errors import ConfigError

    app = typer.Typer(add_completion=False)
    app.command()(compare)
    try:
        with typer.main.get_command(app).make_context("compare", words) as context:
            return dict(context.params)
    except Exception as error:  # click's, of which typer has a copy of its own
        raise ConfigError(f"the report's command {command!r} is not understood: {error}") from error


def _lines(found: "Reproduction") -> list[str]:
    """What people read."""
    some = f"{found.episodes} of {found.of}" if found.episodes < found.of else f"{found.of}"
    lines = [
        f"{'✓' if found.equal else '✗'} {found.name}: {found.verdict} "
        f"({found.numbers:,} numbers, {some} episodes of {found.rows} rows, {found.seconds:g} s)"
    ]
    if found.difference:
        lines.append(f"    first of {found.differing}: {found.difference.describe()}")
        lines += [f"    {line}" for line in _versions(found)]
    if found.not_compared:
        lines.append(
            f"    not compared: {len(found.not_compared)} fields that are of all {found.of} "
            f"episodes: {', '.join(found.not_compared[:3])}… (--json names all)"
        )
    return lines + [f"    not recorded: {each}" for each in found.not_recorded]


def _versions(found: "Reproduction") -> list[str]:
    """Versions then and now: those that may matter, and all that differ."""
    return [
        f"{name} {then or 'not installed'} then, {now or 'not installed'} now"
        for name, (then, now) in found.versions.items()
        if name in _PACKAGES or then != now
    ]
