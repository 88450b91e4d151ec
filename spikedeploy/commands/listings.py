"""`policies`, `chips`, `energy`, `envs` and `recipes`: what there is to choose from."""

from typing import Annotated

import typer

from spikedeploy.commands.options import Json


def policies(json: Json = False) -> None:
    """List the shipped policies, by the names that the commands take."""
    from spikedeploy import zoo
    from spikedeploy.console import print_json, print_table
    from spikedeploy.policies.registry import BUILT_IN, find

    rows = []
    for name in [*zoo.names(), *BUILT_IN]:
        candidate, card = find(name), zoo.card(name)
        row = {"name": name, "kind": candidate.kind, "env": candidate.env, "file": candidate.path}
        rows.append({**row, "recipe": card.get("recipe"), "return_mean": zoo.mean_return(card)})
    if json:
        print_json(rows)
        return
    columns = ("name", "kind", "env", "recipe", "return_mean")
    cells = [[_text(row[column]) for column in columns] for row in rows]
    print_table("Policies", ("name", "kind", "environment", "recipe", "return"), cells)


def _text(value: object) -> str:
    return f"{value:,.0f}" if isinstance(value, float) else str(value or "–")


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
    from spikedeploy.reports.listings import CHIP_COLUMNS, chip_markdown, chip_rows
    from spikedeploy.runtime.chips.chip import CHIPS, chip

    known = [chip(name) for name in CHIPS]
    if json:
        print_json(
            [
                {
                    **dict(zip((c.replace(" ", "_") for c in CHIP_COLUMNS), row, strict=True)),
                    "resets": each.resets,
                    "membrane_output": each.membrane_output,
                    "summary": each.summary,
                    "energy_tables": each.energy_tables,
                    "sources": each.sources,
                }
                for each, row in zip(known, chip_rows(known), strict=True)
            ]
        )
    elif markdown:
        typer.echo(chip_markdown(known), nl=False)
    else:
        lines = [(c.name, c.summary, ", ".join(c.energy_tables) or "none") for c in known]
        print_table("Chips", ("name", "what it is", "energy tables"), lines)
        print_table("What they compute with", CHIP_COLUMNS, chip_rows(known))


def energy(
    json: Json = False,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the table of docs/energy.md.")
    ] = False,
    break_even: Annotated[
        bool, typer.Option("--break-even", help="Spike rates below which spiking costs less.")
    ] = False,
) -> None:
    """List the energy tables: prices of events, sources, uncertainty."""
    from spikedeploy.console import print_json, print_table
    from spikedeploy.reports import listings

    if break_even:
        _break_even(json, markdown)
    elif json:
        print_json(listings.price_list())
    elif markdown:
        typer.echo("\n".join(listings.energy_markdown()))
    else:
        print_table("Energy tables", listings.ENERGY_COLUMNS, listings.energy_rows())
        print_table("Where the numbers come from", ("table", "source"), listings.energy_sources())


def _break_even(json: bool, markdown: bool) -> None:
    """Print the break-even lines."""
    from spikedeploy.console import print_json, print_table
    from spikedeploy.reports import listings
    from spikedeploy.runtime.metrics.break_even import YAN2024

    if json:
        print_json({"rates": listings.break_even_list(), "yan2024": YAN2024})
    elif markdown:
        typer.echo("\n".join(listings.break_even_markdown()))
    else:
        cells = listings.break_even_rows()
        print_table("Break-even spike rates", listings.BREAK_EVEN_COLUMNS, cells)
        typer.echo(listings.BREAK_EVEN_NOTE)


def envs(json: Json = False) -> None:
    """List the environments."""
    from spikedeploy.console import print_json, print_table
    from spikedeploy.envs import ENVS

    rows = [(spec.short, spec.id, spec.summary) for spec in ENVS.values()]
    if json:
        print_json([dict(zip(("name", "id", "summary"), row, strict=True)) for row in rows])
    else:
        print_table("Environments", ("name", "id", "task"), rows)


def recipes(json: Json = False) -> None:
    """List the training recipes, by algorithm."""
    from spikedeploy.console import print_json, print_table
    from spikedeploy.trainers import ALGORITHMS
    from spikedeploy.trainers.recipes import RECIPES

    rows = [(name, recipe.algorithm, recipe.summary) for name, recipe in RECIPES.items()]
    if json:
        print_json([dict(zip(("name", "algorithm", "summary"), row, strict=True)) for row in rows])
        return
    for algorithm in ALGORITHMS:
        cells = [(name, summary) for name, of, summary in rows if of == algorithm]
        print_table(f"Recipes of the algorithm {algorithm}", ("name", "trains"), cells)
