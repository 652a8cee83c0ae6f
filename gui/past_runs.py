"""What the lists of runs show: rows of the catalogue, and what else lies in a run folder. Read on a thread."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from instrument.errors import InputError

if TYPE_CHECKING:  # what reads runs takes a second to load: that is done on the thread
    from instrument.catalogue.entry import Entry
    from instrument.catalogue.search import Query

REPORT_NAME, DIAGNOSIS_NAME, TWIN_NAME = "diagnosis.html", "diagnosis.json", "corrected-twin.toml"
#: Outcomes after which a run can go on.
RESUMABLE = ("interrupted", "aborted", "halted", "faulted")
_LEFT_OUT = ("export-",)  # folders of figures that a person wrote for elsewhere


@dataclass(frozen=True)
class PastRun:
    """One run folder.

    Attributes
    ----------
    folder
        Where it lies.
    row
        What the catalogue says of it.
    """

    folder: Path
    row: Entry

    @property
    def started(self) -> str:
        """Day and time, UTC; empty where nobody knows."""
        return self.row.created[:16].replace("T", " ")

    @property
    def name(self) -> str:
        """Its title; its folder's name where it has none."""
        return self.row.title or self.folder.name

    @property
    def readable(self) -> bool:
        """Whether there is something to show."""
        return self.row.outcome != "damaged" and self.row.measured > 0

    @property
    def resumable(self) -> bool:
        """Whether points are missing that can still be measured."""
        row = self.row
        return row.outcome in RESUMABLE and row.measured + row.skipped < row.planned


def past_runs(folder: Path, query: Query | None = None) -> list[PastRun]:
    """The runs in a folder that a search finds, newest first; none where there is no such folder."""
    from instrument.catalogue.store import Catalogue

    try:
        rows = Catalogue(folder).search(query)
    except InputError:
        return []
    rows.sort(key=lambda row: row.created or row.name, reverse=True)
    return [PastRun(folder / row.name, row) for row in rows]


def figures_of(folder: Path) -> list[Path]:
    """Pictures in a run folder."""
    return sorted(_pictures(folder))


def _pictures(folder: Path) -> Iterator[Path]:
    for path in folder.rglob("*.png"):
        if not any(part.startswith(_LEFT_OUT) for part in path.relative_to(folder).parts):
            yield path
