"""`export` and `publish`: from a run folder to a file, a card, or a shipped policy."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import typer

from spikedeploy.commands.options import AfterSpike, Granularity, States
from spikedeploy.console import print_json, print_result, say
from spikedeploy.runtime.errors import ConfigError
from spikedeploy.runtime.files import suffix


@dataclass(frozen=True)
class FormatOptions:
    """Options that some formats have, with the defaults of the format where none is given."""

    observations: int | None = None
    chip: str | None = None
    env: str | None = None
    clock: Literal["gated", "pipelined", "free"] | None = None
    quantise: Granularity | None = None
    prefix: str | None = None
    board: str | None = None
    raster: Path | None = None
    state: States | None = None
    checkpoint: str | None = None
    film: bool = False
    for_: str | None = None
    nir_compat: str | None = None
    from_: str | None = None
    dt: float | None = None
    reset: AfterSpike | None = None

    def arguments(self) -> dict[str, Any]:
        """The options that were given, as `shipping.export` takes them."""
        names = {"for_": "tool", "from_": "written_by"}
        given = {name: value for name, value in vars(self).items() if value not in (None, False)}
        return {names.get(name, name): value for name, value in given.items()}


def export(
    *,
    run: str,
    to: str | None = None,
    output: Path | None = None,
    options: FormatOptions,
    force: bool = False,
    json: bool = False,
) -> None:
    """Write a trained policy as .nir or .onnx, and check the file against it; or as C99 or Verilog.

    --to card makes the run folder ready for upload: the policy, card.md, curve.svg, report.html.
    """
    from spikedeploy import zoo
    from spikedeploy.reports.terminal import print_checks
    from spikedeploy.shipping.export import export as export_policy

    if suffix(run) in zoo.SUFFIXES and zoo.resolve(run) is None:
        raise ConfigError(f"{run}: no such file")  # as a run folder it would be missed elsewhere
    written = export_policy(run, to, output, force=force, **options.arguments())
    if json:
        print_json(written.record())
    else:
        print_checks(written.checks)
        for line in written.lines:
            typer.echo(line)
        for line in written.remarks:
            say(line)
    raise typer.Exit(0 if written.passed else 1)


def publish(
    *,
    run: str,
    name: str,
    episodes: int = 100,
    note: str = "",
    control: bool = False,
    checkpoint: str | None = None,
    workers: int | None = None,
    output: Path | None = None,
    force: bool = False,
    json: bool = False,
) -> None:
    """Export a run into the zoo: the file, its card, its learning curve and its evaluation."""
    from spikedeploy import zoo
    from spikedeploy.shipping.publish_run import publish_run

    folder = output or zoo.FOLDER
    files = publish_run(run, name, episodes, folder, workers, note, control, checkpoint, force)
    names = [str(file) for file in files]
    print_result(json, {"files": names}, f"wrote {', '.join(names)}")
