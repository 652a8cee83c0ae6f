"""What a plan means in numbers: points, blocked ones, planes, duration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from drivers.configuration import read_devices
from drivers.interfaces import AxisLimits
from instrument.durations import AXES
from instrument.errors import InputError, SafetyError
from instrument.events import Geometry
from instrument.facility import STAGES, UNKNOWN_FACILITY, Facility, read_facility
from instrument.forecast import USUAL_SAMPLE, Forecast, Pace, Step, forecast
from instrument.outlook import laboratory_on_paper
from instrument.plan import Plan, describe, read_plan, reference_geometries
from instrument.safety import CheckedPlan, Envelope, Pose, check_plan
from instrument.settings import ScanSettings
from instrument.stages import check_stages
from instrument.turning import position_at_start

#: Where arms stand once they are homed.
HOME = Pose(0.0, 0.0, 0.0)


class Speeds(NamedTuple):
    """Of every axis where no devices are named: degree/s and degree/s^2."""

    velocity: float
    acceleration: float


def summarise(
    plan_file: Path, facility_file: Path | None, devices_file: Path | None, speeds: Speeds, settings: ScanSettings
) -> tuple[Plan, dict[str, Any]]:
    """Read a plan, check every point and every way between points, and go through the scan to tell how long it takes.

    Parameters
    ----------
    devices_file
        Says how fast axes move and how long the meter averages.
    speeds
        Of the axes where there is no such file.
    settings
        How the scan is carried out.

    Returns
    -------
    plan, dict
        The plan, and what ``goniotwin plan --json`` writes.

    Raises
    ------
    InputError, ConfigurationError
        If a file is wrong, or the arms cannot reach a point.
    """
    facility = read_facility(facility_file) if facility_file is not None else UNKNOWN_FACILITY
    plan = read_plan(plan_file, facility)
    pace = pace_on_paper(devices_file, facility, speeds, settings, plan.samples)
    ways, ahead = go_through(plan, facility, pace)
    return plan, {
        "title": plan.title,
        "record": plan.record.said(),
        "points": [geometry.model_dump() for geometry in plan.points],
        "blocked": [{"geometry": b.geometry.model_dump(), "reason": b.reason} for b in plan.blocked],
        "samples": plan.samples,
        "scan_direction": plan.direction,
        "reference_readings": ahead.references,
        "detours": ways.detours,
        "steps": [_step(step) for step in ahead.steps],
        "preparation_s": ahead.preparation,
        "moving_time_s": ahead.moving,
        "duration_s": ahead.duration,
    }


def go_through(plan: Plan, facility: Facility, pace: Pace) -> tuple[CheckedPlan, Forecast]:
    """Check every point of a plan and every way between points, and go through the scan in thought.

    Raises
    ------
    InputError
        If the arms cannot reach a point.
    """
    references = list(enumerate(reference_geometries(plan, facility)))
    points = list(enumerate(plan.points))
    named = [("reference", geometry) for _, geometry in references]
    named += [(f"point {index}", geometry) for index, geometry in points]
    try:
        envelope = Envelope.of(facility.arms, pace.speeds)
        ways = check_plan(named, HOME, envelope)
        check_stages((geometry for _, geometry in named), pace.speeds, facility.arms)
        ahead = forecast(
            points,
            references,
            references,
            envelope,
            pace,
            start=HOME,
            to_home=len(pace.speeds),
            repeat_minutes=facility.reference.repeat_minutes,
            turned=position_at_start(plan.points),
        )
    except (InputError, SafetyError) as error:
        raise InputError(f"{plan.source}: {error}") from None
    return ways, ahead


def pace_on_paper(
    devices: Path | None, facility: Facility, speeds: Speeds, settings: ScanSettings, samples: int
) -> Pace:
    """What things take, by ``devices.toml``, or with usual devices whose axes have these speeds."""
    if devices is not None:
        return Pace.of(laboratory_on_paper(read_devices(devices)), settings, samples)
    travel = {axis: getattr(facility.arms, axis) for axis in (*AXES, *STAGES)}
    limits = {axis: AxisLimits(ends[0], ends[1], *speeds) for axis, ends in travel.items() if ends is not None}
    dark = settings.acquisition.dark_samples
    return Pace(settings, burst=samples * USUAL_SAMPLE, dark=dark * USUAL_SAMPLE, speeds=limits)


def _step(step: Step) -> dict[str, Any]:
    return {
        "kind": step.kind,
        "index": step.index,
        "begin_s": round(step.begin, 2),
        "end_s": round(step.end, 2),
        "moves": [[leg.axis, leg.start, leg.target] for leg in step.legs],
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
        console.print("Points, in order, with the way to each and when it is measured:")
        for step in summary["steps"]:
            console.print(f"  {_clock(step['end_s'])}  {_what(plan, step)}{_way(step['moves'])}", soft_wrap=True)
    detours = f" (ways around the shadow cone or what is kept out: {summary['detours']})" if summary["detours"] else ""
    console.print(
        f"Takes about {spoken(summary['duration_s'])}: {len(plan.points)} points and"
        f" {summary['reference_readings']} reference readings of {plan.samples} samples;"
        f" {spoken(summary['moving_time_s'])} of it are moves{detours}."
    )


def _what(plan: Plan, step: Mapping[str, Any]) -> str:
    if step["kind"] == "hands":
        return "the sample is changed"
    if step["kind"] == "reference":
        return f"reference {step['index'] + 1}"
    return f"{step['index']:5d}  {describe(plan.points[step['index']])}"


def _way(moves: Sequence[Sequence[Any]]) -> str:
    legs = (f"{axis.replace('_', ' ')} {start:g} > {target:g}" for axis, start, target in moves)
    return f"  [{'; '.join(legs)}]".replace("[", "\\[") if moves else ""


def _clock(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 3600:d}:{whole % 3600 // 60:02d}:{whole % 60:02d}"


def spoken(seconds: float) -> str:
    """A duration in hours and minutes, or minutes and seconds."""
    whole = round(seconds)
    hours, minutes = whole // 3600, whole % 3600 // 60
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {whole % 60:02d} s"


def _planes(plan: Plan) -> Table:
    every = [*plan.points, *(b.geometry for b in plan.blocked)]
    turned = ["sample rotation"] if any(p.sample_rotation for p in every) else []
    polarised = ["polarisation"] if any(p.polarization for p in every) else []
    heads = ("wavelength / nm", *polarised, *turned, "illumination zenith", "sensor azimuth")
    table = Table(*heads, "sensor zenith", "points", "blocked")

    def plane(p: Geometry) -> tuple[str, ...]:
        light = [p.polarization or ""] if polarised else []
        rotation = [f"{p.sample_rotation:g}"] if turned else []
        return (f"{p.wavelength:g}", *light, *rotation, f"{p.illumination_zenith:g}", f"{p.sensor_azimuth:g}")

    blocked = Counter(plane(b.geometry) for b in plan.blocked)
    counts = Counter(plane(p) for p in plan.points)
    for key in counts | blocked:
        zeniths = [p.sensor_zenith for p in plan.points if plane(p) == key]
        span = f"{min(zeniths):g} to {max(zeniths):g}" if zeniths else "none"
        table.add_row(*key, span, str(counts[key]), str(blocked[key]))
    return table
