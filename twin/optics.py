"""Commanded geometries as arrays, and what the twin needs of the instrument's optics in one place."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.lambertian import reference_change
from instrument.optics import Layout, Setup, lay_out
from twin.footprint import Footprint, lit_footprint

__all__ = [
    "COORDINATES",
    "Footprint",
    "Layout",
    "Setup",
    "geometry_columns",
    "lay_out",
    "lit_footprint",
    "reference_change",
    "sample_columns",
    "sample_rotation",
]

COORDINATES = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")


def geometry_columns(geometries: Any) -> dict[str, FloatArray]:
    """Commanded coordinates as arrays of shape (point,), from a sequence of geometries or a dataset."""
    if isinstance(geometries, xr.Dataset):
        count = geometries.sizes["point"]
        return {
            name: np.broadcast_to(np.asarray(geometries[name].values, dtype=float), (count,))
            if name in geometries
            else np.zeros(count)
            for name in COORDINATES
        }
    return {name: np.array([getattr(g, name) for g in geometries], dtype=float) for name in COORDINATES}


def sample_columns(geometries: Any) -> dict[str, FloatArray]:
    """:func:`geometry_columns` in the frame of the sample, which the instrument may have turned about its normal.

    A nominal instrument sees a turned sample as one that lies still and is looked at from azimuths turned the other
    way.
    """
    columns = geometry_columns(geometries)
    turned = sample_rotation(geometries)
    if not np.any(turned):
        return columns
    return columns | {name: columns[name] - turned for name in ("illumination_azimuth", "sensor_azimuth")}


def sample_rotation(geometries: Any) -> FloatArray:
    """How far the sample was turned at each point, degree, shape (point,); 0 where nothing says so."""
    if isinstance(geometries, xr.Dataset):
        if "sample_rotation" not in geometries:
            return np.zeros(geometries.sizes["point"])
        return np.asarray(geometries["sample_rotation"].values, dtype=float)
    return np.array([getattr(g, "sample_rotation", 0.0) for g in geometries], dtype=float)
