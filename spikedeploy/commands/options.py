"""Options that several commands share, worded once."""

from enum import Enum
from typing import Annotated

import typer


class Limits(str, Enum):
    """Whether a chip refuses what breaks its design rules."""

    on = "on"
    off = "off"


LimitsOption = Annotated[
    Limits,
    typer.Option(
        "--limits",
        help="Refuse what breaks a design rule of the chip; 'off' emulates its arithmetic alone.",
    ),
]
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
Workers = Annotated[
    int | None, typer.Option(min=1, help="Processes that play episodes.", show_default="all cores")
]
