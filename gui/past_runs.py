"""What the lists of runs show: an overview of each run folder with what else lies in it. Read on a thread."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from instrument.errors import InputError

if TYPE_CHECKING:  # what reads runs takes a second to load: that is done on the thread
    from instrument.run_archive import Overview

REPORT_NAME, DIAGNOSIS_NAME, TWIN_NAME = "diagnosis.html", "diagnosis.json", "corrected-twin.toml"
#: Outcomes after which a run can go on.
RESUMABLE = ("interrupted", "aborted", "halted", "faulted")


@dataclass(frozen=True)
class PastRun:
    """One run folder.

    Attributes
    ----------
    figures
        Pictures in it.
    report
        Of its diagnosis; None where there is none.
    """

    overview: Overview
    figures: tuple[Path, ...] = ()
    report: Path | None = None

    @property
    def folder(self) -> Path:
        """Where it lies."""
        return self.overview.folder

    @property
    def resumable(self) -> bool:
        """Whether points are missing that can still be measured."""
        row = self.overview
        return not row.problem and row.outcome in RESUMABLE and row.measured + row.skipped < row.planned


def past_runs(folder: Path) -> list[PastRun]:
    """Every run in a folder, newest first; none where there is no such folder."""
    from instrument.run_archive import overviews

    try:
        rows = overviews(folder)
    except InputError:
        return []
    runs = [_past(row) for row in rows]
    return sorted(runs, key=lambda run: run.overview.created or run.folder.name, reverse=True)


def _past(row: Overview) -> PastRun:
    figures = sorted(path for path in row.folder.rglob("*.png") if "export-" not in str(path))
    report = row.folder / REPORT_NAME
    return PastRun(row, tuple(figures), report if report.is_file() else None)
