"""Everything that can be known to be wrong before anything moves: one line a check, passed or with the reason."""

from __future__ import annotations

import shutil
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from drivers.errors import DeviceError, DeviceFault
from drivers.interfaces import ChannelSelector
from instrument.control import ask
from instrument.facility import Facility
from instrument.hindrances import DiskNearlyFull, require_room
from instrument.procedures.standing import calibration_lines, certificate_line, warm_up_line
from instrument.settings import ScanSettings
from instrument.station import Station


class Check(BaseModel):
    """One line of the preflight; ``found`` says what was seen, whether it passed or not."""

    model_config = ConfigDict(frozen=True)
    name: str
    passed: bool
    found: str


def preflight(
    station: Station,
    run_dir: Path,
    settings: ScanSettings,
    reference_age: timedelta,
    facility: Facility | None = None,
    now: datetime | None = None,
) -> list[Check]:
    """Look at every device, at the disk, the dark level, the reference, the warm-up and the calibrations that are due.

    Nothing moves.

    The shutter is closed first. A device that does not answer raises: without it nothing can be known.

    Parameters
    ----------
    reference_age
        Of the calibration that a resumed run holds; zero where there is none.
    facility, now
        What is wanted of calibrations, and laboratory time; without them nothing is said of certificate, warm-up and
        calibrations.

    Raises
    ------
    CommunicationError
        If a device does not answer.
    """
    station.acquisition.shut()
    checks = [Check(name="shutter", passed=True, found="closed")]
    for name, axis in (station.laboratory.axes() | station.laboratory.stages()).items():
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
    checks += _further_light(station)
    if facility is not None and now is not None:
        checks += _calibrations(station, settings, facility, now)
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


def _further_light(station: Station) -> list[Check]:
    """A second wavelength that a filter lets through would be in every reading."""
    selector = station.laboratory.selector
    if not isinstance(selector, ChannelSelector):
        return []
    others = [number for number in range(8) if number != selector.channel]
    opened = [number for number in others if ask(partial(selector.channel_amplitude, number)) > 0]
    found = f"channels {opened} are open beside {selector.channel}" if opened else "one channel only"
    return [Check(name="selector", passed=not opened, found=found)]


def _calibrations(station: Station, settings: ScanSettings, facility: Facility, now: datetime) -> list[Check]:
    """What is overdue is said, and fails where the facility says so; an accepted certificate was asked about before."""
    emitting = ask(station.laboratory.source.emission)
    certificate = certificate_line(facility, now)
    checks = [Check(name=certificate[0], passed=True, found=certificate[2])] if certificate else []
    lines = [warm_up_line(facility, settings.warm_up, emitting), *calibration_lines(facility, now)]
    refuse = facility.calibration.overdue == "refuse"
    for name, good, found in lines:
        checks.append(Check(name=name, passed=good or not refuse, found=found if good else f"not in order: {found}"))
    return checks


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
