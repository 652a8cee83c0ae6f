"""What ``facility.toml`` may say of a row of the budget besides a number: where its value comes from, how its errors
belong together, and how well it is known.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from instrument.forms import Form

#: The standard error of the samples themselves, in place of a number.
FromSamples = Literal["samples"]
#: Response of the reading to the angle, times the angle's standard uncertainty: with the flux that the commanded
#: geometry is normalised with (``slope``), or of the reflectance factor alone, as the paper has it (``brf-slope``).
FromSlope = Literal["slope", "brf-slope"]
#: How the errors of a row belong together over the points of a run.
Correlation = Literal["random", "systematic"]
Freedom = Annotated[float, Field(gt=0)]


class Correlations(Form):
    """Correlation of a row's errors over the points, where it is not what the budget takes it to be."""

    measurement_noise: Correlation | None = None
    instrument_stability: Correlation | None = None
    wavelength: Correlation | None = None
    straylight: Correlation | None = None
    detector_linearity: Correlation | None = None
    beam_and_placement: Correlation | None = None
    illumination_zenith: Correlation | None = None
    sensor_zenith: Correlation | None = None
    sensor_azimuth: Correlation | None = None
    surface_level: Correlation | None = None
    polarization: Correlation | None = None
    reference_material: Correlation | None = None


class DegreesOfFreedom(Form):
    """Degrees of freedom of a row's standard uncertainty; without a number it counts as known exactly."""

    measurement_noise: Freedom | None = None
    instrument_stability: Freedom | None = None
    wavelength: Freedom | None = None
    straylight: Freedom | None = None
    detector_linearity: Freedom | None = None
    beam_and_placement: Freedom | None = None
    illumination_zenith: Freedom | None = None
    sensor_zenith: Freedom | None = None
    sensor_azimuth: Freedom | None = None
    surface_level: Freedom | None = None
    polarization: Freedom | None = None
    reference_material: Freedom | None = None
