"""Coordinates of a run beyond the three arms: rotation of the sample, polarisation, repetition.

A run has them only where its plan makes use of them, so that every other one reads as it always did.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.events import Polarization

Record = Mapping[str, Any]
#: Words by number; a run without a polariser has no such variable.
POLARIZATIONS: tuple[str, ...] = get_args(Polarization)
STAGES = ("sample_rotation", "polarizer")


def extra_coordinates(rows: Sequence[Record]) -> dict[str, Any]:
    """Variables of the points of a journal that only some instruments have.

    Parameters
    ----------
    rows
        Records of points.
    """
    geometries = [row["geometry"] for row in rows]
    columns: dict[str, Any] = {}
    turned = np.array([_get(geometry, "sample_rotation", 0.0) for geometry in geometries], dtype=float)
    if np.any(turned) or any("sample_rotation" in row.get("readback", {}) for row in rows):
        meaning = "commanded rotation of the sample about its normal, right-handed"
        columns["sample_rotation"] = ("point", turned, {"units": "degree", "long_name": meaning})
    columns |= polarization_column(rows, "point", "polarization")
    repetition = np.array([_get(geometry, "repetition", 0) for geometry in geometries])
    if np.any(repetition):
        meaning = "how many times the point had been measured before in this plan"
        columns["repetition"] = ("point", repetition, {"units": "1", "long_name": meaning})
    return columns


def polarization_column(rows: Sequence[Record], dimension: str, name: str) -> dict[str, Any]:
    """The polarisation of records as numbers with their meanings; nothing where there was no polariser."""
    words = [_get(row["geometry"], "polarization", None) for row in rows]
    if any(word is None for word in words):
        return {}
    codes = np.array([POLARIZATIONS.index(word) for word in words], dtype=np.int8)
    attributes = {
        "long_name": "polarisation of the light: mean of both, across the plane of incidence (s), in it (p)",
        "flag_values": np.arange(len(POLARIZATIONS), dtype=np.int8),
        "flag_meanings": " ".join(POLARIZATIONS),
    }
    return {name: (dimension, codes, attributes)}


def channels(dataset: xr.Dataset) -> tuple[NDArray[np.int64], NDArray[np.int64], list[str]]:
    """Which light was used: points are scaled with readings of the reference in the same light.

    Returns
    -------
    array, shape (point,); array, shape (reference,)
        Number of the channel, wavelength and polarisation, of each point and of each reading of the reference.
    list of str
        What each channel is called.
    """
    rows = np.stack([dataset["wavelength"].values, _codes(dataset, "polarization", "point")], axis=-1)
    references = np.stack(
        [dataset["reference_wavelength"].values, _codes(dataset, "reference_polarization", "reference")], axis=-1
    )
    found, which = np.unique(np.concatenate([rows, references]), axis=0, return_inverse=True)
    which = np.ravel(which)
    named = "polarization" in dataset
    names = [f"{nm:g} nm" + (f", polarisation {POLARIZATIONS[int(code)]}" if named else "") for nm, code in found]
    return which[: len(rows)], which[len(rows) :], names


def _codes(dataset: xr.Dataset, name: str, dimension: str) -> FloatArray:
    if name in dataset:
        return np.asarray(dataset[name].values, dtype=float)
    return np.zeros(dataset.sizes[dimension])


def _get(geometry: Any, name: str, usual: Any) -> Any:
    """A value of a geometry, be it a model or a record of the journal."""
    return geometry.get(name, usual) if isinstance(geometry, Mapping) else getattr(geometry, name)
