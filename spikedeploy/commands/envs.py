"""`spikedeploy envs`: the environments that exist."""

from spikedeploy.commands.options import Json


def envs(json: Json = False) -> None:
    """List the environments."""
    from spikedeploy.envs import ENVS
    from spikedeploy.reports.terminal import print_json, print_table

    rows = [(spec.short, spec.id, spec.summary) for spec in ENVS.values()]
    if json:
        print_json([dict(zip(("name", "id", "summary"), row, strict=True)) for row in rows])
    else:
        print_table("Environments", ("name", "id", "task"), rows)
