"""The command line: a table of commands and the files in `spikedeploy/commands` that hold them."""

import os
import sys
from importlib import import_module

import typer

from spikedeploy.user_errors import one_line

# panel of the help -> command -> its module in spikedeploy/commands
COMMANDS = {
    "Deploy": {
        "demo": "closed_loop",
        "compare": "closed_loop",
        "run": "closed_loop",
        "emulate": "open_loop",
        "check": "checks",
        "drift": "open_loop",
        "verify": "checks",
        "reproduce": "evidence",
    },
    "Make": {
        "train": "training",
        "export": "training",
        "publish": "training",
        "experiment": "training",
        "draw": "windows",
    },
    "Look": {
        "play": "windows",
        "replay": "windows",
        "visualize": "training",
        "policies": "listings",
        "chips": "listings",
        "energy": "listings",
        "envs": "listings",
        "recipes": "listings",
        "doctor": "checks",
    },
}
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

app = typer.Typer(
    name="spikedeploy",
    help="From a trained spiking policy to a neuromorphic chip, with proof that the robot still "
    "walks. Start with: spikedeploy demo",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for _panel, _verbs in COMMANDS.items():
    for _verb, _module in _verbs.items():
        _command = getattr(import_module(f"spikedeploy.commands.{_module}"), _verb)
        app.command(_verb, rich_help_panel=_panel)(_command)


def main() -> None:
    """Run the command line; an error that a user can act on becomes one line on stderr, exit 1."""
    for name in THREADS:  # before numpy loads: small networks run faster on one thread
        os.environ.setdefault(name, "1")
    try:
        app()
    except Exception as error:
        line = one_line(error)
        if line is None:
            raise
        print(f"error: {line}", file=sys.stderr)
        sys.exit(1)
