"""Options that several commands have."""

from __future__ import annotations

from typing import Annotated

import typer

Force = Annotated[bool, typer.Option("--force", help="Replace what is there already.")]
Workers = Annotated[int, typer.Option(min=1, help="Several runs: processes on this machine.")]
Dask = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Several runs: on the Dask cluster whose scheduler is there (tcp://host:8786).",
        show_default=False,
    ),
]
