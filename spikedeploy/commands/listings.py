"""`policies`, `chips`, `energy`, `envs` and `recipes`: what there is to choose from."""

from typing import Annotated, Any

import typer

from spikedeploy.commands.options import Json


def _name(what: str) -> Any:  # noqa: ANN401 - an argument of typer
    return typer.Argument(metavar="[NAME]", help=f"One {what} in full.", show_default="all")


def policies(
    name: Annotated[str | None, _name("policy")] = None,
    json: Json = False,
) -> None:
    """List the shipped policies, by the names that the commands take."""
    if name is not None:
        _policy(name, json)
        return
    from spikedeploy import zoo
    from spikedeploy.console import print_json, print_table
    from spikedeploy.policies.registry import BUILT_IN, find

    rows: list[dict[str, Any]] = []
    apart = [f"{zoo.FOR_CHIPS}/{file.parent.name}/{file.stem}" for file in zoo.for_chips()]
    for name in [*zoo.names(), *BUILT_IN, *apart]:
        candidate, card = find(name), zoo.card(name)
        row = {"name": name, "kind": candidate.kind, "env": candidate.env, "file": candidate.path}
        rows.append({**row, "recipe": card.get("recipe"), "chip": candidate.chip})
        rows[-1]["return_mean"] = zoo.mean_return(card) if card.get("evaluation") else None
    if json:
        print_json(rows)
        return
    columns = ("name", "kind", "env", "recipe", "return_mean")
    cells = [[_text(row[column]) for column in columns] for row in rows if row["name"] not in apart]
    print_table("Policies", ("name", "kind", "environment", "recipe", "return"), cells)
    folders: dict[str, list[str]] = {}
    for folder, _, last in (name.rpartition("/") for name in apart):
        folders.setdefault(f"{folder}/", []).append(last)
    cells = [[folder, ", ".join(names)] for folder, names in folders.items()]
    heads = ("name begins with", "and ends with one of")
    print_table("For one chip each, and the teachers that they imitate", heads, cells)


def _policy(name: str, json: bool) -> None:
    """Print the card of a policy, and its evaluation."""
    from spikedeploy import zoo
    from spikedeploy.console import print_json, print_table
    from spikedeploy.policies.registry import find
    from spikedeploy.reports import entries
    from spikedeploy.reports.terminal import print_rows

    candidate, card = find(name), zoo.card(name)
    facts = card or {"file": candidate.path, "kind": candidate.kind, "env": candidate.env}
    if json:
        print_json({"name": name, **facts})
        return
    print_table("Policy", ("what", "found"), entries.policy_facts(name, facts))
    if card.get("evaluation"):
        print_rows("As it was evaluated", card["evaluation"])


def _text(value: object) -> str:
    return f"{value:,.0f}" if isinstance(value, float) else str(value or "–")


def chips(
    name: Annotated[str | None, _name("chip")] = None,
    json: Json = False,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the table of docs/chips.md.")
    ] = False,
) -> None:
    """List the chips: their arithmetic, and what it was compared with.

    Fields can be changed wherever a chip is named: --chip int:weight_bits=4,membrane=12.
    """
    from spikedeploy.console import print_json, print_table
    from spikedeploy.reports.listings import CHIP_COLUMNS, chip_list, chip_markdown, chip_rows
    from spikedeploy.runtime.chips.chip import CHIPS, chip

    if name is not None:
        _chip(name, json)
        return
    known = [chip(each) for each in CHIPS]
    if json:
        print_json(chip_list(known))
    elif markdown:
        typer.echo(chip_markdown(known), nl=False)
    else:
        lines = [(c.name, c.summary, ", ".join(c.energy_tables) or "none") for c in known]
        print_table("Chips", ("name", "what it is", "energy tables"), lines)
        print_table("What they compute with", CHIP_COLUMNS, chip_rows(known))


def _chip(name: str, json: bool) -> None:
    """Print everything about a chip, with the source of every number."""
    from spikedeploy.console import print_json, print_table
    from spikedeploy.reports import entries
    from spikedeploy.reports.listings import chip_list
    from spikedeploy.runtime.chips.chip import chip

    found = chip(name)
    if json:
        print_json(chip_list([found])[0])
        return
    print_table(found.name, ("what", "found"), entries.chip_facts(found))
    print_table("What it computes with", entries.CHIP_FIELDS, entries.chip_fields(found))
    if limits := entries.chip_limits(found):
        print_table("What fits", entries.CHIP_FIELDS, limits)


def energy(
    name: Annotated[str | None, _name("energy table")] = None,
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

    if name is not None:
        _energy(name, json)
    elif break_even:
        _break_even(json, markdown)
    elif json:
        print_json(listings.price_list())
    elif markdown:
        typer.echo("\n".join(listings.energy_markdown()))
    else:
        print_table("Energy tables", listings.ENERGY_COLUMNS, listings.energy_rows())
        print_table("Where the numbers come from", ("table", "source"), listings.energy_sources())
        typer.echo(listings.energy_choice())


def _energy(name: str, json: bool) -> None:
    """Print everything about an energy table."""
    from spikedeploy.console import print_json, print_table
    from spikedeploy.reports import entries, listings
    from spikedeploy.runtime.metrics.energy import energy_table

    table = energy_table(name)
    if json:
        print_json(next(each for each in listings.price_list()["tables"] if each["name"] == name))
        return
    chips = ", ".join(listings.chips_of(table)) or "none"
    print_table(name, ("what", "found"), entries.energy_facts(table, chips))
    print_table("Events", entries.EVENT_COLUMNS, entries.energy_events(table), numbers=True)


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
    from spikedeploy.trainers.recipes import RECIPES, budget

    rows = [(name, recipe.algorithm, recipe.summary) for name, recipe in RECIPES.items()]
    if json:
        print_json([dict(zip(("name", "algorithm", "summary"), row, strict=True)) for row in rows])
        return
    for algorithm in ALGORITHMS:
        cells = [
            (name, summary, budget(RECIPES[name])) for name, of, summary in rows if of == algorithm
        ]
        heads = ["name", "trains", "operations"][: 3 if any(cell[2] for cell in cells) else 2]
        shown = [cell[: len(heads)] for cell in cells]
        print_table(f"Recipes of the algorithm {algorithm}", heads, shown)
