"""`spikedeploy demo`: the whole line on shipped policies, without arguments."""

from spikedeploy.commands.options import Json


def demo(json: Json = False) -> None:
    """Watch the shipped policies walk: float ANN, float SNN, and the SNN on an emulated Loihi."""
    from spikedeploy.demo import FOLDER
    from spikedeploy.demo import demo as show
    from spikedeploy.reports.terminal import print_json

    documents = show(quiet=json)
    if json:
        print_json({"folder": str(FOLDER), "reports": documents})
