"""How long a move takes. What a plan takes follows from its checked ways (:func:`instrument.safety.check_plan`)."""

from __future__ import annotations

import math

from drivers.interfaces import AxisLimits

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
