"""Is this a run of this sample at all? What no effect of the library can explain is said before any is fitted."""

from __future__ import annotations

import numpy as np

from instrument.angles import FloatArray
from instrument.errors import InputError
from twin.diagnosis.observation import Observation
from twin.material import Material

#: Logarithm of the median ratio beyond which a run is not of this sample, and beyond which a flat coupon is suspected.
_IMPOSSIBLE, _SUSPICIOUS = 0.5, 0.15
#: A run is taken for the coupon if its readings are so many times closer to the coupon's.
_CLOSER = 3.0


def check_plausible(run: Observation, nominal: FloatArray, coupon: FloatArray | None) -> None:
    """Refuse a run of another sample, or in another unit.

    Parameters
    ----------
    nominal, shape (point,)
        Predicted reflectance factors.
    coupon, shape (point,)
        Those of a flat sample of the same material; None where it is not known.

    Raises
    ------
    InputError
        Saying how far off the readings are, and what they look like instead.
    """
    ratio = np.log(run.brf / nominal)
    middle = float(np.median(ratio))
    if coupon is not None and abs(middle) > _SUSPICIOUS:
        from_coupon = np.log(run.brf / coupon)
        if np.sqrt(np.mean(from_coupon**2)) * _CLOSER < np.sqrt(np.mean(ratio**2)):
            raise InputError(
                f"{run.name}: brf: found {np.exp(middle):.2f} times the prediction of the artifact (median), but"
                f" {np.exp(np.median(from_coupon)):.2f} times that of the flat material; expected a run of the"
                " artifact: this looks like the material's coupon (diagnose it with an artifact without holes)"
            )
    if abs(middle) > _IMPOSSIBLE:
        factor = float(np.exp(middle))
        hint = " (BRDF in 1/sr instead of a reflectance factor?)" if abs(np.log(factor * np.pi)) < _SUSPICIOUS else ""
        raise InputError(
            f"{run.name}: brf: found {factor:.3g} times the prediction (median); expected a reflectance factor of the"
            f" sample named by --artifact and --material{hint}"
        )


def flat_reflectance(material: Material, run: Observation) -> FloatArray:
    """Reflectance factors of a flat sample of the material at a run's geometries, shape (point,)."""
    columns = run.columns
    zenith, light = np.deg2rad(columns["sensor_zenith"]), np.deg2rad(columns["illumination_zenith"])
    azimuth = np.deg2rad(columns["sensor_azimuth"] - columns["illumination_azimuth"])
    azimuth = np.mod(azimuth + np.where(zenith < 0, np.pi, 0.0) + np.where(light < 0, np.pi, 0.0), 2 * np.pi)
    tables = material.table_index(columns["wavelength"])
    found = np.empty(len(run))
    for table in np.unique(tables):
        rows = tables == table
        found[rows] = material.evaluate(np.cos(zenith[rows]), azimuth[rows], np.cos(light[rows]), int(table))
    return np.asarray(np.pi * found)
