"""``goniotwin cases make``: write a sealed set of cases."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def make(
    seed: Annotated[int, typer.Option(min=0, help="Of the whole set.")],
    cases: Annotated[int, typer.Option(min=4, help="Number of cases: sound, one effect, two, outside the library.")],
    out: Annotated[Path, typer.Option(help="Folder for the runs and what a diagnosis may see beside them.")],
    labels: Annotated[
        Path | None, typer.Option(help="Folder for the labels; OUT with '-labels' appended where not given.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes that share the work.")] = 1,
    rays: Annotated[int, typer.Option(min=256, help="Of a simulation, a power of two.")] = 16384,
) -> None:
    """Write a sealed set of cases: runs of the simulated laboratory with something wrong. Goes on where it stopped."""
    from rich.console import Console
    from rich.progress import Progress

    from instrument.errors import InputError
    from sim_fixtures.cases.composition import Composition
    from sim_fixtures.cases.sealed import write_sealed_set

    if rays & (rays - 1):
        raise InputError(f"--rays: found {rays}; expected a power of two")
    console = Console()
    apart = labels or out.with_name(out.name + "-labels")
    with Progress(console=console) as bar:
        task = bar.add_task("cases", total=cases)
        made = write_sealed_set(
            out,
            apart,
            seed,
            Composition.of_size(cases),
            rays=rays,
            workers=workers,
            progress=lambda _: bar.advance(task),
        )
        bar.update(task, completed=cases)
    console.print(f"runs: {made.folder}", soft_wrap=True, highlight=False)
    console.print(f"labels: {made.labels}", soft_wrap=True, highlight=False)
    console.print(f"SHA-256 of the labels: {made.digest}", soft_wrap=True, highlight=False)
