"""Finds, for every measured point, the predicted point of the same geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from instrument.angles import FloatArray, direction
from instrument.errors import InputError

#: How far two geometries may lie apart and still be the same: degree between directions, and nm.
ANGLE_TOLERANCE = 1e-3
WAVELENGTH_TOLERANCE = 1e-3

GEOMETRY = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")


def match_points(
    measurement: xr.Dataset, prediction: xr.Dataset, rows: NDArray[np.int64] | None = None
) -> NDArray[np.int64]:
    """Rows of the prediction that belong to the rows of the measurement.

    Parameters
    ----------
    measurement, prediction
        With the coordinates :data:`GEOMETRY` along ``point``.
    rows
        What the measured points are called in an error: their rows in the file, if some were left out.

    Returns
    -------
    array, shape (point of the measurement,)

    Raises
    ------
    InputError
        If a measured point has no prediction; names the first such point and the nearest prediction.
    """
    found = find_points(measurement, prediction)
    if np.any(found < 0):
        names = np.arange(len(found)) if rows is None else rows
        raise InputError(_explain(geometry_table(measurement), geometry_table(prediction), found, names))
    return found


def find_points(measurement: xr.Dataset, prediction: xr.Dataset) -> NDArray[np.int64]:
    """Like :func:`match_points`, but -1 where a measured point has no prediction.

    Directions are compared, not numbers: sensor zenith -30 at azimuth 0 is zenith 30 at azimuth 180. Where several
    predicted points share a direction (zenith 0 at every azimuth) the one with the same angles is taken.
    """
    wanted, offered = _from_sample(measurement), _from_sample(prediction)
    if wanted.shape == offered.shape and np.allclose(wanted, offered, rtol=0, atol=0.1 * ANGLE_TOLERANCE):
        return np.arange(len(wanted))
    if not len(offered):
        return np.full(len(wanted), -1)
    candidates: Any = cKDTree(_features(offered)).query_ball_point(_features(wanted), r=1.0)
    return np.array([_closest(wanted[row], offered, near) for row, near in enumerate(candidates)], dtype=np.int64)


def geometry_table(dataset: xr.Dataset) -> FloatArray:
    """Coordinates as an array of shape (point, 5), in the order of :data:`GEOMETRY`.

    Raises
    ------
    InputError
        If a coordinate is missing.
    """
    missing = [name for name in GEOMETRY if name not in dataset]
    if missing:
        raise InputError(f"coordinate {', '.join(missing)} missing; found {', '.join(map(str, dataset.variables))}")
    return np.stack([np.asarray(dataset[name].values, dtype=float) for name in GEOMETRY], axis=-1)


def _from_sample(dataset: xr.Dataset) -> FloatArray:
    """:func:`geometry_table` with azimuths in the frame of the sample, which may have been turned."""
    table = geometry_table(dataset)
    if "sample_rotation" in dataset:
        table[:, [2, 4]] -= np.asarray(dataset["sample_rotation"].values, dtype=float)[:, None]
    return table


def describe_geometry(row: FloatArray) -> str:
    """One geometry, for a person."""
    wavelength, illumination_zenith, illumination_azimuth, sensor_zenith, sensor_azimuth = (float(v) for v in row)
    return (
        f"{wavelength:g} nm, illumination zenith {illumination_zenith:g} azimuth {illumination_azimuth:g},"
        f" sensor zenith {sensor_zenith:g} azimuth {sensor_azimuth:g} degree"
    )


def _features(table: FloatArray) -> FloatArray:
    """Points whose distance is 1 at the tolerance, shape (point, 7)."""
    scale = 1.0 / np.deg2rad(ANGLE_TOLERANCE)
    return np.concatenate(
        [
            table[:, :1] / WAVELENGTH_TOLERANCE,
            scale * direction(table[:, 1], table[:, 2]),
            scale * direction(table[:, 3], table[:, 4]),
        ],
        axis=-1,
    )


def _closest(wanted: FloatArray, offered: FloatArray, candidates: list[int]) -> int:
    if not candidates:
        return -1
    distance = np.abs(offered[candidates] - wanted).sum(axis=-1)
    return candidates[int(np.argmin(distance))]


def _explain(wanted: FloatArray, offered: FloatArray, found: NDArray[np.int64], names: NDArray[np.int64]) -> str:
    lonely = np.flatnonzero(found < 0)
    row = int(lonely[0])
    others = f" ({len(lonely)} of {len(wanted)} measured points have none)" if len(lonely) > 1 else ""
    text = f"point {names[row]} has no prediction{others}: measured at {describe_geometry(wanted[row])}"
    if not len(offered):
        return f"{text}; the prediction has no points"
    nearest = int(np.argmin(np.linalg.norm(_features(offered) - _features(wanted[row : row + 1]), axis=-1)))
    return f"{text}; the nearest predicted point, {nearest}, is at {describe_geometry(offered[nearest])}"
