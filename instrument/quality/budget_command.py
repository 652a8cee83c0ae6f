"""``goniotwin budget``: the uncertainty budget of a run, as Table II of the paper has it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from instrument.options import Force


def budget(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A run folder, or a run file (.nc, .csv).", show_default=False)
    ],
    point: Annotated[
        int | None,
        typer.Option(help="Of one point alone: its number in the file, from 0.", show_default=False),
    ] = None,
    slopes: Annotated[
        bool,
        typer.Option("--slopes", help="Replace the angle terms by the slope of what was measured times the angle's u."),
    ] = False,
    prediction: Annotated[
        Path | None,
        typer.Option(help="Take the slopes from this prediction instead of the measurement.", show_default=False),
    ] = None,
    facility: Annotated[
        Path | None,
        typer.Option(help="facility.toml, where the run does not hold its own.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the run with this budget, .nc or .csv.", show_default=False)
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the same for programs.")] = None,
    force: Force = False,
) -> None:
    """Print the uncertainty budget of a run: every component, how its errors belong together, combined and expanded.

    With --slopes or --prediction the angle terms are computed anew; the run itself is not changed.
    """
    from rich.console import Console

    from instrument.errors import InputError
    from instrument.output import check_json, check_new, write_json
    from instrument.quality.budget_report import budget_summary, print_budget
    from instrument.quality.budget_slopes import compared_slopes, facility_of, with_slopes
    from instrument.quality.run_files import run_of
    from instrument.run_read import read_prediction
    from instrument.run_write import write_run

    if out is not None:
        if out.suffix.lower() not in (".nc", ".csv"):
            raise InputError(f"--out: found {out}; expected the name of a run file, .nc or .csv")
        check_new(out, force)
    check_json(json_file)
    data = run_of(run)
    wanted = slopes or prediction is not None
    known = facility_of(run, data, facility, required=wanted)
    predicted = read_prediction(prediction) if prediction is not None else None
    if wanted and known is not None:
        data = with_slopes(data, known, predicted)
    summary = budget_summary(data, str(run), point)
    if known is not None and not wanted:
        summary["slopes"] = compared_slopes(data, known)
    print_budget(summary, Console(highlight=False))
    if out is not None:
        write_run(data, out)
        typer.echo(f"{out}: {data.sizes['point']} points with this budget")
    if json_file is not None:
        write_json(json_file, summary)
