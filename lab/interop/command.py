"""`interop`: our networks in other tools."""

from pathlib import Path
from typing import Annotated

import typer

from spikedeploy.cli import run
from spikedeploy.commands.options import Force, Json


def interop(
    files: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[FILE]…",
            help=".nir files, names of shipped policies, or 'shipped': all of them.",
            show_default="shipped",
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Page to write, in Markdown.")
    ] = Path("interop.md"),
    records: Annotated[
        Path | None,
        typer.Option(
            help="What was found, in JSON; what stands there is not measured again.",
            show_default="beside the page",
        ),
    ] = None,
    folder: Annotated[
        Path, typer.Option(help="Environments of the tools, as ./spike test --peers makes them.")
    ] = Path(".venv-peers"),
    python: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TOOL=PATH", help="Python in which a tool is installed, may be repeated."
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Open networks in other tools, run them there, compare every spike; write a page."""
    from lab.interop.measured import measure
    from lab.interop.page import page
    from lab.interop.peers import check_given, pythons
    from lab.interop.written import check_written, network_files, page_command
    from spikedeploy.console import print_json, say
    from spikedeploy.files import write_text

    given = _pairs(python or [])
    records = records or output.with_suffix(".json")
    chosen = network_files(files or [])
    check_written(output, records, chosen, force)
    places = pythons(folder, given)
    check_given(given)
    rows = measure(chosen, places, records, say)
    write_text(output, page(rows, page_command(files or [], output, records)))
    if json:
        print_json(rows)
    else:
        typer.echo(f"wrote {output}")


def _pairs(texts: list[str]) -> dict[str, Path]:
    """TOOL=PATH of each text; a release of nir is TOOL too: nir==1.0.4=PATH."""
    found = {}
    for text in texts:
        name, sign, path = text.rpartition("=")
        if not sign or not name:
            raise typer.BadParameter(f"--python {text}: give TOOL=PATH")
        found[name] = Path(path)
    return found


def main() -> None:
    """Run the command of sys.argv."""
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command(context_settings={"help_option_names": ["-h", "--help"]})(interop)
    run(app)
