"""Commands of the simulated laboratory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from instrument.options import Force


def simulate(
    speed: Annotated[float, typer.Option(min=0.01, help="Laboratory seconds a wall-clock second.")] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Of every random draw.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for devices.toml and the example files; a temporary one where not given."),
    ] = None,
    force: Force = False,
) -> None:
    """Serve the simulated laboratory for other programs, until Ctrl-C."""
    import tempfile
    import threading

    from rich.console import Console
    from rich.table import Table

    from instrument.output import check_new_folder
    from sim_fixtures.laboratory import start_simulated

    if out is not None:
        check_new_folder(out, force)
    console = Console()
    with tempfile.TemporaryDirectory(prefix="goniotwin-") as temporary:
        folder = out or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        with start_simulated(folder, speed=speed, seed=seed) as laboratory:
            table = Table("line", "where", title="Simulated laboratory")
            for name, port in laboratory.endpoints["ports"].items():
                table.add_row(name, port)
            table.add_row("meter", f"127.0.0.1:{laboratory.endpoints['meter']} (SCPI)")
            table.add_row("control", f"127.0.0.1:{laboratory.endpoints['control']} (JSON lines)")
            console.print(table)
            console.print(f"connections: {laboratory.inputs.devices}", soft_wrap=True, highlight=False)
            alternative = laboratory.inputs.devices.with_name("devices-esp301.toml")
            console.print(f"all arms on an ESP301: {alternative}", soft_wrap=True, highlight=False)
            console.print("Ctrl-C ends it.")
            try:
                threading.Event().wait()
            except KeyboardInterrupt:
                console.print("ended")
