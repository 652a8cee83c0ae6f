"""``goniotwin runs compare``: two measured runs, point by point."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from twin.run_pair import PairComparison


def compare_pair(
    first: Annotated[
        str, typer.Argument(metavar="A", help="A run folder or run file; or its URL.", show_default=False)
    ],
    second: Annotated[str, typer.Argument(metavar="B", help="Another one.", show_default=False)],
    shared: Annotated[
        list[str] | None,
        typer.Option(help="A component (reference, sensor_zenith, ...) whose error both have.", show_default=False),
    ] = None,
    independent: Annotated[
        list[str] | None, typer.Option(help="A component whose error each has for itself.", show_default=False)
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write it for programs, every point.")] = None,
) -> None:
    """Compare two runs of one sample: ratio of B to A at every common geometry, its uncertainty, agreement."""
    from rich.console import Console

    from instrument.exchange.stores import brought
    from instrument.output import check_json, write_json
    from instrument.quality.run_files import named_runs
    from twin.run_pair import compare_runs

    check_json(json_file)
    a, b = named_runs([brought(first), brought(second)]).values()
    found = compare_runs(a, b, shared=shared or (), independent=independent or ())
    console = Console(highlight=False)
    console.print(planes_table(found))
    for line in in_words(found):
        console.print(line, markup=False)
    if json_file is not None:
        write_json(json_file, found.as_dict())
        typer.echo(f"written: {json_file}")


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
