"""``goniotwin material``: check a material, and write it as a table that stands on its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from instrument.options import Force

_File = Annotated[
    Path, typer.Argument(help="Coupon run, BRDF table, measured material or material.toml.", show_default=False)
]


def check(
    file: _File,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the report for programs, too.")] = None,
) -> None:
    """Check a material: coverage, reciprocity, energy, what is filled, how well it is interpolated."""
    from instrument.errors import EXIT_INCOMPLETE
    from instrument.output import check_json, write_json
    from twin.material_check import check_file

    check_json(json_file)
    report = check_file(file)
    if json_file is not None:
        write_json(json_file, report.to_json())
    for line in report.lines():
        typer.echo(line)
    if report.problems:
        raise typer.Exit(EXIT_INCOMPLETE)


def table(
    file: _File,
    out: Annotated[Path, typer.Option(help="Where the table goes (netCDF).")] = Path("material_table.nc"),
    force: Force = False,
) -> None:
    """Write a material as a ready table, whatever model and files it comes from."""
    from instrument.errors import InputError
    from instrument.output import check_new
    from twin.material import read_material
    from twin.reflection_models.table import to_table

    if out.resolve() != file.resolve():
        check_new(out, force)
    material = read_material(file)
    if out.resolve() == file.resolve():
        raise InputError(f"--out: {out}: is the material itself; expected another name")
    try:
        to_table(material).to_netcdf(out, engine="h5netcdf")
    except OSError as error:
        raise InputError(f"--out: {out}: cannot be written ({error.strerror or error})") from None
    typer.echo(material.describe())
    typer.echo(f"written: {out}")
