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
