"""The uncertainty budget of the measured BRF, evaluated at every point (paper, Table II).

Every row is a relative standard uncertainty (k = 1). A pair runs from the best to the worst geometry, as
a + (b - a) r with r = (|sensor zenith|/80)^2; r = |sensor zenith|/80 for detector linearity and r = |illumination
zenith|/60 for the illumination zenith (data contract, section Facility). A row that ``facility.toml`` leaves to the
samples or to the slope of what is measured has its value from there (``docs/measurement.md``).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from instrument.angles import FloatArray
from instrument.facility import Budget

#: Rows of the budget in the order of Table II, and the component of the run file each becomes.
COMPONENTS = {
    "measurement_noise": "u_brf_noise",
    "instrument_stability": "u_brf_stability",
    "wavelength": "u_brf_wavelength",
    "straylight": "u_brf_straylight",
    "detector_linearity": "u_brf_linearity",
    "beam_and_placement": "u_brf_placement",
    "illumination_zenith": "u_brf_illumination_zenith",
    "sensor_zenith": "u_brf_sensor_zenith",
    "sensor_azimuth": "u_brf_sensor_azimuth",
    "surface_level": "u_brf_surface_level",
    "polarization": "u_brf_polarization",
    "reference_material": "u_brf_reference",
}
#: Where the second number of a pair holds, degree.
WORST_SENSOR_ZENITH = 80.0
WORST_ILLUMINATION_ZENITH = 60.0


def point_budget(
    budget: Budget,
    illumination_zenith: ArrayLike,
    sensor_zenith: ArrayLike,
    brf: ArrayLike,
    found: Mapping[str, ArrayLike] | None = None,
) -> dict[str, FloatArray]:
    """Absolute standard uncertainty of every component at every point.

    Parameters
    ----------
    budget
        Relative uncertainties.
    illumination_zenith, sensor_zenith
        Degree, shape (point,).
    brf
        Bidirectional reflectance factor, shape (point,).
    found
        Absolute standard uncertainties, shape (point,), of rows that the budget leaves to the samples or to the
        slope; such a row counts as 0 where it is not among them.

    Returns
    -------
    dict
        Arrays of shape (point,) by the names of the run file, in the order of Table II.
    """
    illumination, sensor, factor = np.broadcast_arrays(
        *(np.asarray(values, dtype=float) for values in (illumination_zenith, sensor_zenith, brf))
    )
    obliquity = np.abs(sensor) / WORST_SENSOR_ZENITH
    progress = {
        "detector_linearity": obliquity,
        "illumination_zenith": np.abs(illumination) / WORST_ILLUMINATION_ZENITH,
    }
    result = {}
    for row, name in COMPONENTS.items():
        given = getattr(budget, row)
        if isinstance(given, str):
            result[name] = np.abs(np.broadcast_to((found or {}).get(row, 0.0), factor.shape)).astype(float)
            continue
        best, worst = given if isinstance(given, tuple) else (given, given)
        result[name] = (best + (worst - best) * progress.get(row, obliquity**2)) * np.abs(factor)
    return result


def combined(components: Mapping[str, ArrayLike]) -> FloatArray:
    """Combined standard uncertainty of independent components: root of the sum of squares, shape (point,)."""
    return np.asarray(np.sqrt(sum(np.square(np.asarray(values, dtype=float)) for values in components.values())))
