"""The command line: a table of commands, each of which is imported when it is called."""

import inspect
import os
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.main import get_command_from_info
from typer.models import CommandInfo

from spikedeploy.commands.options import as_command, one_word
from spikedeploy.console import discard_output, name_program, prepare_streams
from spikedeploy.runtime.requirements import check_requirements
from spikedeploy.user_errors import BAD_INPUT, exit_code, one_line

# panel of the help -> command -> its module in spikedeploy/commands
COMMANDS = {
    "Deploy": {
        "demo": "closed_loop",
        "compare": "closed_loop",
        "run": "closed_loop",
        "serve": "closed_loop",
        "emulate": "open_loop",
        "check": "open_loop",
        "drift": "open_loop",
        "verify": "open_loop",
        "reproduce": "closed_loop",
    },
    "Make": {
        "train": "training",
        "tune": "training",
        "distill": "training",
        "adapt": "adapting",
        "export": "exporting",
        "sweep": "training",
    },
    "Look": {
        "play": "closed_loop",
        "visualize": "training",
        "policies": "listings",
        "chips": "listings",
        "energy": "listings",
        "envs": "listings",
        "recipes": "listings",
        "runs": "training",
        "doctor": "listings",
    },
}
_MODULES = {verb: module for verbs in COMMANDS.values() for verb, module in verbs.items()}
_LEFT = 141  # as shells say of SIGPIPE
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def _function(verb: str) -> Any:  # noqa: ANN401
    return getattr(import_module(f"spikedeploy.commands.{_MODULES[verb]}"), verb)


class LazyCommands(Mapping[str, Any]):
    """The commands by name, each made when it is asked for."""

    def __getitem__(self, verb: str) -> Any:  # noqa: ANN401
        if verb not in _MODULES:
            raise KeyError(verb)
        return _command(verb)

    def __iter__(self) -> Iterator[str]:
        return iter(_MODULES)

    def __len__(self) -> int:
        return len(_MODULES)


@cache
def _command(verb: str) -> Any:  # noqa: ANN401
    panel = next(panel for panel, verbs in COMMANDS.items() if verb in verbs)
    info = CommandInfo(verb, callback=as_command(_function(verb)), rich_help_panel=panel)
    return get_command_from_info(info, pretty_exceptions_short=False, rich_markup_mode="rich")


class Commands(typer.core.TyperGroup):
    """The group of all commands, whose help is printed without making any."""

    def __init__(self, **options: Any) -> None:  # noqa: ANN401
        super().__init__(**{**options, "commands": None})
        self.commands = LazyCommands()  # type: ignore[assignment]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # noqa: ANN401
        """Print the help where no command is given, which is bad input."""
        if not args:
            typer.echo(ctx.get_help())
            ctx.exit(BAD_INPUT)
        found: list[str] = super().parse_args(ctx, args)
        return found

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Write usage, options and commands, without loading rich."""
        self.format_usage(ctx, formatter)
        self.format_help_text(ctx, formatter)
        self.format_options(ctx, formatter)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401
        """Write a line for each command, by panel."""
        for panel, verbs in COMMANDS.items():
            docs = {verb: inspect.getdoc(_function(verb)) or "" for verb in verbs}
            with formatter.section(panel):
                formatter.write_dl([(verb, doc.split("\n")[0]) for verb, doc in docs.items()])


app = typer.Typer(
    cls=Commands,
    name="spikedeploy",
    help="From a trained spiking policy to a neuromorphic chip, with proof that the robot still "
    "walks. Start with: spikedeploy demo",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "token_normalize_func": one_word},
)


def _print_version(wanted: bool) -> None:
    from spikedeploy.trainers.versions import own

    if wanted:
        typer.echo(f"spikedeploy {own()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """From a trained spiking policy to a neuromorphic chip."""


def main() -> None:
    """Run the command line; an error that a user can act on becomes one line on stderr.

    Exit codes: 0 done, 1 does not fit or is not equal, 2 bad input, 130 stopped by Ctrl-C, 141
    where the reader of a pipe left.
    """
    for name in THREADS:  # before numpy loads: small networks run faster on one thread
        os.environ.setdefault(name, "1")
    prepare_streams()
    try:
        # `doctor` lists what is wrong itself, and help needs nothing
        if sys.argv[1:] and not {"doctor", "-h", "--help", "--version"} & {*sys.argv[1:]}:
            check_requirements()
        app()
    except SystemExit as stop:  # 1 of rich's or typer's where the reader of a pipe left
        if isinstance(stop.__context__, BrokenPipeError):
            sys.exit(_LEFT)
        raise
    except Exception as error:
        line = one_line(error)
        if line is None:
            raise
        discard_output()
        print(f"error: {name_program(line)}", file=sys.stderr)
        sys.exit(exit_code(error))
