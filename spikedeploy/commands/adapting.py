"""`adapt`: a network whose accuracy fell on a chip, trained on through the chip's integers."""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spikedeploy.commands.options import File, Force, Json, NetworkFile, TrainedFor
from spikedeploy.console import print_json, say
from spikedeploy.evaluation_setup import Count, Natural, Reading, Switch
from spikedeploy.runtime.errors import ConfigError

if TYPE_CHECKING:
    from spikedeploy.trainers.adapt import Adaptation, AdaptationScore


def adapt(
    *,
    file: NetworkFile,
    chip: TrainedFor,
    input_: File,
    reading: Reading,
    labels: Annotated[Path, typer.Option(metavar="FILE.npy", exists=True, dir_okay=False)]
    | None = None,
    limits: Switch = "on",
    epochs: Count = 60,
    batch: Count = 64,
    rate: float = 1e-3,
    patience: Count = 12,
    held_out: float = 0.2,
    seed: Natural = 0,
    resume: Annotated[bool, typer.Option("--resume")] = False,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.nir")] | None = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Train a network on through a chip's integers, where its accuracy fell on the chip.

    Towards labels, or without them towards the outputs of the float twin. Ctrl-C stops at a
    checkpoint; --resume goes on. Exit code 1: what was written does not fit on the chip.

    file: the network
    input_: samples (B, T, *shape) of spikes, 0 or 1, .npy
    labels: number of the right output of each sample, (B,) (default: towards the float twin's
        outputs)
    resume: go on with what was stopped; with the options that it was begun with

    Student:
        chip: chip in whose integers it is trained

    Training:
        limits: refuse what breaks a design rule of the chip; 'off' trains what does not fit
        epochs: most passes over the samples
        batch: samples of an update
        rate: learning rate of Adam at first
        patience: stop after so many validations without a better one
        held_out: share of the samples that validate, and are not trained on
        seed: seed of the samples held out, and of the order of the others

    Output:
        output: file to write; a checkpoint is beside it until the end (default: FILE.CHIP.nir)
    """
    from spikedeploy.emulation.design_report import report_of
    from spikedeploy.emulation.rasters import read_inputs
    from spikedeploy.outputs import check_output
    from spikedeploy.runtime.artifact.artifact import load
    from spikedeploy.runtime.files import locked
    from spikedeploy.trainers.progress import Interrupt

    named = re.sub(r"[^\w.-]+", "-", chip)
    written = output or file.with_name(f"{file.stem}.{named}.nir")
    check_output("-o", written, (file, input_, labels), force, _is_ours)
    checkpoint = written.with_name(f"{written.stem}.checkpoint.safetensors")
    _check_checkpoint(checkpoint, resume, force)
    settings: dict[str, Any] = {
        "epochs": epochs, "batch": batch, "rate": rate, "patience": patience,
        "held_out": held_out, "seed": seed,
    }  # fmt: skip
    interrupt = Interrupt()
    busy = f"{written} is being made by another process: wait for its end, or stop it"
    with interrupt, locked(checkpoint.with_suffix(".lock"), busy), _warnings_as_lines():
        from spikedeploy.api import adapt as train

        try:
            artifact = load(file, **reading.arguments())
            found = train(
                artifact, chip, read_inputs(input_, artifact), labels, limits=limits == "on",
                checkpoint=checkpoint, resume=resume, interrupt=interrupt, quiet=json, **settings,
            )  # fmt: skip
        except KeyboardInterrupt:
            _stop(interrupt.exit_code, "stopped", checkpoint)
        if not found.finished:
            after = f"stopped after {found.updates:,} updates"
            _stop(interrupt.exit_code, after, checkpoint)
        found.save(written)
        checkpoint.unlink(missing_ok=True)
    report = report_of(str(written), load(written), [chip], written, {})
    if json:
        print_json({**found.as_json(), "path": str(written), "check": report.as_json()})
    else:
        _print(found, labels is not None)
        from spikedeploy.reports.design import print_report

        print_report(report, everything=False)
        typer.echo(f"wrote {written}")
    raise typer.Exit(0 if report.passed else 1)


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print warnings as lines, such as that the chip lacks a neuron."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_, **__: say(str(message))
        yield


def _is_ours(path: Path) -> bool:
    from spikedeploy.trainers.adapt import is_adapted

    return is_adapted(path)


def _check_checkpoint(path: Path, resume: bool, force: bool) -> None:
    if resume and not path.is_file():
        raise ConfigError(f"{path} is missing: there is nothing to resume. Leave --resume out.")
    if path.exists() and not (resume or force):
        raise ConfigError(
            f"{path} is of an adaptation that was stopped: --resume goes on with it, --force "
            "begins anew."
        )


def _stop(code: int, what: str, checkpoint: Path) -> None:
    """Print what is kept, and exit."""
    kept = checkpoint.is_file()
    say(f"{what}; " + ("--resume goes on" if kept else "nothing was trained, nothing is written"))
    raise typer.Exit(code)


def _print(found: "Adaptation", has_labels: bool) -> None:
    """Print the three scores, and what they are of."""
    from spikedeploy.reports.table import Table

    several = found.before.agreement is not None

    def row(name: str, score: "AdaptationScore") -> tuple[str, ...]:
        shares = [score.accuracy] * has_labels + [score.agreement] * several
        return (name, *(f"{share:.1%}" for share in shares if share is not None),
                f"{score.error:.3f}")  # fmt: skip

    heads = ("", *["accuracy"] * has_labels, *["as float"] * several, "error")
    rows = [
        row("float", found.float_twin),
        row(f"float weights on {found.chip}", found.before),
        row(f"adapted to {found.chip}", found.after),
    ]
    of = f"{found.held_out:,} samples held out of {found.held_out + found.trained:,}"
    Table(heads, rows, of, numbers=True).print()
    print(
        "as float: the largest output is the float twin's; error: of outputs summed over time, by "
        "the standard deviation of the twin's\n" if several else
        "error: of outputs summed over time, by the standard deviation of the float twin's\n"
    )  # fmt: skip
