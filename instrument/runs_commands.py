"""``goniotwin runs list | show | verify | amend``: the records of earlier scans."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from instrument.options import Dask, Workers

Json = Annotated[Path | None, typer.Option("--json", help="Write the same for programs.")]


def list_runs(
    folder: Annotated[str, typer.Argument(help="Folder that holds run folders; or its URL.")] = "runs",
    plan: Annotated[str, typer.Option(help="Part of the plan's title.", show_default=False)] = "",
    sample: Annotated[str, typer.Option(help="Part of the sample's name.", show_default=False)] = "",
    operator: Annotated[str, typer.Option(help="Part of the operator's name.", show_default=False)] = "",
    project: Annotated[str, typer.Option(help="Part of the project's name.", show_default=False)] = "",
    since: Annotated[str, typer.Option(help="Started on this day (UTC) or later.", show_default=False)] = "",
    until: Annotated[str, typer.Option(help="Started on this day (UTC) or earlier.", show_default=False)] = "",
    state: Annotated[
        str,
        typer.Option(help="finished, aborted, halted, faulted, interrupted, running, damaged.", show_default=False),
    ] = "",
    diagnosis: Annotated[str, typer.Option(help="Part of the diagnosis: verdict or effect.", show_default=False)] = "",
    wavelength: Annotated[float | None, typer.Option(help="nm, measured in the run.", show_default=False)] = None,
    where: Annotated[
        list[str] | None, typer.Option(help="Figure of merit, like relative_rmse<0.03.", show_default=False)
    ] = None,
    rebuild: Annotated[bool, typer.Option("--rebuild", help="Read every folder again.")] = False,
    json_file: Json = None,
) -> None:
    """List the runs in a folder, or those that a search finds: when, what, how many points, how it ended."""
    from rich.console import Console

    from instrument.catalogue.search import Query, condition, moment
    from instrument.catalogue.store import Catalogue
    from instrument.exchange.stores import brought_overviews
    from instrument.output import check_json, write_json
    from instrument.run_report import overview_table

    check_json(json_file)
    query = Query(
        plan=plan,
        sample=sample,
        operator=operator,
        project=project,
        verdict=diagnosis,
        state=state,
        since=moment(since, "--since") if since else None,
        until=moment(until, "--until", end=True) if until else None,
        wavelength=wavelength,
        conditions=[condition(text) for text in where or []],
    )
    rows = Catalogue(brought_overviews(folder)).search(query, rebuild=rebuild)
    nothing = f"{folder}: no runs" + ("" if query == Query() else " that the search holds for")
    Console(highlight=False).print(overview_table(rows) if rows else nothing)
    if json_file is not None:
        write_json(json_file, [row.as_dict(folder) for row in rows])


def show(
    run: Annotated[str, typer.Argument(help="A run folder or run file (.nc, .csv); or its URL.", show_default=False)],
    json_file: Json = None,
) -> None:
    """Show one run: what was measured, by plane, what is missing, what the file cannot support."""
    from rich.console import Console

    from instrument.exchange.stores import brought
    from instrument.output import check_json, write_json
    from instrument.run_report import print_run, run_summary

    check_json(json_file)
    summary = run_summary(brought(run)) | {"source": run}
    print_run(summary, Console(highlight=False))
    if json_file is not None:
        write_json(json_file, summary)


def verify(
    folders: Annotated[
        list[str],
        typer.Argument(metavar="FOLDER...", help="Run folders, folders of them, or their URLs.", show_default=False),
    ],
    workers: Workers = 1,
    dask: Dask = None,
    json_file: Json = None,
) -> None:
    """Check run folders against their journals; exit status 1 when anything is not as it was measured.

    Named alone, a run folder's checks are listed one by one; of several runs, each has a row.
    """
    from rich.console import Console

    from instrument.errors import EXIT_INCOMPLETE
    from instrument.exchange.many import run_folders, verify_all
    from instrument.output import check_json, write_json
    from instrument.run_report import verification_table, verifications_table

    check_json(json_file)
    runs = run_folders(folders)
    results = verify_all(runs, workers=workers, address=dask)
    alone = len(folders) == 1 and runs == folders
    Console(highlight=False).print(verification_table(results[0]) if alone else verifications_table(results))
    if json_file is not None:
        write_json(json_file, results[0].as_dict() if alone else [result.as_dict() for result in results])
    if not all(result.passed for result in results):
        raise typer.Exit(EXIT_INCOMPLETE)


def amend(
    folder: Annotated[Path, typer.Argument(help="A run folder.", show_default=False)],
    by: Annotated[str, typer.Option(help="Who amends.", show_default=False)],
    because: Annotated[str, typer.Option(help="Why.", show_default=False)],
    operator: Annotated[str | None, typer.Option(help="Who measured.")] = None,
    sample: Annotated[str | None, typer.Option(help="Which sample.")] = None,
    reference_standard: Annotated[str | None, typer.Option(help="Which reference standard.")] = None,
    project: Annotated[str | None, typer.Option(help="What for.")] = None,
    remarks: Annotated[str | None, typer.Option(help="Anything else.")] = None,
    json_file: Json = None,
) -> None:
    """Amend what a run says of operator, sample and standard; what was written before is kept, and shown with it."""
    from rich.console import Console

    from instrument.amending import amend as amend_run
    from instrument.errors import InputError
    from instrument.output import check_json, write_json
    from instrument.run_report import print_record, run_summary

    check_json(json_file)
    said = {
        "operator": operator,
        "sample": sample,
        "reference_standard": reference_standard,
        "project": project,
        "remarks": remarks,
    }
    changes = {name: text for name, text in said.items() if text is not None}
    if not changes:
        options = ", ".join(f"--{name.replace('_', '-')}" for name in said)
        raise InputError(f"nothing to amend; expected at least one of {options}")
    console = Console(highlight=False)
    if amend_run(folder, changes, by=by, reason=because) is None:
        console.print("The record says so already; nothing was written.")
    summary = run_summary(folder)
    print_record(summary, console)
    if json_file is not None:
        write_json(json_file, {name: summary[name] for name in ("record", "record_history")})
