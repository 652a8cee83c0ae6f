"""``goniotwin runs compare``: two measured runs, point by point; or many against one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from instrument.options import Dask, Workers

if TYPE_CHECKING:
    from rich.table import Table

    from twin.run_pair import PairComparison
    from twin.run_pairs import AgainstFirst


def compare_pair(
    first: Annotated[
        str, typer.Argument(metavar="A", help="A run folder or run file; or its URL.", show_default=False)
    ],
    others: Annotated[list[str], typer.Argument(metavar="B...", help="Another one, or several.", show_default=False)],
    shared: Annotated[
        list[str] | None,
        typer.Option(help="A component (reference, sensor_zenith, ...) whose error both have.", show_default=False),
    ] = None,
    independent: Annotated[
        list[str] | None, typer.Option(help="A component whose error each has for itself.", show_default=False)
    ] = None,
    workers: Workers = 1,
    dask: Dask = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write it for programs, every point.")] = None,
) -> None:
    """Compare runs of one sample: ratio of B to A at every common geometry, its uncertainty, agreement.

    Of several B, each is compared with A and has a row; exit status 1 where one cannot be.
    """
    from rich.console import Console

    from instrument.errors import EXIT_INCOMPLETE
    from instrument.output import check_json, write_json
    from twin.run_pairs import compare_all, compare_named

    check_json(json_file)
    console = Console(highlight=False)
    known = {"shared": shared or (), "independent": independent or ()}
    content: Any
    complete = True
    if len(others) == 1 and dask is None:
        found = compare_named(first, others[0], **known)
        console.print(planes_table(found))
        for line in in_words(found):
            console.print(line, markup=False)
        content = found.as_dict()
    else:
        all_found = compare_all(first, others, **known, workers=workers, address=dask)
        console.print(runs_table(first, all_found))
        content = [one.as_dict() for one in all_found]
        complete = not any(one.problem for one in all_found)
    if json_file is not None:
        write_json(json_file, content)
        typer.echo(f"written: {json_file}")
    if not complete:
        raise typer.Exit(EXIT_INCOMPLETE)


def runs_table(first: str, found: Sequence[AgainstFirst]) -> Table:
    """One row a run that was compared with the first."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(
        "B", "geometries", "B/A", "u (k = 1)", "rms t", "n'", title=f"A: {escape(first)}", title_justify="left"
    )
    for one in found:
        if one.found is None:
            table.add_row(escape(one.run), "", f"[red]{escape(one.problem)}[/red]")
            continue
        pair = one.found
        numbers = f"{pair.mean_ratio:.4f}", f"{pair.u_mean_ratio:.4f}", f"{pair.rms_t:.2f}"
        table.add_row(escape(one.run), str(pair.points.sizes["point"]), *numbers, f"{pair.level_of_agreement:.2f}")
    return table


def planes_table(found: PairComparison) -> Table:
    """One row an azimuth plane."""
    import numpy as np
    from rich.table import Table

    from twin.metrics import root_mean_square

    points = found.points
    names = ("wavelength", "illumination_zenith", "sensor_azimuth")
    keys = np.stack([np.round(points[name].values, 6) for name in names], axis=-1)
    planes, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    table = Table("wavelength / nm", "illumination zenith", "sensor azimuth", "points", "B/A", "rms t", "n'")
    for number in np.argsort(first):
        rows = points.isel(point=np.ravel(which) == number)
        angles = [f"{value:g}" for value in planes[number]]
        ratio, t = f"{float(rows['ratio'].mean()):.4f}", f"{root_mean_square(rows['t'].values):.2f}"
        table.add_row(*angles, str(rows.sizes["point"]), ratio, t, f"{float(rows['level_of_agreement'].mean()):.2f}")
    return table


def in_words(found: PairComparison) -> list[str]:
    """What the table does not say."""
    lines = [
        f"{found.points.sizes['point']} geometries in both, {found.only_a} only in A, {found.only_b} only in B",
        f"B/A = {found.mean_ratio:.4f}, standard uncertainty {found.u_mean_ratio:.4f} (k = 1)",
        f"rms t {found.rms_t:.2f}, level of agreement {found.level_of_agreement:.2f}",
        f"the same error in both: {_listed(found.shared)}",
        f"each its own: {_listed(found.independent)}",
    ]
    return [*lines, *(f"- {note}" for note in found.notes)]


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(name.removeprefix("u_brf_").replace("_", " ") for name in names) or "nothing"
