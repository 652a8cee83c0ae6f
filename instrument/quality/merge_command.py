"""``goniotwin runs merge``: several runs of one sample, remounted, as one."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from instrument.options import Force


class StabilityChoice(StrEnum):
    """Where the uncertainty of remounting comes from."""

    FOUND = "found"
    STATED = "stated"
    LARGER = "larger"


class MethodChoice(StrEnum):
    """How the variance between the runs is estimated."""

    MANDEL_PAULE = "mandel-paule"
    DERSIMONIAN_LAIRD = "dersimonian-laird"


def merge(
    runs: Annotated[list[Path], typer.Argument(help="Run folders or run files (.nc, .csv).", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="The merged run, .nc or .csv.", show_default=False)],
    stability: Annotated[
        StabilityChoice,
        typer.Option(help="Uncertainty of remounting: as the runs scatter, as their budget states, or the larger."),
    ] = StabilityChoice.FOUND,
    method: Annotated[MethodChoice, typer.Option(help="Estimate of the variance between the runs.")] = (
        MethodChoice.MANDEL_PAULE
    ),
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the same for programs.")] = None,
    force: Force = False,
) -> None:
    """Merge several runs of one sample that was put back on the stage before each; what they differ by is counted."""
    from rich.console import Console

    from instrument.errors import InputError
    from instrument.output import check_json, check_new, write_json
    from instrument.quality.merge import merge_runs
    from instrument.quality.merge_report import merge_summary, print_merge
    from instrument.quality.run_files import named_runs
    from instrument.run_write import write_run

    if out.suffix.lower() not in (".nc", ".csv"):
        raise InputError(f"--out: found {out}; expected the name of a run file, .nc or .csv")
    check_new(out, force)
    check_json(json_file)
    merged = merge_runs(named_runs(runs), stability=stability.value, method=method.value)
    write_run(merged, out)
    summary = merge_summary(merged)
    print_merge(summary, Console(highlight=False))
    typer.echo(f"{out}: {summary['points']} points")
    if json_file is not None:
        write_json(json_file, summary)
