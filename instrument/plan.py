"""What is to be measured: the ordered points that a plan means, and those of them that cannot be measured.

A plan is grids and tables of points in sequence (:mod:`instrument.plan_forms`); a CSV table alone is a plan too.
Angles in degree, wavelengths in nm (data contract, section Angles and frames).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from instrument.angles import FloatArray, angle_between, direction
from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import Arms, Facility
from instrument.forms import read_form
from instrument.plan_forms import Direction, PlanForm, Table
from instrument.plan_points import MOST_POINTS, WAVELENGTH_RANGE, describe, ordered_points
from instrument.run_record import RunRecord

__all__ = [
    "MOST_POINTS",
    "WAVELENGTH_RANGE",
    "Blocked",
    "Direction",
    "Plan",
    "PlanForm",
    "describe",
    "is_shadowed",
    "make_plan",
    "read_plan",
    "read_plan_form",
    "reference_geometries",
    "retroreflection_angle",
]

#: Slack of the rule for blocked points, degree (data contract, section Run file).
SHADOW_SLACK = 1e-6


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
    record
        Who measures what.
    """

    title: str
    points: tuple[Geometry, ...]
    blocked: tuple[Blocked, ...]
    samples: int
    direction: Direction
    source: str
    record: RunRecord = field(default_factory=RunRecord)

    def __len__(self) -> int:
        return len(self.points)


def read_plan_form(path: Path) -> PlanForm:
    """The form of a plan; a CSV table of points is a plan of one part.

    Raises
    ------
    InputError
        Naming the file and every wrong key.
    """
    if path.suffix.lower() == ".csv":
        return PlanForm(version=1, title=path.stem, part=(Table(table=path.name),))
    return read_form(path, PlanForm)


def read_plan(path: Path, facility: Facility) -> Plan:
    """Read ``plan.toml``, or a CSV table of points, for an instrument.

    Raises
    ------
    InputError
        Naming file, part, row and key: unknown keys, a step that leads nowhere, values in another unit, angles
        beyond an arm, a point asked for twice, nothing left to measure.
    """
    return make_plan(read_plan_form(path), facility, str(path), path.parent)


def make_plan(form: PlanForm, facility: Facility, source: str, folder: Path | None = None) -> Plan:
    """Order the points of a form and set aside the blocked ones; errors as :func:`read_plan`.

    Parameters
    ----------
    source
        The file, for messages.
    folder
        Where its tables lie.
    """
    _require_parts(form, source)
    points = ordered_points(form, facility.arms, source, folder)
    reasons = _reasons(points, facility.arms)
    measurable = tuple(point for point, reason in zip(points, reasons, strict=True) if not reason)
    if not measurable:
        raise InputError(f"{source}: all {len(points)} points are blocked ({reasons[0]}); nothing is left to measure")
    blocked = tuple(Blocked(point, reason) for point, reason in zip(points, reasons, strict=True) if reason)
    return Plan(form.title, measurable, blocked, form.samples, form.direction, source, form.record)


def _require_parts(form: PlanForm, source: str) -> None:
    if form.grid is not None and form.part is not None:
        raise InputError(f"{source}: grid: found beside part; expected one of them (a [[part]] may be a grid)")
    if form.grid is None and form.part is None:
        raise InputError(f"{source}: grid: missing; expected at least one [[grid]] or [[part]]")
    if not form.parts:
        raise InputError(f"{source}: grid: none found; expected at least one [[grid]] or [[part]]")


def _reasons(points: list[Geometry], arms: Arms) -> list[str]:
    """Why each point cannot be measured; empty where it can."""
    cone = f"closer than {arms.shadow_half_angle:g} degrees to retro-reflection: the detector head is in the beam"
    reasons = [cone if dark else "" for dark in is_shadowed(points, arms.shadow_half_angle)]
    for box in arms.keep_out:
        ranges = [(name, *getattr(box, name)) for name in ("illumination_zenith", "sensor_azimuth", "sensor_zenith")]
        for index, point in enumerate(points):
            if not reasons[index] and all(low <= getattr(point, name) <= high for name, low, high in ranges):
                reasons[index] = f"where the arms are kept out: {box.name}"
    return reasons


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


def reference_geometries(plan: Plan, facility: Facility) -> list[Geometry]:
    """Every reading of the reference that a plan needs: azimuths of the facility, wavelengths, polarisations."""
    known = facility.reference
    return [
        Geometry(
            wavelength=wavelength,
            polarization=polarization,
            illumination_zenith=known.illumination_zenith,
            sensor_zenith=known.sensor_zenith,
            sensor_azimuth=azimuth,
        )
        for wavelength, polarization in dict.fromkeys((point.wavelength, point.polarization) for point in plan.points)
        for azimuth in known.sensor_azimuth
    ]
