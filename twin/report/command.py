"""``goniotwin report``: a run, or a run beside its prediction, as one file to read, print and send."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from instrument.options import Force


def report(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A run folder, or a run file (.nc, .csv).", show_default=False)
    ],
    prediction: Annotated[
        Path | None,
        typer.Argument(metavar="PREDICTION", help="prediction.nc; that of the run folder by default."),
    ] = None,
    diagnosis: Annotated[
        Path | None,
        typer.Option(
            help="What goniotwin diagnose --json wrote; that of the run folder by default.", show_default=False
        ),
    ] = None,
    artifact: Annotated[Path | None, typer.Option(help="artifact.toml of the sample.", show_default=False)] = None,
    material: Annotated[Path | None, typer.Option(help="Run over the witness coupon.", show_default=False)] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="The report; report.html in the run folder, or NAME-report.html beside a run file, by default."
        ),
    ] = None,
    pdf: Annotated[Path | None, typer.Option(help="Also write the report as PDF here.", show_default=False)] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            help="Also write every figure (PNG, SVG, PDF) and the data behind it (CSV) into this folder.",
            show_default=False,
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Write the report of a run: what was measured and simulated, how they agree, and what that rests on.

    It has the counterparts of the paper's Figs. 10 to 20 and Tables I to VI as far as the files go; what cannot be
    there is named with the reason.
    """
    from instrument.errors import InputError
    from twin.report.build import build_report
    from twin.report.output import check_targets, write_report
    from twin.report.sources import Named, read_sources

    if not run.exists():
        raise InputError(f"{run}: no such file; expected a run folder or a run file")
    html = out or (run / "report.html" if run.is_dir() else run.with_name(f"{run.stem}-report.html"))
    check_targets(html, pdf, figures, force=force)
    document = build_report(read_sources(Named(run, prediction, diagnosis, artifact, material)))
    for path in write_report(document, html, pdf, figures):
        typer.echo(f"written: {path}")
    for one in document.left_out():
        typer.echo(f"left out: {one.what} ({one.why})")
