"""`spikedeploy doctor`: what works on this machine."""

import typer

from spikedeploy.commands.options import Json


def doctor(json: Json = False) -> None:
    """Check versions, threads, rendering and the shipped policies; exit 1 if one fails."""
    from spikedeploy.doctor import examine
    from spikedeploy.reports.terminal import print_json, print_table

    findings = examine()
    if json:
        print_json([vars(finding) for finding in findings])
    else:
        marks = {True: "[green]✓[/]", False: "[red]✗[/]", None: " "}
        rows = [(marks[f.ok], f.name, f.detail) for f in findings]
        print_table("Doctor", ("", "what", "found"), rows)
    raise typer.Exit(1 if any(finding.ok is False for finding in findings) else 0)
