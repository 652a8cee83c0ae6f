"""What is to be measured: the form ``plan.toml`` and the ordered points it means.

A plan is one or more grids. Points stand in the order in which they are measured: grids as in the file,
inside a grid wavelength, illumination zenith, sensor azimuth, sensor zenith, the last one running fastest.
Angles in degree, wavelengths in nm (data contract, section Angles and frames).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from instrument.angles import FloatArray, angle_between, direction
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import Arms, Facility
from instrument.forms import Form, read_form
from instrument.plan_units import check_units

__all__ = [
    "Blocked",
    "Plan",
    "PlanForm",
    "describe",
    "is_shadowed",
    "make_plan",
    "read_plan",
    "reference_geometries",
    "retroreflection_angle",
]

#: Slack of the rule for blocked points, degree (data contract, section Run file).
SHADOW_SLACK = 1e-6
#: Wavelengths that any instrument of this kind can be asked for, nm.
WAVELENGTH_RANGE = (200.0, 3000.0)
#: More than an instrument of this kind measures in a year.
MOST_POINTS = 1_000_000
#: Angles are kept to this many decimals, so that ``start + 3 * step`` reads as it was meant.
_DECIMALS = 9

Direction = Literal["unidirectional", "serpentine"]


class Steps(Form):
    """Equally spaced angles from ``start`` to ``stop``, both included."""

    start: float
    stop: float
    step: float

    def values(self) -> tuple[float, ...]:
        """The angles; ValueError when ``step`` does not lead from ``start`` to ``stop``."""
        span = self.stop - self.start
        if self.step == 0:
            raise ValueError("step is 0; expected the distance between neighbouring angles")
        if span * self.step < 0:
            raise ValueError(
                f"step {self.step:g} has the wrong sign: it leads away from stop ({self.start:g} to {self.stop:g});"
                f" expected {-self.step:g}"
            )
        count = round(span / self.step)
        if abs(span - count * self.step) > 1e-6 * abs(self.step):
            raise ValueError(f"steps of {self.step:g} from {self.start:g} do not meet stop ({self.stop:g})")
        if count >= 100_000:
            raise ValueError(f"{count + 1} angles between {self.start:g} and {self.stop:g}; expected at most 100000")
        return tuple(_tidy(self.start + i * self.step) for i in range(count + 1))

    def numbers(self) -> tuple[float, ...]:
        """The numbers as they were written, for a guess at their unit."""
        return (self.start, self.stop, self.step)


Angles = Steps | tuple[float, ...]


class Grid(Form):
    """One ``[[grid]]`` of a plan: every combination of its values."""

    wavelength: tuple[float, ...]
    illumination_zenith: Angles
    illumination_azimuth: float = 0.0
    sensor_azimuth: Angles
    sensor_zenith: Angles


class PlanForm(Form):
    """Keys of ``plan.toml``.

    ``angle_unit`` may only be ``degree``; a plan that says so is never suspected of holding radians.
    """

    version: Literal[1]
    title: str = ""
    samples: Annotated[int, Field(ge=1, le=10_000, strict=True)] = 9
    direction: Direction = "unidirectional"
    angle_unit: Literal["degree"] | None = None
    grid: tuple[Grid, ...]


@dataclass(frozen=True)
class Blocked:
    """A point of a plan that cannot be measured."""

    geometry: Geometry
    reason: str


@dataclass(frozen=True)
class Plan:
    """Points in the order in which they are measured, and those that are blocked.

    Attributes
    ----------
    samples
        Detector readings a point.
    direction
        ``unidirectional``, or ``serpentine`` when every other zenith sweep is reversed.
    source
        The file, for messages.
    """

    title: str
    points: tuple[Geometry, ...]
    blocked: tuple[Blocked, ...]
    samples: int
    direction: Direction
    source: str

    def __len__(self) -> int:
        return len(self.points)


def read_plan(path: Path, facility: Facility) -> Plan:
    """Read ``plan.toml`` for an instrument.

    Raises
    ------
    InputError
        Naming file, grid and key: unknown keys, a step that leads nowhere, values in another unit, angles
        beyond an arm, a point asked for twice, nothing left to measure.
    """
    return make_plan(read_form(path, PlanForm), facility, str(path))


def make_plan(form: PlanForm, facility: Facility, source: str) -> Plan:
    """Order the points of a form and set aside the blocked ones; errors as :func:`read_plan`."""
    if not form.grid:
        raise InputError(f"{source}: grid: none found; expected at least one [[grid]]")
    points: list[Geometry] = []
    sweeps = 0
    for number, grid in enumerate(form.grid, start=1):
        where = f"{source}: grid {number}"
        values = _values(where, grid)
        _check_values(where, grid, values, facility.arms, guess=form.angle_unit is None)
        wanted = len(points) + math.prod(map(len, values.values()))
        if wanted > MOST_POINTS:
            raise InputError(f"{where}: {wanted} points up to here; expected at most {MOST_POINTS} (a step too small?)")
        for sweep in _sweeps(grid, values):
            reverse = form.direction == "serpentine" and sweeps % 2 == 1
            points.extend(reversed(sweep) if reverse else sweep)
            sweeps += 1
    _check_duplicates(source, points)
    shadowed = is_shadowed(points, facility.arms.shadow_half_angle)
    reason = (
        f"closer than {facility.arms.shadow_half_angle:g} degrees to retro-reflection: the detector head is in the beam"
    )
    measurable = tuple(point for point, dark in zip(points, shadowed, strict=True) if not dark)
    if not measurable:
        raise InputError(f"{source}: all {len(points)} points are blocked ({reason}); nothing is left to measure")
    blocked = tuple(Blocked(point, reason) for point, dark in zip(points, shadowed, strict=True) if dark)
    return Plan(form.title, measurable, blocked, form.samples, form.direction, source)


def retroreflection_angle(points: list[Geometry] | tuple[Geometry, ...]) -> FloatArray:
    """Angle between illumination and sensor direction, degree, shape (point,)."""
    illumination = direction([p.illumination_zenith for p in points], [p.illumination_azimuth for p in points])
    sensor = direction([p.sensor_zenith for p in points], [p.sensor_azimuth for p in points])
    return angle_between(illumination, sensor)


def is_shadowed(points: list[Geometry] | tuple[Geometry, ...], half_angle: float) -> list[bool]:
    """Whether the detector head blocks the beam at each point (data contract, section Run file)."""
    if not points:
        return []
    return [bool(dark) for dark in retroreflection_angle(points) < half_angle - SHADOW_SLACK]


def _tidy(value: float) -> float:
    return float(np.round(value, _DECIMALS)) + 0.0  # + 0.0 turns -0.0 into 0.0


def _values(where: str, grid: Grid) -> dict[str, tuple[float, ...]]:
    result = {}
    for key in ("wavelength", "illumination_zenith", "sensor_azimuth", "sensor_zenith"):
        given = getattr(grid, key)
        try:
            values = given.values() if isinstance(given, Steps) else tuple(_tidy(value) for value in given)
        except ValueError as error:
            raise InputError(f"{where}: {key}: {error}") from None
        if not values:
            raise InputError(f"{where}: {key}: no value; expected at least one")
        result[key] = values
    result["illumination_azimuth"] = (_tidy(grid.illumination_azimuth),)
    return result


def _check_values(where: str, grid: Grid, values: dict[str, tuple[float, ...]], arms: Arms, *, guess: bool) -> None:
    lower, upper = WAVELENGTH_RANGE
    for key, axis_values in values.items():
        given = getattr(grid, key)
        written = given.numbers() if isinstance(given, Steps) else axis_values
        if guess or key == "wavelength":
            check_units(where, key, written)
    for wavelength in values["wavelength"]:
        if not lower <= wavelength <= upper:
            raise InputError(f"{where}: wavelength: found {wavelength:g}; expected {lower:g} to {upper:g} nm")
    ranges = {
        "illumination_zenith": arms.illumination_zenith,
        "sensor_azimuth": arms.sensor_azimuth,
        "sensor_zenith": arms.sensor_zenith,
        "illumination_azimuth": (-360.0, 360.0),
    }
    for axis, (low, high) in ranges.items():
        beyond = [value for value in values[axis] if not low <= value <= high]
        if beyond:
            raise InputError(
                f"{where}: {axis}: found {beyond[0]:g} degrees, beyond the arm; expected {low:g} to {high:g}"
            )


def _sweeps(grid: Grid, values: dict[str, tuple[float, ...]]) -> Iterator[list[Geometry]]:
    for wavelength in values["wavelength"]:
        for illumination_zenith in values["illumination_zenith"]:
            for sensor_azimuth in values["sensor_azimuth"]:
                yield [
                    Geometry(
                        wavelength=wavelength,
                        illumination_zenith=illumination_zenith,
                        illumination_azimuth=values["illumination_azimuth"][0],
                        sensor_zenith=sensor_zenith,
                        sensor_azimuth=sensor_azimuth,
                    )
                    for sensor_zenith in values["sensor_zenith"]
                ]


def _check_duplicates(source: str, points: list[Geometry]) -> None:
    seen: set[Geometry] = set()
    for point in points:
        if point in seen:
            raise InputError(f"{source}: a point stands twice in the plan: {describe(point)}")
        seen.add(point)


def reference_geometries(plan: Plan, facility: Facility) -> list[Geometry]:
    """Every reading of the reference that a plan needs: each azimuth of the facility at each wavelength."""
    known = facility.reference
    return [
        Geometry(
            wavelength=wavelength,
            illumination_zenith=known.illumination_zenith,
            sensor_zenith=known.sensor_zenith,
            sensor_azimuth=azimuth,
        )
        for wavelength in dict.fromkeys(point.wavelength for point in plan.points)
        for azimuth in known.sensor_azimuth
    ]


def describe(point: Geometry) -> str:
    """A geometry in words, for messages."""
    azimuth = f", illumination azimuth {point.illumination_azimuth:g}" if point.illumination_azimuth else ""
    return (
        f"{point.wavelength:g} nm, illumination zenith {point.illumination_zenith:g}{azimuth},"
        f" sensor azimuth {point.sensor_azimuth:g}, sensor zenith {point.sensor_zenith:g}"
    )
