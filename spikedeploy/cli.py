"""The command line: a table of commands and the files in `spikedeploy/commands` that hold them."""

import os
import sys
from importlib import import_module
from typing import Annotated

import typer

from spikedeploy.commands.options import one_word, with_groups
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
        "publish": "exporting",
        "sweep": "training",
    },
    "Look": {
        "play": "windows",
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
_MOVED = ("experiment", "interop")  # to lab/, which is not installed
_LEFT = 141  # as shells say of SIGPIPE
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

app = typer.Typer(
    name="spikedeploy",
    help="From a trained spiking policy to a neuromorphic chip, with proof that the robot still "
    "walks. Start with: spikedeploy demo",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "token_normalize_func": one_word},
)

for _panel, _verbs in COMMANDS.items():
    for _verb, _module in _verbs.items():
        _command = getattr(import_module(f"spikedeploy.commands.{_module}"), _verb)
        app.command(_verb, rich_help_panel=_panel)(with_groups(_command))


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
    """Run the command line."""
    if sys.argv[1:2] and sys.argv[1] in _MOVED:
        line = f"this is `python -m lab {sys.argv[1]}` in a checkout of spikedeploy"
        print(f"error: {line}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    run(app)


def run(commands: typer.Typer) -> None:
    """Run commands; an error that a user can act on becomes one line on stderr.

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
        commands()
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
