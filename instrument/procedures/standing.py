"""How the instrument's calibrations stand, for the preflight of a scan."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

from instrument.errors import InputError
from instrument.facility import Facility
from instrument.procedures.results import CalibrationResult, read_results
from instrument.settings import ScanSettings

#: Commands that are not called as their results are.
_COMMANDS = {"alignment": "align", "dark-level": "calibrate dark", "gain-ratio": "calibrate gain"}


def with_facility(settings: ScanSettings, facility: Facility) -> ScanSettings:
    """Settings of a scan, with what the facility says of its source where it says more."""
    wanted = facility.calibration
    return settings.model_copy(
        update={
            "warm_up": max(settings.warm_up, 60.0 * wanted.warm_up_minutes),
            "emission_while_mounting": settings.emission_while_mounting or wanted.emission_while_mounting,
        }
    )


def calibration_lines(facility: Facility, now: datetime) -> list[tuple[str, bool, str]]:
    """Name, whether it is in order, and what was found, of every procedure that the facility wants repeated.

    Parameters
    ----------
    now
        UTC.
    """
    wanted = facility.calibration
    if not wanted.due_days:
        return []
    try:
        results = read_results(Path(wanted.results))
    except InputError as error:
        return [("calibrations", False, str(error))]
    youngest = {result.procedure: result for result in results}
    return [_line(name, days, youngest.get(name), now) for name, days in wanted.due_days.items()]


def warm_up_line(facility: Facility, warm_up: float, emitting: bool) -> tuple[str, bool, str]:
    """The same of the warm-up: what the scan waits (s), against what the last warm-up procedure took."""
    waits = "the source is on already" if emitting else f"the scan waits {warm_up / 60:.3g} min after switching it on"
    try:
        results = read_results(Path(facility.calibration.results), "warm-up")
    except InputError as error:
        return ("warm-up", False, str(error))
    if not results:
        return ("warm-up", True, f"{waits}; no warm-up was ever measured (goniotwin calibrate warm-up)")
    last = results[-1]
    needed = last.values["warm-up time"].value if "warm-up time" in last.values else 0.0
    if last.verdict == "failed":
        return ("warm-up", False, f"{waits}; on {last.taken:%Y-%m-%d} the light was not stable: {last.summary}")
    found = f"{waits}; on {last.taken:%Y-%m-%d} the light was stable after {needed / 60:.0f} min"
    return ("warm-up", emitting or warm_up >= needed, found)


def certificate_line(facility: Facility, now: datetime) -> tuple[str, bool, str] | None:
    """The same of the reference's certificate; None where the facility names none."""
    standard = facility.reference.standard
    if standard is None:
        return None
    days = (standard.valid_until - now.date()).days
    until = f"{standard.identity}, valid until {standard.valid_until}"
    if days < 0 or now.date() < standard.valid_from:
        return ("certificate", False, f"{until}: not valid today")
    return ("certificate", True, f"{until} ({days} days left)")


def _line(name: str, days: float, last: CalibrationResult | None, now: datetime) -> tuple[str, bool, str]:
    command = f"goniotwin {_COMMANDS.get(name, f'calibrate {name}')}"
    if last is None:
        return (name, False, f"never done; due every {days:g} days ({command})")
    age = max(last.age(now), timedelta(0)) / timedelta(days=1)
    found = f"{last.verdict} {age:.1f} days ago, due every {days:g}"
    if last.verdict == "failed":
        return (name, False, f"{found}: {last.summary}")
    return (name, age <= days, found)
