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
    import json

    from rich.console import Console

    from drivers.check import causes, check_devices, table
    from drivers.configuration import endpoints, read_devices
    from drivers.errors import ConfigurationError
    from drivers.lock import InstrumentLock

    _check_json(json_file)
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
        content = {"devices": [result.as_dict() for result in results], "ok": good}
        try:
            json_file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise ConfigurationError(f"{json_file}: cannot be written: {error.strerror}") from None
    if not good:
        raise typer.Exit(3)


def _check_json(path: Path | None) -> None:
    """Nothing but JSON is replaced; ConfigurationError where something else has that name."""
    import json

    from drivers.errors import ConfigurationError

    try:
        content = path.read_bytes() if path is not None and path.is_file() else b""
        if content.strip():
            json.loads(content)
    except ValueError:
        raise ConfigurationError(f"{path}: exists already and is no JSON file; choose another name") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: exists already and cannot be read: {error.strerror}") from None
