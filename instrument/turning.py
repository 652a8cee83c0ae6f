"""The illumination azimuth: set by hands at a stage under the sample, since the illumination arm keeps to its plane.

A plan's angles are those of the sample's frame. The stage turns the sample by minus the azimuth; the arms then stand in
the laboratory where the sample sees them under the angles of the plan.
"""

from __future__ import annotations

from collections.abc import Iterable

from instrument.errors import InputError
from instrument.events import Geometry
from instrument.plan import describe
from instrument.prompts import Prompt


def require_turnable(geometry: Geometry, travel: tuple[float, float] | None, name: str = "") -> None:
    """Refuse an illumination azimuth that no stage can give.

    Parameters
    ----------
    travel
        Of the manual stage (``arms.illumination_azimuth`` of the facility), degree; None where there is none.

    Raises
    ------
    InputError
    """
    azimuth = geometry.illumination_azimuth
    at = f"{name}: {describe(geometry)}" if name else describe(geometry)
    if azimuth == 0.0:
        return
    if travel is None:
        raise InputError(
            f"{at}: the illumination arm moves in the plane of azimuth 0 only; turn the sample and plan sensor azimuths"
            " relative to it, or state the manual stage of the instrument (arms.illumination_azimuth of its facility)"
        )
    if not travel[0] <= azimuth <= travel[1]:
        raise InputError(
            f"{at}: illumination_azimuth: beyond the manual stage; expected {travel[0]:g} to {travel[1]:g}"
        )


def driven(geometry: Geometry) -> tuple[float, float, float]:
    """Where illumination zenith, sensor azimuth and sensor zenith arms stand in the laboratory, degree.

    The azimuth of the sensor arm lies within 0 to 180 degrees where the sample is turned: a direction beyond is reached
    from the other side, at the opposite zenith.
    """
    if geometry.illumination_azimuth == 0.0:
        return geometry.illumination_zenith, geometry.sensor_azimuth, geometry.sensor_zenith
    azimuth, zenith = (geometry.sensor_azimuth - geometry.illumination_azimuth) % 360.0, geometry.sensor_zenith
    if azimuth > 180.0:
        azimuth, zenith = azimuth - 180.0, -zenith
    return geometry.illumination_zenith, azimuth, zenith


def position_at_start(points: Iterable[Geometry]) -> float | None:
    """Where the stage stands: at 0 for a plan without any other azimuth; else nobody knows, and a person sets it."""
    return None if any(point.illumination_azimuth for point in points) else 0.0


def turn_prompt(azimuth: float) -> Prompt:
    """The step that sets an illumination azimuth (degree)."""
    return Prompt(
        key=f"turn:{azimuth:g}",
        title=f"Set the illumination azimuth to {azimuth:g} degrees at the manual stage",
        text=f"The sample turns by {-azimuth:+g} degrees from its mark, seen from above against the clock.",
    )
