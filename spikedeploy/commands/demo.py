"""`demo`: shipped policies, replayed."""

from typing import Annotated

import typer

from spikedeploy.commands.options import Force, Json, Tables


def demo(
    tables: Tables = "one",
    show: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page, where there is a desktop.")
    ] = True,
    force: Force = False,
    json: Json = False,
) -> None:
    """Replay shipped policies on an emulated Loihi beside float ones: a page with their spikes."""
    from spikedeploy.console import print_json
    from spikedeploy.play.display import has_desktop
    from spikedeploy.shipping.demo_reports import FOLDER, write_demo

    documents = write_demo(quiet=json, everything=tables == "all", force=force)
    index = FOLDER / "index.html"
    if json:
        print_json({"folder": str(FOLDER), "reports": documents})
    elif documents:
        typer.echo(f"wrote {index}: open it in a browser")
        if show and has_desktop():
            typer.launch(str(index))
