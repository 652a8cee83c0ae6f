"""The events of a scan, as an engine would send them, for tests of the window."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

from instrument.events import (
    Event,
    Geometry,
    Message,
    PointAnnotated,
    PointMeasured,
    PointStarted,
    ReferenceMeasured,
    ScanEnded,
    ScanStarted,
    StateChanged,
)

START = datetime(2026, 3, 2, 9, 0, tzinfo=UTC)
ARTIFACT_PLAN = {0.0: (0.0, 45.0, 90.0, 135.0), 15.0: (0.0, 50.0, 75.0, 105.0, 130.0), 30.0: (0.0, 60.0, 120.0)}


def geometries(
    plan: dict[float, tuple[float, ...]] = ARTIFACT_PLAN, step: int = 5, wavelength: float = 500.0
) -> tuple[Geometry, ...]:
    """Points of a plan, retro-reflection left out."""
    return tuple(
        Geometry(
            wavelength=wavelength, illumination_zenith=illumination, sensor_azimuth=azimuth, sensor_zenith=float(zenith)
        )
        for illumination, azimuths in plan.items()
        for azimuth in azimuths
        for zenith in range(-80, 81, step)
        if not (azimuth == 0 and abs(zenith - illumination) < 5) and not (illumination == 0 and zenith == 0)
    )


def shape(geometry: Geometry) -> float:
    """Something like the reflectance factor of the artifact: dark at grazing angles."""
    return 0.22 + 0.2 * math.cos(math.radians(geometry.sensor_zenith - 0.3 * geometry.illumination_zenith)) ** 2


def started(points: tuple[Geometry, ...], **more: object) -> ScanStarted:
    """The event that begins a scan."""
    fields = {"time": START, "run_dir": "runs/demo", "title": "Artifact", "points": points, "duration_s": 8640.0}
    return ScanStarted.model_validate(fields | more)


def changed(old: str, new: str, reason: str = "", seconds: float = 0.0) -> StateChanged:
    """A change of state."""
    return StateChanged(time=START + timedelta(seconds=seconds), old=old, new=new, reason=reason)


def measured(index: int, points: tuple[Geometry, ...], brf: float, u_brf: float, **more: object) -> PointMeasured:
    """A measured point."""
    fields = {
        "time": START + timedelta(seconds=22.0 * index),
        "index": index,
        "geometry": points[index],
        "brf": brf,
        "u_brf": u_brf,
        "signal": (1.0,) * 9,
        "dark": 1e-3,
        "gain": 1e7,
        "done": index + 1,
        "total": len(points),
        "time_left_s": 22.0 * (len(points) - index - 1),
    }
    return PointMeasured.model_validate(fields | more)


def predicted(index: int, brf: float, u_brf: float, source: str = "twin") -> PointAnnotated:
    """A value of the twin."""
    return PointAnnotated(time=START, index=index, source=source, values={"brf": brf, "u_brf": u_brf})


def preparation(points: tuple[Geometry, ...]) -> Iterator[Event]:
    """From the start to the first point."""
    yield changed("idle", "connecting")
    yield started(points)
    yield Message(time=START, level="info", text="All 9 devices answer.")
    for old, new in (("connecting", "preflight"), ("preflight", "homing"), ("homing", "mounting")):
        yield changed(old, new)
    yield changed("mounting", "referencing")
    for index, azimuth in enumerate((0.0, 45.0, 90.0, 135.0)):
        yield ReferenceMeasured(
            time=START, index=index, sensor_azimuth=azimuth, current=3.1e-8, relative_standard_error=4e-4
        )
    yield changed("referencing", "mounting")


def readings(points: tuple[Geometry, ...], count: int, seed: int = 1) -> Iterator[Event]:
    """Points with readings and predictions; relative uncertainties of 1.3 % and 0.2 %."""
    draw = random.Random(seed)
    previous = "mounting"
    for index in range(count):
        yield changed(previous, "moving", seconds=22.0 * index)
        yield PointStarted(time=START + timedelta(seconds=22.0 * index), index=index, geometry=points[index])
        yield changed("moving", "measuring", seconds=22.0 * index)
        truth = shape(points[index])
        yield predicted(index, truth * (1 + draw.gauss(0, 0.002)), truth * 0.002)
        yield measured(index, points, truth * (1 + draw.gauss(0, 0.013)), truth * 0.013)
        previous = "measuring"


def ending(points: tuple[Geometry, ...], outcome: str = "finished") -> Iterator[Event]:
    """The end of a scan."""
    yield changed("measuring", "finishing")
    yield changed("finishing", outcome)
    yield ScanEnded.model_validate(
        {"time": START + timedelta(hours=2), "outcome": outcome, "done": len(points), "total": len(points)}
    )
