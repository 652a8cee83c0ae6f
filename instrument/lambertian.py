"""Flux that an ideal Lambertian sample gives in a geometry: the N of the data contract, and the reference reading."""

from __future__ import annotations

from dataclasses import fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from instrument.angles import FloatArray
from instrument.facility import Facility
from instrument.optics import Setup, lay_out
from instrument.plane_flux import plane_flux


def lambertian_flux(
    facility: Facility,
    illumination_zenith: ArrayLike,
    sensor_zenith: ArrayLike,
    sensor_azimuth: ArrayLike,
    *,
    illumination_azimuth: ArrayLike = 0.0,
) -> FloatArray:
    """Mean over the sensor's rays of the irradiance where they meet the sample plane, nominal instrument.

    The irradiance is cos(illumination zenith) times the profile of the beam, 1 on its axis; so a wide uniform beam
    seen by a small sensor gives cos(illumination zenith).

    Parameters
    ----------
    facility
        Beam and sensor.
    illumination_zenith, sensor_zenith, sensor_azimuth, illumination_azimuth
        Commanded angles in degree, broadcast to shape (point,).

    Returns
    -------
    array, shape (point,)
        Dimensionless; accurate as :func:`~instrument.plane_flux.plane_flux`.
    """
    given = (illumination_zenith, illumination_azimuth, sensor_zenith, sensor_azimuth)
    angles = np.broadcast_arrays(*(np.asarray(angle, dtype=float) for angle in given))
    shape = angles[0].shape
    illumination, illumination_az, sensor, sensor_az = (np.ravel(angle) for angle in angles)
    # Only the azimuth between the arms matters: work in the frame of the illumination, each geometry once. At a
    # negative zenith the beam's cross-section has turned by 180 degrees, which a picture does not survive.
    turned = (illumination < 0) & (facility.beam.profile != "image")
    between = np.mod(sensor_az - illumination_az + np.where(turned, 180.0, 0.0), 360.0)
    geometries = np.round(np.stack([np.where(turned, -illumination, illumination), sensor, between]), 10)
    keys, inverse = np.unique(geometries, axis=1, return_inverse=True)
    values = plane_flux(lay_out(facility, _columns(*keys)))
    return np.asarray(values[np.ravel(inverse)].reshape(shape))


def reference_change(facility: Facility, setup: Setup) -> float:
    """Reference reading with an instrument that is off, over that of the nominal one.

    The reading of the run is divided by the reading of a reference sample, taken with the same instrument; the
    reference sample is taken to be Lambertian, flat and in place. What differs from point to point counts with its
    mean; a square target counts as the disc.

    Returns
    -------
    float
        Accurate to 1e-5, and to a small part of it where the change is small.
    """
    bare = setup.without_sample()
    if not setup.changes_the_instrument:
        return 1.0
    means = {f.name: float(np.mean(getattr(bare, f.name))) for f in fields(Setup) if f.name != "square_target"}
    off: Any = means
    source = means["source_distance_mm"]
    return _reference_flux(facility, Setup(**off)) / _reference_flux(facility, Setup(source_distance_mm=source))


@lru_cache(maxsize=4096)
def _reference_flux(facility: Facility, setup: Setup) -> float:
    """Flux of a flat Lambertian reference in place, mean over the azimuths of the reference reading."""
    reference = facility.reference
    azimuth = np.array(reference.sensor_azimuth)
    zenith = np.full(len(azimuth), reference.sensor_zenith)
    columns = _columns(np.full(len(azimuth), reference.illumination_zenith), zenith, azimuth)
    return float(np.mean(plane_flux(lay_out(facility, columns, setup))))


def _columns(illumination: FloatArray, sensor: FloatArray, azimuth: FloatArray) -> dict[str, FloatArray]:
    return {
        "illumination_zenith": illumination,
        "illumination_azimuth": np.zeros_like(illumination),
        "sensor_zenith": sensor,
        "sensor_azimuth": azimuth,
    }
