"""Bundles of rays: the beam and what the sensor sees, in one form.

A bundle is a disc (or a square) about a centre, joined by rays to something far away: nothing (parallel rays), a
second disc at a finite distance (collecting mirror, point source), or a normal distribution of directions
(divergence). The beam carries an irradiance over its disc, the sensor a weight that integrates to one, so that a
reading is the same integral read from either end: rays may start at the beam and be joined to the sensor, or the
other way round.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from instrument.angles import FloatArray, direction
from instrument.errors import InputError
from instrument.facility import Beam, Sensor

#: How a bundle continues beyond its disc.
PARALLEL: Final = 0
FAR_DISC: Final = 1
DIRECTIONS: Final = 2

#: Shape of a bundle's cross-section.
DISC: Final = 0
SQUARE: Final = 1

#: Rows of :attr:`Bundle.frame`.
AXIS: Final = 0
ACROSS: Final = 1  # two unit vectors normal to the axis
NORMAL: Final = 3
IN_PLANE: Final = 4  # two unit vectors in the plane of the disc


class Bundle(NamedTuple):
    """Rays through a disc; lengths in mm, a form that compiled code takes as it is.

    Attributes
    ----------
    centre
        Centre of the disc, shape (3,).
    frame
        Unit vectors, shape (6, 3): axis (away from the sample), two across it, normal of the disc, two in its plane.
    shape, extent
        Of the disc: its radius, or half the side of a square; infinite for an unbounded beam.
    waist
        Where the weight has fallen to exp(-2); 0 for a uniform one.
    density
        Weight in the middle: irradiance of a beam, one over the area for a sensor.
    far, far_radius, far_distance, spread_rad
        What the rays come from; the spread is the standard deviation about each of the two transverse axes.
    """

    centre: FloatArray
    frame: FloatArray
    shape: int
    extent: float
    waist: float
    density: float
    far: int
    far_radius: float
    far_distance: float
    spread_rad: float

    @property
    def total(self) -> float:
        """The weight integrated over the disc."""
        if self.shape == SQUARE:
            return self.density * 4.0 * self.extent**2
        if self.waist == 0.0 or not np.isfinite(self.extent):
            return float(self.density * np.pi * self.extent**2)
        squared = self.waist**2
        return float(self.density * 0.5 * np.pi * squared * -np.expm1(-2.0 * self.extent**2 / squared))


@dataclass(frozen=True)
class Pose:
    """Where the sample lies: laboratory = rotation @ artifact + shift (mm)."""

    rotation: FloatArray
    shift: FloatArray

    @classmethod
    def of(
        cls,
        tilt_x_deg: float = 0.0,
        tilt_y_deg: float = 0.0,
        azimuth_deg: float = 0.0,
        offset_mm: tuple[float, float] = (0.0, 0.0),
        height_mm: float = 0.0,
    ) -> Pose:
        """Turn about z, tilt about the laboratory's x and y axes (right-handed, degree), then move (mm)."""
        x, y, z = np.deg2rad([tilt_x_deg, tilt_y_deg, azimuth_deg])
        about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
        about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
        about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
        return cls(about_x @ about_y @ about_z, np.array([*offset_mm, height_mm], dtype=float))


def seen_from_sample(bundle: Bundle, pose: Pose) -> Bundle:
    """The bundle in the frame of a sample that lies in ``pose``."""
    return bundle._replace(
        centre=np.ascontiguousarray(pose.rotation.T @ (bundle.centre - pose.shift)),
        frame=np.ascontiguousarray(bundle.frame @ pose.rotation),
    )


def beam_bundle(
    beam: Beam,
    zenith: float,
    *,
    azimuth: float = 0.0,
    offset_mm: tuple[float, float] = (0.0, 0.0),
    extra_divergence: float = 0.0,
    source_distance_mm: float | None = None,
) -> Bundle:
    """The beam of a facility, peak irradiance 1 across it.

    Parameters
    ----------
    beam
        Form of the facility.
    zenith, azimuth
        Direction towards the source, degree.
    offset_mm
        Where the axis crosses z = 0.
    extra_divergence
        Added to the facility's divergence, degree; the sum is cut at zero.
    source_distance_mm
        Distance of a point source; None for a beam without one.

    Raises
    ------
    InputError
        For a beam that is neither round nor of a closed form.
    """
    if beam.profile == "image" or beam.diameter_across is not None or beam.radius_1_e2_across is not None:
        raise InputError("beam: the simulated laboratory has round gaussian and uniform beams only")
    unbounded = beam.diameter == "unbounded"
    divergence = max(0.0, beam.divergence + extra_divergence)
    far = FAR_DISC if source_distance_mm is not None else DIRECTIONS if divergence > 0 else PARALLEL
    return Bundle(
        centre=np.array([*offset_mm, 0.0]),
        frame=_frame(zenith, azimuth, horizontal=False),
        shape=DISC,
        extent=np.inf if beam.diameter == "unbounded" else beam.diameter / 2,
        waist=float(beam.radius_1_e2 or 0.0) if beam.profile == "gaussian" and not unbounded else 0.0,
        density=1.0,
        far=far,
        far_radius=0.0,
        far_distance=source_distance_mm or 0.0,
        spread_rad=float(np.deg2rad(divergence)),
    )


def sensor_bundle(sensor: Sensor, zenith: float, azimuth: float) -> Bundle:
    """What a facility's sensor sees from a direction (degree): target disc and collecting mirror.

    Raises
    ------
    InputError
        If it has a field stop.
    """
    if sensor.field_stop_diameter is not None:
        raise InputError("sensor.field_stop_diameter: the simulated laboratory has no field stop")
    radius = sensor.target_diameter / 2
    return Bundle(
        centre=np.zeros(3),
        frame=_frame(zenith, azimuth, horizontal=sensor.target_shape == "horizontal_disc"),
        shape=DISC,
        extent=radius,
        waist=0.0,
        density=float(1.0 / (np.pi * radius**2)),
        far=FAR_DISC if sensor.mirror_diameter > 0 else PARALLEL,
        far_radius=sensor.mirror_diameter / 2,
        far_distance=sensor.mirror_distance,
        spread_rad=0.0,
    )


def square_sensor_bundle(side: float, zenith: float, azimuth: float) -> Bundle:
    """Parallel rays over a horizontal square target about the origin, side in mm."""
    horizontal = _frame(zenith, azimuth, horizontal=True)
    horizontal[NORMAL:] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    return Bundle(np.zeros(3), horizontal, SQUARE, side / 2, 0.0, 1.0 / side**2, PARALLEL, 0.0, 0.0, 0.0)


def _frame(zenith: float, azimuth: float, *, horizontal: bool) -> FloatArray:
    axis = direction(zenith, azimuth)
    across = direction(zenith + 90.0, azimuth)
    other = np.cross(axis, across)
    if not horizontal:
        return np.array([axis, across, other, axis, across, other])
    cosine, sine = np.cos(np.deg2rad(azimuth)), np.sin(np.deg2rad(azimuth))
    return np.array([axis, across, other, [0, 0, 1], [cosine, sine, 0], [-sine, cosine, 0]])
