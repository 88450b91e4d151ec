"""`spikedeploy energy`: the energy tables."""

from typing import Annotated

import typer

from spikedeploy.commands.options import Json


def energy(
    json: Json = False,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the table of docs/energy.md.")
    ] = False,
) -> None:
    """List the energy tables: prices of events, sources, uncertainty."""
    from spikedeploy.console import print_json, print_table
    from spikedeploy.reports import price_list

    if json:
        print_json(price_list.price_list())
    elif markdown:
        typer.echo("\n".join(price_list.markdown()))
    else:
        print_table("Energy tables", price_list.HEADS, price_list.rows())
        print_table("Where the numbers come from", ("table", "source"), price_list.sources())
