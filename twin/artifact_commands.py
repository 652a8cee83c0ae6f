"""``goniotwin artifact export | show``: the sample's solid for other programs, and for the eye."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from instrument.options import Force

Artifact = Annotated[Path, typer.Argument(help="artifact.toml of the sample.", show_default=False)]
Sides = Annotated[int, typer.Option(min=8, max=512, help="Sides of the polygon that stands for a circle.")]


def export(
    artifact: Artifact,
    out: Annotated[
        Path, typer.Option(help="Where it goes; the suffix chooses: .ply, .stl, .obj or .scad.", show_default=False)
    ],
    sides: Sides = 64,
    force: Force = False,
) -> None:
    """Write the solid of a sample as a mesh (PLY, STL, OBJ) or as parametric OpenSCAD source."""
    from instrument.artifact import read_artifact
    from instrument.output import check_new
    from twin.mesh_export import export_artifact

    check_new(out, force)
    mesh = export_artifact(read_artifact(artifact), out, sides=sides)
    typer.echo(f"{len(mesh.faces)} faces, {mesh.volume():.3f} mm3, closed")
    typer.echo(f"written: {out}")


def show(
    artifact: Artifact,
    out: Annotated[Path | None, typer.Option(help="Also draw it, into a PNG file.")] = None,
    whole: Annotated[bool, typer.Option("--whole", help="Do not cut a quarter away in the picture.")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the same for programs.")] = None,
    force: Force = False,
) -> None:
    """Check the solid of a sample, show its dimensions and areas, and draw it."""
    from rich.console import Console

    from instrument.artifact import read_artifact
    from instrument.output import check_json, check_new, write_json
    from twin.artifact import build_mesh
    from twin.artifact_report import artifact_report, report_table

    check_json(json_file)
    if out is not None:
        check_new(out, force)
    dimensions = read_artifact(artifact)
    mesh = build_mesh(dimensions)
    report = artifact_report(dimensions, mesh)
    Console(highlight=False).print(report_table(report))
    if json_file is not None:
        write_json(json_file, report)
    if out is not None:
        from twin.artifact_picture import picture

        picture(mesh, out, whole=whole)
        typer.echo(f"written: {out}")
