"""What a plan means in numbers: points, blocked ones, planes, duration."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from drivers.interfaces import AxisLimits
from instrument.durations import AXES
from instrument.errors import InputError, SafetyError
from instrument.events import Geometry
from instrument.facility import UNKNOWN_FACILITY, read_facility
from instrument.plan import Plan, describe, read_plan, reference_geometries
from instrument.safety import Envelope, Pose, check_plan


def summarise(
    plan_file: Path, facility_file: Path | None, dwell: float, velocity: float, acceleration: float
) -> tuple[Plan, dict[str, Any]]:
    """Read a plan, check every point and every way between points, and estimate how long it takes.

    Parameters
    ----------
    dwell
        Laboratory seconds a point takes once the arms stand.
    velocity, acceleration
        Of every arm, degree/s and degree/s^2.

    Returns
    -------
    plan, dict
        The plan, and what ``goniotwin plan --json`` writes.

    Raises
    ------
    InputError
        If a file is wrong, or the arms cannot reach a point.
    """
    facility = read_facility(facility_file) if facility_file is not None else UNKNOWN_FACILITY
    plan = read_plan(plan_file, facility)
    travel = {axis: getattr(facility.arms, axis) for axis in AXES}
    limits = {axis: AxisLimits(low, high, velocity, acceleration) for axis, (low, high) in travel.items()}
    reference = reference_geometries(plan, facility)
    try:
        ways = check_plan(
            [("reference", geometry) for geometry in reference]
            + [(f"point {index}", geometry) for index, geometry in enumerate(plan.points)],
            Pose.of(reference[0]),
            Envelope.of(facility.arms, limits),
        )
    except (InputError, SafetyError) as error:
        raise InputError(f"{plan.source}: {error}") from None
    return plan, {
        "title": plan.title,
        "points": [geometry.model_dump() for geometry in plan.points],
        "blocked": [{"geometry": b.geometry.model_dump(), "reason": b.reason} for b in plan.blocked],
        "samples": plan.samples,
        "scan_direction": plan.direction,
        "reference_readings": len(reference),
        "detours": ways.detours,
        "moving_time_s": ways.moving_time,
        "duration_s": ways.moving_time + dwell * (len(plan.points) + len(reference)),
    }


def print_summary(plan: Plan, summary: dict[str, Any], *, every_point: bool, console: Console) -> None:
    """Write the summary for people."""
    console.print(
        f"[bold]{escape(plan.title or plan.source)}[/bold]: {len(plan.points)} points, {len(plan.blocked)} blocked"
    )
    console.print(_planes(plan))
    if plan.blocked:
        for reason in dict.fromkeys(blocked.reason for blocked in plan.blocked):
            console.print(f"Blocked, {reason}:")
            for blocked in plan.blocked:
                if blocked.reason == reason:
                    console.print(f"  {describe(blocked.geometry)}")
    if every_point:
        console.print("Points, in order:")
        for index, point in enumerate(plan.points):
            console.print(f"  {index:5d}  {describe(point)}")
    detours = f" (ways around the shadow cone: {summary['detours']})" if summary["detours"] else ""
    console.print(
        f"Takes about {spoken(summary['duration_s'])}: {len(plan.points)} points and"
        f" {summary['reference_readings']} reference readings of {plan.samples} samples;"
        f" {spoken(summary['moving_time_s'])} of it are moves{detours}."
    )


def spoken(seconds: float) -> str:
    """A duration in hours and minutes, or minutes and seconds."""
    whole = round(seconds)
    hours, minutes = whole // 3600, whole % 3600 // 60
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {whole % 60:02d} s"


def _planes(plan: Plan) -> Table:
    table = Table("wavelength / nm", "illumination zenith", "sensor azimuth", "sensor zenith", "points", "blocked")

    def plane(p: Geometry) -> tuple[float, float, float]:
        return (p.wavelength, p.illumination_zenith, p.sensor_azimuth)

    blocked = Counter(plane(b.geometry) for b in plan.blocked)
    counts = Counter(plane(p) for p in plan.points)
    for key in counts | blocked:
        zeniths = [p.sensor_zenith for p in plan.points if plane(p) == key]
        span = f"{min(zeniths):g} to {max(zeniths):g}" if zeniths else "none"
        table.add_row(*(f"{value:g}" for value in key), span, str(counts[key]), str(blocked[key]))
    return table
