"""``goniotwin exchange push | pull``: run folders to and from a shared or an object store."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from instrument.options import Force


def push(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.", show_default=False)],
    url: Annotated[str, typer.Argument(metavar="URL", help="Like s3://bucket/runs/name.", show_default=False)],
    force: Force = False,
) -> None:
    """Put a run folder on a shared or an object store (any that fsspec knows)."""
    from instrument.exchange import stores

    typer.echo(f"written: {url}, {stores.push(run, url, force=force)} files")


def pull(
    url: Annotated[str, typer.Argument(metavar="URL", help="Like s3://bucket/runs/name.", show_default=False)],
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A new or empty folder.", show_default=False)],
) -> None:
    """Bring a whole run folder of a store onto this machine, and check that it is what was measured."""
    from instrument.errors import EXIT_INCOMPLETE
    from instrument.exchange import stores
    from instrument.run_archive import verify

    typer.echo(f"written: {folder}, {stores.pull(url, folder)} files")
    bad = [check for check in verify(folder).checks if not check.passed]
    for check in bad:
        typer.echo(f"{check.name}: {check.found}", err=True)
    if bad:
        raise typer.Exit(EXIT_INCOMPLETE)
