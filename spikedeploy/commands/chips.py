"""`spikedeploy chips`: the chips that are emulated."""

from typing import Annotated

import typer

from spikedeploy.commands.options import Json


def chips(
    json: Json = False,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the table of docs/chips.md.")
    ] = False,
) -> None:
    """List the chips: their arithmetic, and what it was compared with.

    Fields can be changed wherever a chip is named: --chip int:weight_bits=4,membrane=12.
    """
    from spikedeploy.console import print_json, print_table
    from spikedeploy.reports.datasheets import COLUMNS, rows
    from spikedeploy.reports.datasheets import markdown as as_markdown
    from spikedeploy.runtime.chips.chip import CHIPS, chip

    known = [chip(name) for name in CHIPS]
    if json:
        print_json(
            [
                {
                    **dict(zip((c.replace(" ", "_") for c in COLUMNS), row, strict=True)),
                    "resets": each.resets,
                    "summary": each.summary,
                    "energy_tables": each.energy_tables,
                    "sources": each.sources,
                }
                for each, row in zip(known, rows(known), strict=True)
            ]
        )
    elif markdown:
        typer.echo(as_markdown(known), nl=False)
    else:
        lines = [(c.name, c.summary, ", ".join(c.energy_tables) or "none") for c in known]
        print_table("Chips", ("name", "what it is", "energy tables"), lines)
        print_table("What they compute with", COLUMNS, rows(known))
