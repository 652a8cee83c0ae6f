"""``goniotwin plan``: what a plan means, before anything moves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def plan(
    plan: Annotated[Path, typer.Argument(help="The plan (TOML, or a CSV table of points).", show_default=False)],
    facility: Annotated[
        Path | None, typer.Option(help="facility.toml; without it arms of full travel and a shadow cone of 5 degrees.")
    ] = None,
    devices: Annotated[
        Path | None, typer.Option(help="devices.toml: how fast the axes move, and how long the meter averages.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the same for programs.")] = None,
    dwell: Annotated[float, typer.Option(min=0.0, help="Seconds a point takes once the arms stand.")] = 20.0,
    velocity: Annotated[
        float | None, typer.Option(min=0.01, help="Top speed of the arms, degree/s, without --devices [20].")
    ] = None,
    acceleration: Annotated[
        float | None, typer.Option(min=0.01, help="Acceleration of the arms, degree/s^2, without --devices [10].")
    ] = None,
    hands: Annotated[float, typer.Option(min=0.0, help="Seconds that a change on the stage takes.")] = 0.0,
    points: Annotated[bool, typer.Option("--points", help="Print every point, and the way to it, as well.")] = False,
) -> None:
    """List what a plan measures, which points are blocked and why, the ways, and how long it takes. Nothing moves."""
    from rich.console import Console

    from instrument.errors import InputError
    from instrument.output import check_json, write_json
    from instrument.plan_summary import Speeds, print_summary, summarise
    from instrument.settings import ScanSettings

    if devices is not None and (velocity is not None or acceleration is not None):
        raise InputError("--velocity and --acceleration stand in --devices; leave them out")
    check_json(json_file)
    speeds = Speeds(velocity or 20.0, acceleration or 10.0)
    settings = ScanSettings(dwell=dwell, hands=hands)
    read, summary = summarise(plan, facility, devices, speeds, settings)
    print_summary(read, summary, every_point=points, console=Console(highlight=False))
    if json_file is not None:
        write_json(json_file, summary)
