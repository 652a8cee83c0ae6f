"""``goniotwin cases make``: write a sealed set of cases."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from sim_fixtures.cases.composition import Composition


def make(
    seed: Annotated[int, typer.Option(min=0, help="Of the whole set.")],
    cases: Annotated[int, typer.Option(min=4, help="Number of cases: sound, one effect, two, outside the library.")],
    out: Annotated[Path, typer.Option(help="Folder for the runs and what a diagnosis may see beside them.")],
    labels: Annotated[
        Path | None, typer.Option(help="Folder for the labels; OUT with '-labels' appended where not given.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes that share the work.")] = 1,
    counts: Annotated[
        str | None,
        typer.Option(
            help="In place of the usual shares: sound, one effect, two, outside the library, such as 40,100,0,0.",
            show_default=False,
        ),
    ] = None,
    severity: Annotated[
        list[float] | None,
        typer.Option(help="Of cases with one effect; may be repeated.", show_default="0.5, 1, 2 and 4"),
    ] = None,
    rays: Annotated[int, typer.Option(min=256, help="Of a simulation, a power of two.")] = 16384,
) -> None:
    """Write a sealed set of cases: runs of the simulated laboratory with something wrong. Goes on where it stopped."""
    from rich.console import Console
    from rich.progress import Progress

    from instrument.errors import InputError
    from sim_fixtures.cases.sealed import write_sealed_set

    if rays & (rays - 1):
        raise InputError(f"--rays: found {rays}; expected a power of two")
    console = Console()
    composition = composition_of(cases, counts, severity)
    apart = labels or out.with_name(out.name + "-labels")
    with Progress(console=console) as bar:
        task = bar.add_task("cases", total=cases)
        made = write_sealed_set(
            out,
            apart,
            seed,
            composition,
            rays=rays,
            workers=workers,
            progress=lambda _: bar.advance(task),
        )
        bar.update(task, completed=cases)
    console.print(f"runs: {made.folder}", soft_wrap=True, highlight=False)
    console.print(f"labels: {made.labels}", soft_wrap=True, highlight=False)
    console.print(f"SHA-256 of the labels: {made.digest}", soft_wrap=True, highlight=False)


def composition_of(cases: int, counts: str | None, severity: list[float] | None) -> Composition:
    """What a set of so many cases is made of: of all kinds in the usual shares, or as many as asked for."""
    from dataclasses import replace

    from instrument.errors import InputError
    from sim_fixtures.cases.composition import Composition

    found = Composition.of_size(cases)
    if counts is not None:
        numbers = [part.strip() for part in counts.split(",")]
        if len(numbers) != 4 or not all(number.isdigit() for number in numbers):
            raise InputError(f"--counts: found {counts!r}; expected four whole numbers, such as 40,100,0,0")
        none, single, double, outside = (int(number) for number in numbers)
        found = Composition(none, single, double, outside)
        if found.size != cases:
            raise InputError(f"--counts: found {counts} ({found.size} cases) with --cases {cases}; expected as many")
    if severity:
        if min(severity) <= 0:
            raise InputError(f"--severity: found {min(severity):g}; expected more than 0")
        found = replace(found, severities=tuple(severity))
    return found
