"""Options that several commands share, worded once."""

from typing import Annotated

import typer

Json = Annotated[
    bool, typer.Option("--json", help="Print JSON for machines, and nothing else, on stdout.")
]
Seed = Annotated[
    int, typer.Option(help="The first seed; episode k plays seed + k. Evaluation starts at 10000.")
]
EnvOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="OPTION=VALUE", help="Option of the environment: --set track=small_S."
    ),
]
Energy = Annotated[
    list[str] | None,
    typer.Option(
        "--energy",
        metavar="TABLE",
        help="Energy table to price by, as often as you like; `energy` lists them.",
        show_default="the chip's own",
    ),
]
Workers = Annotated[
    int | None, typer.Option(min=1, help="Processes that play episodes.", show_default="all cores")
]
