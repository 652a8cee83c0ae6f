"""Light behind a polariser on the illumination arm.

The source is partly polarised in the plane of incidence. Of light polarised along an azimuth, a direction sees the more
the closer its own plane lies to that azimuth: the response goes with cos(2 (sensor azimuth - azimuth of the light))
sin^2(sensor zenith), and what is known as the effect ``polarization`` of an instrument without a polariser is the mean
over the two halves of its light.
"""

from __future__ import annotations

import math

#: Degree of polarisation of the source, and what the polariser lets through of light along its axis.
DEGREE, TRANSMISSION = 0.2, 0.9
#: Amplitude of the response to fully polarised light of a sample that nothing else is said of.
USUAL_AMPLITUDE = 0.01


def behind_polarizer(angle: float, sensor_zenith: float, sensor_azimuth: float, amplitude: float) -> float:
    """What is detected with the polariser, over what an insensitive detector reads without it.

    Parameters
    ----------
    angle
        Of the polariser's axis from the plane of incidence, degree: 0 p, 90 s.
    sensor_zenith, sensor_azimuth
        Degree.
    amplitude
        Of the response to fully polarised light.
    """
    passed = TRANSMISSION * 0.5 * (1.0 + DEGREE * math.cos(2.0 * math.radians(angle)))
    return passed * response(amplitude, sensor_zenith, sensor_azimuth - angle)


def response(amplitude: float, sensor_zenith: float, azimuth: float) -> float:
    """Response to light polarised along ``azimuth`` (degree) from the plane of the sensor; 1 for no such effect."""
    return 1.0 + amplitude * math.cos(2.0 * math.radians(azimuth)) * math.sin(math.radians(sensor_zenith)) ** 2
