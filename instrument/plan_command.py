"""``goniotwin plan``: what a plan means, before anything moves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def plan(
    plan: Annotated[Path, typer.Argument(help="The plan (TOML).", show_default=False)],
    facility: Annotated[
        Path | None, typer.Option(help="facility.toml; without it arms of full travel and a shadow cone of 5 degrees.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the same for programs.")] = None,
    dwell: Annotated[float, typer.Option(min=0.0, help="Seconds a point takes once the arms stand.")] = 20.0,
    velocity: Annotated[float, typer.Option(min=0.01, help="Top speed of the arms, degree/s.")] = 20.0,
    acceleration: Annotated[float, typer.Option(min=0.01, help="Acceleration of the arms, degree/s^2.")] = 10.0,
    points: Annotated[bool, typer.Option("--points", help="Print every point as well.")] = False,
) -> None:
    """List what a plan measures, which points are blocked and why, and how long it takes. Nothing moves."""
    from rich.console import Console

    from instrument.output import write_json
    from instrument.plan_summary import print_summary, summarise

    read, summary = summarise(plan, facility, dwell, velocity, acceleration)
    print_summary(read, summary, every_point=points, console=Console(highlight=False))
    if json_file is not None:
        write_json(json_file, summary)
