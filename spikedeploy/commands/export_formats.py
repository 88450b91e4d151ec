"""Of `export`: C99 of a chip, cards, and NIR as other tools and releases of `nir` open it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer


def export_c(
    policy: str,
    chip: str,
    folder: Path | None,
    observations: int,
    prefix: str,
    force: bool,
    json: bool,
) -> None:
    """Write a policy as C of a chip, and say what that takes."""
    from spikedeploy.console import print_json
    from spikedeploy.shipping import export_c as shipping

    written = shipping.export_c(policy, chip, folder, observations, prefix, force)
    if json:
        print_json(written.record())
        return
    for line in written.lines():
        typer.echo(line)


def export_for(
    policy: str,
    to: str | None,
    output: Path | None,
    tool: str | None,
    older: str | None,
    timesteps: int,
    options: Mapping[str, Any],
    force: bool,
    json: bool,
) -> None:
    """Write the file, and say whether it is the same network."""
    from spikedeploy.console import print_json, say
    from spikedeploy.reports.terminal import print_checks
    from spikedeploy.shipping.export_nir import export_nir

    if to not in (None, "nir"):
        raise typer.BadParameter(f"--for and --nir-compat write nir, not {to}")
    written = export_nir(policy, output, tool, older, timesteps, options, force)
    if json:
        checks = [vars(check) for check in written.checks]
        path, remarks = str(written.path), list(written.remarks)
        print_json({"path": path, "passed": written.passed, "checks": checks, "remarks": remarks})
    else:
        print_checks(written.checks)
        for remark in written.remarks:
            say(remark)
        typer.echo(f"wrote {written.path}")
    raise typer.Exit(0 if written.passed else 1)


def export_card(
    run: str, output: Path | None, checkpoint: str | None, film: bool, force: bool, json: bool
) -> None:
    """Write what shows a run beside its policy into its folder, and say what."""
    from spikedeploy.console import print_json
    from spikedeploy.shipping import run_card

    if output is not None or checkpoint is not None:
        raise typer.BadParameter("--to card is of the run folder: leave -o and --checkpoint out")
    files = run_card.export_card(run, film, force)
    if json:
        print_json({"files": [str(file) for file in files]})
    else:
        typer.echo("wrote " + ", ".join(str(file) for file in files))
