"""The command ``goniotwin gui``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def gui(
    plan: Annotated[Path | None, typer.Argument(help="Plan to have ready; else the laboratory's own.")] = None,
    simulate: Annotated[bool, typer.Option("--simulate", help="Use the simulated laboratory.")] = False,
    speed: Annotated[float, typer.Option(help="Laboratory seconds a second, with --simulate.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Seed of the simulated laboratory.")] = 1,
    devices: Annotated[Path | None, typer.Option(help="devices.toml of the laboratory.")] = None,
    facility: Annotated[Path | None, typer.Option(help="facility.toml")] = None,
    artifact: Annotated[Path | None, typer.Option(help="artifact.toml, for the twin.")] = None,
    material: Annotated[Path | None, typer.Option(help="Run or table of the coating, for the twin.")] = None,
    out: Annotated[Path | None, typer.Option(help="Run folder.")] = None,
    twin: Annotated[bool, typer.Option("--twin/--no-twin", help="Predict every reading live.")] = True,
    screenshots: Annotated[
        Path | None,
        typer.Option(help="No window: save pictures of every page here, 100 % and 200 %, light and dark."),
    ] = None,
    shown: Annotated[Path | None, typer.Option(help="Run folder that the pictures show; else a small scan.")] = None,
    diagnosed: Annotated[
        Path | None, typer.Option(help="Run folder whose diagnosis the pictures show; else that of the run shown.")
    ] = None,
) -> None:
    """Open the operator's window."""
    from gui.application import load_qt

    load_qt()
    if screenshots is not None:
        from gui.pictures import take_all

        raise typer.Exit(take_all(screenshots, shown, diagnosed))
    from gui.run import Options, run

    options = Options(plan, simulate, speed, seed, devices, facility, artifact, material, out, twin)
    raise typer.Exit(run(options))
