"""`serve`: a policy that other programs ask for actions."""

from typing import Annotated

import typer

from spikedeploy.commands.options import Backend, Json, LimitsOption, PolicyChip


def serve(
    policy: Annotated[
        str, typer.Argument(metavar="FILE", help="A .nir file, run folder, shipped name.")
    ],
    chip: PolicyChip = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port; 0 for one that is free.")
    ] = 5555,
    address: Annotated[
        str,
        typer.Option(
            help="IPv4 address to listen on. Nothing is authenticated: any other than 127.0.0.1 "
            "lets whoever reaches it drive the policy."
        ),
    ] = "127.0.0.1",
    clients: Annotated[int, typer.Option(min=1, max=1024, help="Most clients at a time.")] = 32,
    idle: Annotated[
        str, typer.Option(metavar="TIME", help="A client that is silent so long is forgotten.")
    ] = "60s",
    limits: LimitsOption = "on",
    backend: Backend = "numpy",
    json: Json = False,
) -> None:
    """Answer observations with actions over ZeroMQ, on this machine."""
    import threading

    from spikedeploy.console import print_json, say
    from spikedeploy.realtime.paced_loop import duration
    from spikedeploy.realtime.server import PolicyServer, ServedPolicy
    from spikedeploy.shipping.exported_run import runnable

    forgotten = duration("--idle", idle)
    served = ServedPolicy(runnable(policy), chip, backend, limits == "on")
    server = PolicyServer(served, address, port, clients, forgotten)
    if address != "127.0.0.1":
        say(f"warning: {address} is open to other machines, and nothing is authenticated")
    if json:
        print_json({"endpoint": server.endpoint, **served.info()})
    else:
        typer.echo(f"serving {served.name} on {served.chip} at {server.endpoint}")
    try:
        server.serve(threading.Event())
    finally:
        server.close()
