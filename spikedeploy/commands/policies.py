"""`spikedeploy policies`: what is shipped, and what is built in."""

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
