"""What is true in a case: optics, laws of the light along the scan, electronics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from instrument.angles import FloatArray
from instrument.plan import Plan
from sim_fixtures.examples.coupon import PACE_S, Points
from sim_fixtures.reality import Imperfections


@dataclass(frozen=True)
class Moments:
    """Where and when readings are taken, shape (reading,) each: the points of a scan, or the reference's before it.

    Attributes
    ----------
    illumination_zenith, sensor_zenith, sensor_azimuth
        Commanded, degree.
    time_s
        Since the first point of the scan; negative for the reference.
    travel
        Direction in which the sensor zenith ran, 1 or -1; 0 where it did not.
    order
        Number of the point; -1 for the reference.
    """

    illumination_zenith: FloatArray
    sensor_zenith: FloatArray
    sensor_azimuth: FloatArray
    time_s: FloatArray
    travel: FloatArray
    order: FloatArray

    @property
    def duration_s(self) -> float:
        """Of the scan up to the last of these."""
        return float(max(self.time_s[-1], PACE_S))

    @property
    def progress(self) -> FloatArray:
        """0 at the first point and before it, 1 at the last."""
        return np.asarray(np.maximum(self.time_s, 0.0) / self.duration_s)

    @property
    def retro_angle(self) -> FloatArray:
        """Between illumination and sensor direction, degree."""
        i, s, a = (np.deg2rad(x) for x in (self.illumination_zenith, self.sensor_zenith, self.sensor_azimuth))
        cosine = np.cos(i) * np.cos(s) + np.sin(i) * np.sin(s) * np.cos(a)
        return np.asarray(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


#: Of light: flux at the moments, over that of an ideal sample at the reference geometry, to what it is in truth.
Law = Callable[[Moments, FloatArray], FloatArray]


@dataclass(frozen=True)
class Electronics:
    """How light becomes voltage.

    Attributes
    ----------
    dead_time
        Of a counting detector, in units of the mean time between photons at the reference reading.
    lag
        Time between two raw samples over the time constant of the filter before them; infinite for none.
    gain_error
        Relative, of the higher range.
    offset_v
        Added at the output while the shutter is open.
    """

    dead_time: float = 0.0
    lag: float = np.inf
    gain_error: float = 0.0
    offset_v: float = 0.0


@dataclass(frozen=True)
class World:
    """The truth behind a run.

    Attributes
    ----------
    optics
        Errors of instrument and sample.
    backlash_deg
        Play of the sensor zenith.
    laws
        Applied to the flux in this order.
    electronics
        Of the detector.
    reference_scale
        Reading of the reference over what was assumed.
    """

    optics: Imperfections = field(default_factory=Imperfections)
    backlash_deg: float = 0.0
    laws: tuple[Law, ...] = ()
    electronics: Electronics = field(default_factory=Electronics)
    reference_scale: float = 1.0

    def with_optics(self, **changes: Any) -> World:
        """Errors of instrument and sample, in place of the present ones."""
        return replace(self, optics=replace(self.optics, **changes))

    def with_shape(self, **changes: Any) -> World:
        """Errors of the artifact's shape."""
        return self.with_optics(shape=replace(self.optics.shape, **changes))

    def with_coating(self, **changes: Any) -> World:
        """Errors of the artifact's coating."""
        return self.with_optics(coating=replace(self.optics.coating, **changes))

    def with_arm(self, **changes: Any) -> World:
        """Errors of beam and sensor."""
        return self.with_optics(optics=replace(self.optics.optics, **changes))

    def with_electronics(self, **changes: Any) -> World:
        """Errors of the detector."""
        return replace(self, electronics=replace(self.electronics, **changes))

    def with_law(self, law: Law) -> World:
        """A further law of the light."""
        return replace(self, laws=(*self.laws, law))


def moments_of(plan: Plan) -> Moments:
    """The points of a plan, at the pace of the paper's instrument."""
    points = Points.of(plan)
    zenith = points.sensor_zenith
    slices = slice_numbers(points)
    travel = np.zeros(len(zenith))
    for number in range(int(slices[-1]) + 1):
        mine = np.flatnonzero(slices == number)
        travel[mine] = np.sign(zenith[mine[-1]] - zenith[mine[0]])
    order = np.arange(len(zenith), dtype=float)
    return Moments(points.illumination_zenith, zenith, points.sensor_azimuth, order * PACE_S, travel, order)


def slice_numbers(points: Points | Moments) -> FloatArray:
    """Number of the sweep that every point belongs to, shape (point,): one illumination, one sensor azimuth."""
    change = (np.diff(points.illumination_zenith) != 0) | (np.diff(points.sensor_azimuth) != 0)
    return np.concatenate([[0.0], np.cumsum(change)])
