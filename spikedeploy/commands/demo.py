"""`spikedeploy demo`: shipped policies compared and filmed, without arguments."""

from spikedeploy.commands.options import Json


def demo(json: Json = False) -> None:
    """Watch the shipped policies walk: float ANN, float SNN, and the SNN on an emulated Loihi."""
    from spikedeploy.console import print_json
    from spikedeploy.shipping.demo_reports import FOLDER, write_demo

    documents = write_demo(quiet=json)
    if json:
        print_json({"folder": str(FOLDER), "reports": documents})
