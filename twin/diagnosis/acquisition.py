"""How a run was taken: what effects of electronics and acquisition depend on, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.facility import Facility
from instrument.lambertian import lambertian_flux
from twin.diagnosis.observation import Observation
from twin.diagnosis.turned import ROTATION


@dataclass(frozen=True)
class Acquisition:
    """Geometries and circumstances of a run's points, in the order of its rows; arrays of shape (point,).

    Attributes
    ----------
    columns
        Commanded geometries, as from :func:`~twin.diagnosis.turned.arm_columns`.
    signal_per_brf
        Signal over the reference reading that a reflectance factor of 1 gives.
    reference_zenith, reference_azimuth
        Of the sensor during the reference measurement, degree.
    reference_illumination
        Zenith of the light during it, degree.
    previous
        Index of the point read before (the first point's own).
    travel
        Direction in which the sensor zenith arrived: 1, -1, or 0 where it did not move.
    progress
        0 for the first reading to 1 for the last, in time; None if no times are known.
    gain, reference_gain
        V/A; None if not known.
    reference_current
        Photocurrent of the reference reading, A; None if not known.
    """

    columns: dict[str, FloatArray]
    signal_per_brf: FloatArray
    reference_zenith: float
    reference_azimuth: FloatArray
    previous: NDArray[np.int64]
    travel: FloatArray
    progress: FloatArray | None = None
    gain: FloatArray | None = None
    reference_gain: float | None = None
    reference_current: float | None = None
    reference_illumination: float = 0.0

    @property
    def reference_columns(self) -> dict[str, FloatArray]:
        """Geometries of the reference measurement, shape (azimuth,)."""
        alike = np.ones(len(self.reference_azimuth))
        return {
            "illumination_zenith": self.reference_illumination * alike,
            "illumination_azimuth": 0.0 * alike,
            "sensor_zenith": self.reference_zenith * alike,
            "sensor_azimuth": self.reference_azimuth,
        }

    def __len__(self) -> int:
        return len(self.signal_per_brf)


def acquisition_of(observation: Observation, facility: Facility) -> Acquisition:
    """Collect what a run says of its acquisition. Without times the rows count as standing in time order."""
    columns, reference = observation.columns, facility.reference
    flux = lambertian_flux(
        facility,
        columns["illumination_zenith"],
        columns["sensor_zenith"],
        columns["sensor_azimuth"],
        illumination_azimuth=columns["illumination_azimuth"],
    )
    azimuth = np.asarray(reference.sensor_azimuth, dtype=float)
    of_reference = lambertian_flux(facility, reference.illumination_zenith, reference.sensor_zenith, azimuth)
    order = np.arange(len(observation))
    if observation.seconds is not None:
        order = np.argsort(observation.seconds, kind="stable")
    previous = np.empty_like(order)
    previous[order] = np.concatenate([order[:1], order[:-1]])
    volts, gain = observation.reference_v, observation.reference_gain
    return Acquisition(
        columns,
        np.asarray(flux / (np.mean(of_reference) * reference.reflectance_factor)),
        reference.sensor_zenith,
        azimuth,
        previous,
        travel_direction(columns, order),
        None if observation.seconds is None else observation.progress,
        observation.gain,
        gain,
        None if volts is None or gain is None else volts / gain,
        reference.illumination_zenith,
    )


def travel_direction(columns: dict[str, FloatArray], order: NDArray[np.int64]) -> FloatArray:
    """Direction of the sensor arm on arrival, shape (point,).

    A slice's first point counts as arriving in the direction in which the slice goes on.
    """
    zenith = columns["sensor_zenith"][order]
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_azimuth", ROTATION)
    rows = np.nan_to_num(np.stack([columns[name][order] for name in names if name in columns]))
    starts = np.concatenate([[True], np.any(np.diff(rows, axis=1) != 0, axis=0)])
    step = np.sign(np.diff(zenith, prepend=zenith[:1]))
    following = np.append(step[1:], 0.0)
    alone = np.append(starts[1:], True)
    step[starts] = np.where(alone, 0.0, following)[starts]
    travel = np.empty_like(step)
    travel[order] = step
    return travel
