"""Everything that can be known to be wrong before anything moves: one line a check, passed or with the reason."""

from __future__ import annotations

import shutil
from datetime import timedelta
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from drivers.errors import DeviceError, DeviceFault
from instrument.control import ask
from instrument.hindrances import DiskNearlyFull, require_room
from instrument.settings import ScanSettings
from instrument.station import Station


class Check(BaseModel):
    """One line of the preflight; ``found`` says what was seen, whether it passed or not."""

    model_config = ConfigDict(frozen=True)
    name: str
    passed: bool
    found: str


def preflight(station: Station, run_dir: Path, settings: ScanSettings, reference_age: timedelta) -> list[Check]:
    """Look at every device, at the disk, the dark level and the age of the reference. Nothing moves.

    The shutter is closed first. A device that does not answer raises: without it nothing can be known.

    Parameters
    ----------
    reference_age
        Of the calibration that a resumed run holds; zero where there is none.

    Raises
    ------
    CommunicationError
        If a device does not answer.
    """
    station.acquisition.shut()
    checks = [Check(name="shutter", passed=True, found="closed")]
    for name, axis in station.laboratory.axes().items():
        status = ask(axis.status)
        found = status.fault or ("homed" if status.homed else "not homed yet: it will be")
        checks.append(Check(name=name, passed=not status.fault, found=found))
    fault = ask(station.laboratory.source.fault)
    checks.append(Check(name="source", passed=not fault, found=fault or "no fault, interlock closed"))
    checks.append(_dark(station))
    checks.append(_disk(run_dir, settings.disk_reserve))
    hours = reference_age / timedelta(hours=1)
    old = hours > settings.reference_age
    checks.append(
        Check(name="reference", passed=True, found=f"{hours:.1f} h old" + (": it is measured anew" if old else ""))
    )
    return checks


def require(checks: list[Check]) -> None:
    """Let no scan start on a check that has not passed.

    Raises
    ------
    DiskNearlyFull, DeviceFault
        For the first one.
    """
    for check in checks:
        if not check.passed:
            kind = DiskNearlyFull if check.name == "disk" else DeviceFault
            raise kind(check.name, check.found, "deal with this before a scan; nothing has moved")


def _dark(station: Station) -> Check:
    try:
        level, full = station.acquisition.dark_level(), station.laboratory.detector.full_scale
    except DeviceFault as error:
        return Check(name="dark level", passed=False, found=_said(error))
    found = f"{level:.3g} V at the lowest gain (at most {100 * station.acquisition.darkest:g} % of {full:g} V)"
    return Check(name="dark level", passed=abs(level) <= station.acquisition.darkest * full, found=found)


def _disk(run_dir: Path, reserve: float) -> Check:
    try:
        require_room(run_dir, reserve)
    except DiskNearlyFull as error:
        return Check(name="disk", passed=False, found=_said(error))
    return Check(name="disk", passed=True, found=f"{shutil.disk_usage(run_dir).free / 1e6:.0f} MB free")


def _said(error: DeviceError) -> str:
    return error.problem
