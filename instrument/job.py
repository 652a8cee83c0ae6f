"""What an engine is given: one scan, ready to run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from drivers.clock import Clock
from drivers.interfaces import Laboratory
from instrument.calibration import calibration_numbers
from instrument.events import Geometry
from instrument.facility import Facility
from instrument.journal import Journal, JournalContent
from instrument.operators import Operator
from instrument.plan import Plan, reference_geometries
from instrument.settings import ScanSettings


@dataclass(frozen=True)
class ScanFiles:
    """The run folder and the copies in it of what describes the scan."""

    run_dir: Path
    facility: Path | None = None
    artifact: Path | None = None
    material: Path | None = None


@dataclass(frozen=True)
class ScanJob:
    """One scan.

    Attributes
    ----------
    connect
        Opens every wire and asks every device who it is; called on the engine's thread.
    journal
        Open for writing; the engine closes it.
    previous
        What the journal already held: none of it is measured again.
    derive
        Makes ``run.nc`` from the journal; returns its path, None where there is nothing to make it of.
    """

    plan: Plan
    facility: Facility
    connect: Callable[[], Laboratory]
    clock: Clock
    journal: Journal
    operator: Operator
    files: ScanFiles
    previous: JournalContent | None = None
    derive: Callable[[], Path | None] = lambda: None
    settings: ScanSettings = field(default_factory=ScanSettings)

    def references(self) -> list[tuple[int, Geometry]]:
        """Every reading of the reference that this plan needs: each azimuth at each wavelength, numbered."""
        return list(enumerate(reference_geometries(self.plan, self.facility)))

    def missing_references(self) -> list[tuple[int, Geometry]]:
        """Those that the last calibration lacks; all of them where it is too old for what is still to be measured."""
        read = self._last_calibration()
        if read and self.reference_age() > timedelta(hours=self.settings.reference_age):
            return self.references()
        return [(index, geometry) for index, geometry in self.references() if index not in read]

    def reference_age(self) -> timedelta:
        """How long ago (laboratory time) the last calibration of a resumed run began; zero where there is none."""
        taken = [datetime.fromisoformat(record["time"]) for record in self._last_calibration().values()]
        return self.clock.now() - min(taken) if taken else timedelta(0)

    def reference_due(self, begun: datetime) -> bool:
        """Whether the reference is to be repeated, so long after the last time it was begun."""
        minutes = self.facility.reference.repeat_minutes
        return minutes > 0 and self.clock.now() - begun >= timedelta(minutes=minutes)

    def _last_calibration(self) -> dict[int, dict[str, Any]]:
        records = self.previous.references if self.previous else ()
        numbers = calibration_numbers(record["index"] for record in records)
        return {
            int(record["index"]): record
            for number, record in zip(numbers, records, strict=True)
            if number == numbers[-1]
        }
