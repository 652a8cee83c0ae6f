"""Runs as a person reads them on a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from instrument.catalogue.entry import Entry
from instrument.errors import InputError
from instrument.journal import read_journal
from instrument.plan import describe
from instrument.records import SkippedRecord
from instrument.run_archive import Verification, summary_of
from instrument.run_axes import POLARIZATIONS
from instrument.run_folder import RUN_NAME
from instrument.run_read import capabilities, read_run
from instrument.run_record import FIELDS, current_record, history
from instrument.run_schema import FLAG_MASKS

_FLAGS = dict(zip(("saturated", "overload", "shadowed", "repeated"), FLAG_MASKS, strict=True))


def overview_table(rows: Sequence[Entry]) -> Table:
    """One row a run; columns that no run has anything for are left out."""
    columns = {
        "run": [row.name for row in rows],
        "started (UTC)": [row.created[:16].replace("T", " ") for row in rows],
        "title": [escape(row.title) for row in rows],
        "sample": [escape(row.sample) for row in rows],
        "operator": [escape(row.operator) for row in rows],
        "points": [f"{row.measured} of {row.planned}" if row.created else "" for row in rows],
        "skipped": [str(row.skipped or "") for row in rows],
        "outcome": [f"[red]{escape(row.problem)}[/red]" if row.problem else row.outcome for row in rows],
        "twin / %": ["" if row.relative_rmse is None else f"{100 * row.relative_rmse:.2f}" for row in rows],
        "diagnosis": [escape(row.verdict) for row in rows],
    }
    table = Table()
    said = {head: cells for head, cells in columns.items() if any(cells)}
    for head in said:
        table.add_column(head, no_wrap=head in ("started (UTC)", "points"), overflow="fold")
    for cells in zip(*said.values(), strict=True):
        table.add_row(*cells)
    return table


def verification_table(result: Verification) -> Table:
    """One row a check."""
    table = Table("check", "", "found", title=escape(str(result.folder)), title_justify="left")
    for check in result.checks:
        table.add_row(check.name, "[green]good[/green]" if check.passed else "[red]bad[/red]", escape(check.found))
    return table


def verifications_table(results: Sequence[Verification]) -> Table:
    """One row a run: whether it passed, and the first thing that is the matter with it."""
    good = sum(result.passed for result in results)
    table = Table("run", "", "found", title=f"{good} of {len(results)} runs are as they were measured")
    for result in results:
        bad = next((f"{check.name}: {check.found}" for check in result.checks if not check.passed), "")
        table.add_row(
            escape(str(result.folder)),
            "[red]bad[/red]" if bad else "[green]good[/green]",
            escape(bad) or f"{len(result.checks)} checks",
        )
    return table


def run_summary(path: Path) -> dict[str, Any]:
    """What ``goniotwin runs show --json`` writes.

    Parameters
    ----------
    path
        A run folder or a run file.

    Raises
    ------
    InputError
        If it is neither.
    """
    summary: dict[str, Any] = {"source": str(path)}
    file = path
    if path.is_dir():
        content = read_journal(path)
        summary |= {"folder": str(path)} | vars(summary_of(content))
        summary["record"] = current_record(content).said()
        summary["record_history"] = history(content)
        summary["references"] = len(content.references)
        summary["skipped_points"] = list(content.skipped.values())
        summary["notes"] = [record["text"] for record in content.others if record["kind"] == "note"]
        summary["torn_bytes"] = len(content.torn or b"")
        file = path / RUN_NAME
        if not file.exists():
            return summary
    elif not path.exists():
        raise InputError(f"{path}: no such file; expected a run folder or a run file")
    return summary | _file_summary(read_run(file))


def _file_summary(run: xr.Dataset) -> dict[str, Any]:
    brf, u_brf = run["brf"].values, run["u_brf"].values
    relative = u_brf / np.abs(brf)
    flags = run["quality_flag"].values if "quality_flag" in run else np.zeros(run.sizes["point"], dtype=int)
    result: dict[str, Any] = {
        "points": int(run.sizes["point"]),
        "brf": [float(brf.min()), float(brf.max())],
        "relative_u_brf": [float(relative.min()), float(relative.max())],
        "flagged": {name: int(np.sum(flags & mask > 0)) for name, mask in _FLAGS.items()},
        "planes": _planes(run),
        "cannot": capabilities(run),
    }
    if "time" in run.variables:
        ends = np.array([run["time"].values.min(), run["time"].values.max()])
        result["time"] = [f"{text}Z" for text in np.datetime_as_string(ends, unit="s")]
    return result


def _planes(run: xr.Dataset) -> list[dict[str, Any]]:
    further = [name for name in ("sample_rotation", "polarization") if name in run.variables]
    names = ("wavelength", "illumination_zenith", "sensor_azimuth", *further)
    keys = np.stack([run[name].values for name in names], axis=-1)
    planes, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    result = []
    for plane in np.argsort(first):
        rows = np.ravel(which) == plane
        zenith, brf = run["sensor_zenith"].values[rows], run["brf"].values[rows]
        result.append(
            _named_plane(names, planes[plane])
            | {
                "points": int(rows.sum()),
                "sensor_zenith": [float(zenith.min()), float(zenith.max())],
                "brf": [float(brf.min()), float(brf.max())],
            }
        )
    return result


def _named_plane(names: Sequence[str], values: np.ndarray) -> dict[str, Any]:
    plane: dict[str, Any] = dict(zip(names, map(float, values), strict=True))
    if "polarization" in plane:
        plane["polarization"] = POLARIZATIONS[int(plane["polarization"])]
    return plane


def print_run(summary: dict[str, Any], console: Console) -> None:
    """Write a summary of :func:`run_summary` for people."""
    title = f": {summary['title']}" if summary.get("title") else ""
    console.print(f"[bold]{escape(summary['source'])}[/bold]{escape(title)}")
    if "outcome" in summary:
        console.print(
            f"started {summary['created']}, {summary['outcome']}; {summary['measured']} of {summary['planned']} points,"
            f" {summary['references']} reference readings"
        )
        print_record(summary, console)
        for record in summary["skipped_points"]:
            skipped = SkippedRecord.model_validate(record)
            console.print(f"  skipped: point {skipped.index}, {describe(skipped.geometry)}: {escape(skipped.reason)}")
        for note in summary["notes"]:
            console.print(f"  note: {escape(note)}")
    if "planes" not in summary:
        console.print(f"no {RUN_NAME} yet")
        return
    further = [name for name in ("sample_rotation", "polarization") if name in summary["planes"][0]]
    names = ("wavelength", "illumination_zenith", "sensor_azimuth", *further)
    heads = ("wavelength / nm", *(name.replace("_", " ") for name in names[1:]))
    table = Table(*heads, "sensor zenith", "points", "brf")
    for plane in summary["planes"]:
        angles = (plane[name] if isinstance(plane[name], str) else f"{plane[name]:g}" for name in names)
        zenith = "{:g} to {:g}".format(*plane["sensor_zenith"])
        table.add_row(*angles, zenith, str(plane["points"]), "{:.4f} to {:.4f}".format(*plane["brf"]))
    console.print(table)
    low, high = summary["relative_u_brf"]
    console.print(f"combined standard uncertainty {100 * low:.2f} to {100 * high:.2f} %")
    for name, number in summary["flagged"].items():
        if number:
            console.print(f"flagged {name}: {number} of {summary['points']} points")
    for sentence in summary["cannot"]:
        console.print(f"- {sentence}")


def print_record(summary: dict[str, Any], console: Console) -> None:
    """Write who measured what, and how that was amended, of a summary of :func:`run_summary`."""
    for name in FIELDS:
        if name in summary["record"]:
            console.print(f"  {name.replace('_', ' ')}: {escape(summary['record'][name])}")
    for change in summary["record_history"]:
        before = escape(change["before"]) or "nothing"
        console.print(
            f"  amended {change['time'][:19]} by {escape(change['by'])}: {change['field'].replace('_', ' ')},"
            f" was {before}, is {escape(change['after']) or 'nothing'} ({escape(change['reason'])})"
        )
