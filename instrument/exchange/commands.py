"""``goniotwin exchange``: measurements in the forms of others, and theirs in ours."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from instrument.options import Force

Run = Annotated[str, typer.Argument(metavar="RUN", help="A run folder or run file; or its URL.", show_default=False)]
Out = Annotated[Path, typer.Argument(metavar="OUT", help="The file to write.", show_default=False)]


def bird(
    run: Run,
    out: Out,
    metadata: Annotated[
        Path | None,
        typer.Option(
            help="TOML of what people know: institute, address, sample (docs/exchange.md).", show_default=False
        ),
    ] = None,
    prediction: Annotated[
        bool, typer.Option("--prediction", help="RUN is a prediction, or the one in a folder.")
    ] = False,
    force: Force = False,
) -> None:
    """Write a run in the universal BRDF data format 1.0 (JSON, DOI 10.1002/col.22790)."""
    from instrument.exchange.bird_write import bird_document, read_metadata, unstated
    from instrument.exchange.stores import brought
    from instrument.output import check_new, write_json
    from instrument.quality.run_files import run_of
    from instrument.run_read import read_prediction

    check_new(out, force)
    source = brought(run)
    if prediction:
        source = source / "prediction.nc" if source.is_dir() else source
        dataset = read_prediction(source)
    else:
        dataset = run_of(source)
    known = None if metadata is None else read_metadata(metadata)
    document = bird_document(dataset, str(source), simulated=prediction, metadata=known)
    write_json(out, document, force=force)
    typer.echo(f"written: {out}, {dataset.sizes['point']} points")
    missing = unstated(document)
    if missing:
        typer.echo(f"not stated, and named so in the file: {', '.join(missing)} (say it with --metadata)", err=True)


def csv(run: Run, out: Out, force: Force = False) -> None:
    """Write a run as a table, one row a point; the readings of the reference have no place in it."""
    from instrument.errors import InputError
    from instrument.exchange.stores import brought
    from instrument.output import check_new
    from instrument.quality.run_files import run_of
    from instrument.run_write import write_run

    check_new(out, force)
    if out.suffix.lower() != ".csv":
        raise InputError(f"{out}: expected a name that ends in .csv")
    dataset = run_of(brought(run))
    write_run(dataset, out)
    typer.echo(f"written: {out}, {dataset.sizes['point']} points")


def import_file(
    file: Annotated[
        str,
        typer.Argument(metavar="FILE", help="Universal BRDF (.json, .brdf), table or netCDF file.", show_default=False),
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The run file to write: .nc or .csv.", show_default=False)],
    columns: Annotated[
        Path | None,
        typer.Option(help="Mapping (TOML) of columns or variables: docs/column_mapping.md.", show_default=False),
    ] = None,
    wavelength: Annotated[
        float | None, typer.Option(help="nm, where the file states none.", show_default=False)
    ] = None,
    u_relative: Annotated[
        float | None, typer.Option(help="Relative uncertainty, where the file states none.", show_default=False)
    ] = None,
    force: Force = False,
) -> None:
    """Read a measurement in a form of others, and write it as a run file."""
    from instrument.exchange.importing import import_any
    from instrument.exchange.stores import brought
    from instrument.output import check_new
    from instrument.run_read import capabilities
    from instrument.run_write import write_run

    check_new(out, force)
    found = import_any(brought(file), columns, wavelength=wavelength, u_relative=u_relative)
    write_run(found.run, out)
    typer.echo(f"written: {out}, {found.run.sizes['point']} points")
    for sentence in (*found.notes, *capabilities(found.run)):
        typer.echo(f"- {sentence}")


def documents(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Argument(
            metavar="OUT", help="The file to write (.jsonl); standard output without it.", show_default=False
        ),
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="Go on while the run is measured, and end when it ends.")
    ] = False,
    force: Force = False,
) -> None:
    """Write a run as documents of Bluesky's event model: start, descriptor, event, stop; one JSON line each."""
    from contextlib import ExitStack
    from itertools import chain

    from instrument.exchange import following
    from instrument.exchange.documents import to_line
    from instrument.output import check_new

    if out is not None:
        check_new(out, force)
    source = following.followed(run) if follow else following.documents(run)
    # A folder without a run is refused before anything is written.
    first = next(source)
    name = first[0]
    with ExitStack() as stack:
        handle = None if out is None else stack.enter_context(out.open("w", encoding="utf-8"))
        for name, document in chain([first], source):
            print(to_line((name, document)), file=handle, flush=True)
    if name != "stop":
        typer.echo("the run has not ended: no stop document (--follow waits for it)", err=True)
