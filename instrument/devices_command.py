"""``goniotwin devices check``: try every connection of a ``devices.toml``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def check(
    devices: Annotated[Path, typer.Option(help="devices.toml of the room.")],
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the same for programs.")] = None,
) -> None:
    """Ask every device who it is and how it is; nothing moves."""
    from rich.console import Console

    from drivers.check import causes, check_devices, table
    from drivers.configuration import endpoints, read_devices
    from drivers.lock import InstrumentLock
    from instrument.errors import EXIT_DEVICE
    from instrument.output import check_json, write_json

    check_json(json_file)
    form = read_devices(devices)
    # Asking a device who it is may set it up anew: never under a scan that is using it.
    with InstrumentLock(endpoints(form)):
        results = check_devices(form)
    console = Console()
    console.print(table(results))
    for cause in causes(results):
        console.print(cause, soft_wrap=True)
    good = all(result.ok for result in results)
    if json_file is not None:
        write_json(json_file, {"devices": [result.as_dict() for result in results], "ok": good})
    if not good:
        raise typer.Exit(EXIT_DEVICE)
