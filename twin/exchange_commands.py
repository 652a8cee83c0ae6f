"""``goniotwin exchange mitsuba``: the sample for Mitsuba."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from instrument.options import Force


def mitsuba(
    material: Annotated[
        Path, typer.Argument(metavar="MATERIAL", help="Coupon run, table or material.toml.", show_default=False)
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write (.bsdf).", show_default=False)],
    artifact: Annotated[
        Path | None, typer.Option(help="artifact.toml: its solid goes beside, as OUT.ply.", show_default=False)
    ] = None,
    force: Force = False,
) -> None:
    """Write a material as Mitsuba's plugin "measured" loads it, with a scene that uses it (OUT.xml)."""
    from instrument.artifact import read_artifact
    from instrument.output import check_new
    from twin.exchange_mitsuba import bsdf_error, check_suffix, scene_text, write_bsdf
    from twin.material import read_material
    from twin.mesh_export import export_artifact

    check_suffix(out)
    scene, mesh = out.with_suffix(".xml"), out.with_suffix(".ply")
    for file in (out, scene, *([mesh] if artifact else [])):
        check_new(file, force)
    known = read_material(material)
    write_bsdf(known, out)
    mean, worst = bsdf_error(known, out)
    typer.echo(known.describe())
    typer.echo(f"written: {out}; differs from the material by {100 * mean:.2f} % (largest {100 * worst:.2f} %)")
    if artifact is not None:
        export_artifact(read_artifact(artifact), mesh)
        typer.echo(f"written: {mesh}")
    middle = 600.0 if known.wavelengths is None else float(known.wavelengths[len(known.wavelengths) // 2])
    scene.write_text(scene_text(out.name, mesh.name if artifact else None, middle), encoding="utf-8")
    typer.echo(f"written: {scene}; render it: mitsuba -m scalar_spectral {scene}")
