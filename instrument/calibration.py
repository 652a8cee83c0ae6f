"""From detector readings to reflectance factors.

What is measured (data contract, section What the measured BRF is)::

    brf(g) = signal(g)/signal(reference) * brf_reference * N(reference)/N(g)

N is the flux that an ideal Lambertian sample of reflectance factor 1 gives at the commanded angles with the nominal
beam and sensor.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from instrument.angles import FloatArray
from instrument.facility import Facility
from instrument.lambertian import lambertian_flux

__all__ = [
    "Calibrated",
    "Photocurrent",
    "brf_from_readings",
    "calibration_numbers",
    "lambertian_flux",
    "photocurrent",
]


@dataclass(frozen=True)
class Photocurrent:
    """Mean photocurrents in A and their standard errors from the scatter of the samples, shape (point,) each."""

    current: FloatArray
    standard_error: FloatArray


@dataclass(frozen=True)
class Calibrated:
    """Reflectance factors, shape (point,).

    Attributes
    ----------
    brf
        Bidirectional reflectance factor.
    standard_error
        Standard error of ``brf`` from the scatter of the samples of point and reference; beside the budget,
        not part of it.
    flux
        N of every point.
    """

    brf: FloatArray
    standard_error: FloatArray
    flux: FloatArray


def calibration_numbers(indices: Iterable[int]) -> list[int]:
    """Which calibration each reference reading belongs to: a new one starts where an index comes again.

    Parameters
    ----------
    indices
        Index of every reading (:meth:`instrument.job.ScanJob.references`) in the order in which they were taken.
    """
    numbers: list[int] = []
    number, seen = 0, set[int]()
    for index in indices:
        if index in seen:
            number, seen = number + 1, set()
        seen.add(index)
        numbers.append(number)
    return numbers


def photocurrent(
    signal: ArrayLike, dark: ArrayLike, gain: ArrayLike, dark_signal: ArrayLike | None = None
) -> Photocurrent:
    """Photocurrent of bursts of readings: (mean signal - dark)/gain.

    Parameters
    ----------
    signal
        V, shape (point, sample).
    dark
        V, shape (point,).
    gain
        V/A, shape (point,).
    dark_signal
        The samples that ``dark`` is the mean of, V, shape (point, sample), where they are known: their scatter then
        counts as well.
    """
    volts = np.atleast_2d(np.asarray(signal, dtype=float))
    scatter = standard_error(volts)
    if dark_signal is not None:
        without_light = standard_error(np.atleast_2d(np.asarray(dark_signal, dtype=float)))
        scatter = np.hypot(scatter, np.nan_to_num(without_light))
    amplification = np.asarray(gain, dtype=float)
    return Photocurrent((volts.mean(axis=-1) - np.asarray(dark, dtype=float)) / amplification, scatter / amplification)


def standard_error(samples: FloatArray) -> FloatArray:
    """Standard error of the mean along the last axis; nan of a single sample."""
    count = samples.shape[-1]
    if count < 2:
        return np.full(samples.shape[:-1], np.nan)
    return np.asarray(samples.std(axis=-1, ddof=1) / np.sqrt(count))


def brf_from_readings(
    facility: Facility,
    illumination_zenith: ArrayLike,
    sensor_zenith: ArrayLike,
    sensor_azimuth: ArrayLike,
    reading: Photocurrent,
    reference_sensor_azimuth: ArrayLike,
    reference: Photocurrent,
    *,
    illumination_azimuth: ArrayLike = 0.0,
) -> Calibrated:
    """Reflectance factors of points against one set of reference readings.

    Each reference reading is divided by the flux of its own geometry before the mean is taken; at normal
    illumination, where all have one flux, that is the equation of the data contract.

    Parameters
    ----------
    facility
        Beam, sensor, and geometry and reflectance factor of the reference.
    illumination_zenith, sensor_zenith, sensor_azimuth, illumination_azimuth
        Commanded angles in degree, shape (point,).
    reading
        Photocurrents of the points.
    reference_sensor_azimuth
        Degree, shape (reference,).
    reference
        Photocurrents of the reference sample.
    """
    known = facility.reference
    reference_flux = lambertian_flux(
        facility, known.illumination_zenith, known.sensor_zenith, np.asarray(reference_sensor_azimuth, dtype=float)
    )
    flux = lambertian_flux(
        facility, illumination_zenith, sensor_zenith, sensor_azimuth, illumination_azimuth=illumination_azimuth
    )
    level = np.mean(reference.current / reference_flux)
    brf = known.reflectance_factor * reading.current / flux / level
    point_part = reading.standard_error / np.abs(reading.current)
    reference_part = np.sqrt(np.sum((reference.standard_error / reference_flux) ** 2)) / reference_flux.size / level
    return Calibrated(brf, np.abs(brf) * np.hypot(point_part, reference_part), flux)
