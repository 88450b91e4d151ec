"""`spikedeploy chips`: the chips that are emulated."""

from spikedeploy.commands.options import Json


def chips(json: Json = False) -> None:
    """List the chips."""
    from runtime.chip import CHIPS, chip
    from spikedeploy.terminal import print_json, print_table

    known = [chip(name) for name in CHIPS]
    if json:
        print_json([{"name": c.name, "summary": c.summary, "sources": c.sources} for c in known])
    else:
        rows = [(c.name, c.summary, ", ".join(c.energy_tables) or "none") for c in known]
        print_table("Chips", ("name", "what it is", "energy tables"), rows)
