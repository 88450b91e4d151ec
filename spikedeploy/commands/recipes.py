"""`spikedeploy recipes`: what can be trained."""

from spikedeploy.commands.options import Json


def recipes(json: Json = False) -> None:
    """List the training recipes."""
    from spikedeploy.console import print_json, print_table
    from spikedeploy.trainers.recipes import RECIPES

    rows = [(name, recipe.algorithm, recipe.summary) for name, recipe in RECIPES.items()]
    if json:
        print_json([dict(zip(("name", "algorithm", "summary"), row, strict=True)) for row in rows])
    else:
        print_table("Recipes, for `spikedeploy train`", ("name", "algorithm", "trains"), rows)
