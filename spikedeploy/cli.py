"""The command line: a table of commands, each a file of that name in `spikedeploy/commands`."""

import os
import sys
from importlib import import_module

import typer

from spikedeploy.user_errors import one_line

COMMANDS = {
    "Deploy": ("demo", "compare", "run", "emulate", "check", "drift", "verify"),
    "Make": ("train", "export", "publish", "experiment", "draw"),
    "Look": (
        "play",
        "replay",
        "visualize",
        "policies",
        "chips",
        "energy",
        "envs",
        "recipes",
        "doctor",
    ),
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
    for _verb in _verbs:
        _command = getattr(import_module(f"spikedeploy.commands.{_verb}"), _verb)
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
