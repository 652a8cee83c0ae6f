"""The command ``goniotwin scan``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def scan(
    plan: Annotated[
        Path | None, typer.Argument(help="What to measure; with --simulate the laboratory's own example by default.")
    ] = None,
    simulate: Annotated[bool, typer.Option("--simulate", help="Use the simulated laboratory.")] = False,
    speed: Annotated[
        float | None, typer.Option(min=0.01, help="How many times faster the simulated laboratory's clock runs [1].")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the simulated laboratory's random draws [1].")] = None,
    devices: Annotated[Path | None, typer.Option(help="Connections of a laboratory (devices.toml).")] = None,
    facility: Annotated[Path | None, typer.Option(help="What is known of the instrument (facility.toml).")] = None,
    artifact: Annotated[Path | None, typer.Option(help="What lies on the stage (artifact.toml).")] = None,
    material: Annotated[Path | None, typer.Option(help="Coupon run or table of its coating.")] = None,
    corrections: Annotated[
        Path | None, typer.Option(help="Effects that the twin includes, from goniotwin diagnose --save-twin.")
    ] = None,
    operator: Annotated[str | None, typer.Option(help="Who measures; kept in the run's record.")] = None,
    sample: Annotated[str | None, typer.Option(help="Which sample; kept in the run's record.")] = None,
    reference_standard: Annotated[
        str | None, typer.Option(help="Which reference standard; that of the facility's certificate by default.")
    ] = None,
    project: Annotated[str | None, typer.Option(help="What for; kept in the run's record.")] = None,
    remarks: Annotated[str | None, typer.Option(help="Anything else; kept in the run's record.")] = None,
    out: Annotated[Path | None, typer.Option(help="Run folder; runs/<UTC time>-<plan> by default.")] = None,
    accept_reference: Annotated[
        bool,
        typer.Option("--accept-reference", help="Use a reference whose certificate does not cover the scan; recorded."),
    ] = False,
    no_twin: Annotated[bool, typer.Option("--no-twin", help="Measure only; nothing is predicted.")] = False,
    resume: Annotated[Path | None, typer.Option(help="Run folder of an interrupted scan to go on with.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write how the scan ended to a file, for programs.")] = None,
) -> None:
    """Run a scan: measure every point of a plan, with the twin's prediction beside it.

    Ctrl-C ends it in an orderly way, a second Ctrl-C stops everything at once; "p" and Enter rests after the point at
    hand, Enter goes on. An interrupted scan goes on with --resume.
    """
    from instrument.scan_options import check_options

    options = {
        "plan": plan,
        "simulate": simulate,
        "speed": speed,
        "seed": seed,
        "devices": devices,
        "facility": facility,
        "artifact": artifact,
        "material": material,
        "corrections": corrections,
        "out": out,
        "resume": resume,
    }
    record = {
        "operator": operator,
        "sample": sample,
        "reference_standard": reference_standard,
        "project": project,
        "remarks": remarks,
    }
    given = {name: value for name, value in options.items() if value is not None}
    said = {name: value for name, value in record.items() if value is not None}
    check_options(given | said)
    given |= {"twin": not no_twin, "accept_reference": accept_reference}

    from instrument.forms import parse_form
    from instrument.request import ScanRequest
    from instrument.run_record import RunRecord
    from instrument.scan_run import run_scan

    words = {"record": parse_form(said, RunRecord, "scan")}
    status = run_scan(ScanRequest.model_validate(given | words), json)
    if status:
        raise typer.Exit(status)
