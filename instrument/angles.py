"""Directions of the laboratory frame. Degrees outside, radians only in names that say so.

A direction (zenith, azimuth) points away from the sample: (sin z cos a, sin z sin a, cos z). The zenith
may be negative: then it means azimuth + 180 degrees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def direction(zenith: ArrayLike, azimuth: ArrayLike) -> FloatArray:
    """Unit vectors of directions.

    Parameters
    ----------
    zenith, azimuth
        Degree, broadcast against each other to shape ``(...)``.

    Returns
    -------
    array, shape (..., 3)
    """
    zenith_rad, azimuth_rad = np.broadcast_arrays(
        np.deg2rad(np.asarray(zenith, dtype=float)), np.deg2rad(np.asarray(azimuth, dtype=float))
    )
    sine = np.sin(zenith_rad)
    return np.stack([sine * np.cos(azimuth_rad), sine * np.sin(azimuth_rad), np.cos(zenith_rad)], axis=-1)


def angle_between(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Angle in degree between unit vectors, shape (..., 3) each; exact for small angles too."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    dot = np.sum(a * b, axis=-1)
    return np.rad2deg(np.arctan2(cross, dot))


def fold(zenith: ArrayLike, azimuth: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Fold signed zenith angles: zenith >= 0, azimuth in [0, 360), both degree."""
    zenith, azimuth = np.broadcast_arrays(np.asarray(zenith, dtype=float), np.asarray(azimuth, dtype=float))
    return np.abs(zenith), np.mod(np.where(zenith < 0, azimuth + 180.0, azimuth), 360.0)
