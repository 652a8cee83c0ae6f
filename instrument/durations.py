"""How long a plan takes: trapezoidal moves, settling and averaging."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from drivers.interfaces import AxisLimits
from instrument.events import Geometry

if TYPE_CHECKING:
    from instrument.plan import Plan

#: The motorised arms in the order in which a scan moves them.
AXES = ("illumination_zenith", "sensor_azimuth", "sensor_zenith")


def move_time(distance: float, limits: AxisLimits) -> float:
    """Seconds of a move over ``distance`` degree with a trapezoidal (or, when short, triangular) speed profile."""
    length = abs(distance)
    if length == 0:
        return 0.0
    if length < limits.velocity**2 / limits.acceleration:
        return 2 * math.sqrt(length / limits.acceleration)
    return length / limits.velocity + limits.velocity / limits.acceleration


def duration(
    points: Iterable[Geometry],
    limits: Mapping[str, AxisLimits],
    seconds_per_point: float,
    *,
    start: Geometry | None = None,
    together: bool = False,
    seconds_per_move: float = 0.0,
) -> float:
    """Laboratory seconds to measure points in order.

    Parameters
    ----------
    limits
        Speed and acceleration of every axis of :data:`AXES`.
    seconds_per_point
        Averaging, settling and everything else a point takes while the arms stand still.
    start
        Where the arms stand; None: already at the first point.
    together
        True when the arms move at the same time, False when one waits for the other.
    seconds_per_move
        Settling and read-back after each move of an arm.
    """
    total, previous = 0.0, start
    for point in points:
        if previous is not None:
            moves = [
                move_time(distance, limits[axis]) + seconds_per_move
                for axis in AXES
                if (distance := getattr(point, axis) - getattr(previous, axis)) != 0
            ]
            total += max(moves, default=0.0) if together else sum(moves)
        total += seconds_per_point
        previous = point
    return total


def estimate_duration(
    plan: Plan,
    limits: Mapping[str, AxisLimits],
    seconds_per_point: float,
    *,
    start: Geometry | None = None,
    together: bool = False,
    seconds_per_move: float = 0.0,
) -> float:
    """Laboratory seconds that a whole plan takes; parameters as :func:`duration`."""
    return duration(
        plan.points,
        limits,
        seconds_per_point,
        start=start,
        together=together,
        seconds_per_move=seconds_per_move,
    )
