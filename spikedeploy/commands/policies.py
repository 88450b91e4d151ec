"""`spikedeploy policies`: what is shipped, and what is built in."""

from spikedeploy.commands.options import Json

FIELDS = ("name", "kind", "env", "file")


def policies(json: Json = False) -> None:
    """List the shipped policies."""
    from spikedeploy import zoo
    from spikedeploy.policies import BUILT_IN, find
    from spikedeploy.terminal import print_json, print_table

    found = [find(name) for name in [*zoo.names(), *BUILT_IN]]
    names = [*zoo.names(), *BUILT_IN]
    rows = [
        (name, candidate.kind, candidate.env or "any", candidate.path)
        for name, candidate in zip(names, found, strict=True)
    ]
    if json:
        print_json([dict(zip(FIELDS, row, strict=True)) for row in rows])
    else:
        print_table("Policies, by the name that the commands take", FIELDS, rows)
