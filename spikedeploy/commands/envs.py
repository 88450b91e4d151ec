"""`spikedeploy envs`: the environments that exist."""

from spikedeploy.commands.options import Json


def envs(json: Json = False) -> None:
    """List the environments."""
    from spikedeploy.console import print_json, print_table
    from spikedeploy.envs import ENVS

    rows = [(spec.short, spec.id, spec.summary) for spec in ENVS.values()]
    if json:
        print_json([dict(zip(("name", "id", "summary"), row, strict=True)) for row in rows])
    else:
        print_table("Environments", ("name", "id", "task"), rows)
