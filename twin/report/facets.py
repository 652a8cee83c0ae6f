"""How a run falls into the panels of figures: by its light, and by planes of constant sensor azimuth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.run_axes import POLARIZATIONS
from twin.matching import find_points

#: What all points of a panel have in common, as far as a run has it.
_LIGHT = ("wavelength", "polarization", "sample_rotation", "illumination_azimuth", "illumination_zenith")
#: A square array of holes looks the same in a mirror at these angles to its rows, degree.
_MIRRORS = 45.0

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Facet:
    """Points of a run that share what a panel is about.

    Attributes
    ----------
    title
        What it is, next to the others: what is the same in all of them is left out.
    rows
        Of the dataset.
    light
        Illumination zenith, illumination azimuth, sample rotation, degree.
    """

    title: str
    rows: IntArray
    light: tuple[float, float, float]


def by_light(data: xr.Dataset) -> list[Facet]:
    """One facet for each illumination (and wavelength, polarisation, rotation of the sample), as they were measured."""
    return _facets(data, _LIGHT)


def by_plane(data: xr.Dataset) -> list[Facet]:
    """One facet for each plane of constant sensor azimuth in each light, as they were measured."""
    return _facets(data, (*_LIGHT, "sensor_azimuth"))


def _facets(data: xr.Dataset, names: Sequence[str]) -> list[Facet]:
    has = [name for name in names if name in data.variables]
    table = np.stack([np.round(data[name].values.astype(float), 6) + 0.0 for name in has], axis=-1)
    keys, first, which = np.unique(table, axis=0, return_index=True, return_inverse=True)
    several = [k for k in range(len(has)) if len(np.unique(keys[:, k])) > 1]
    shown = [k for k, name in enumerate(has) if k in several or name in ("illumination_zenith", "sensor_azimuth")]
    result = []
    for group in np.argsort(first):
        rows = np.flatnonzero(np.ravel(which) == group)
        title = ", ".join(_said(has[k], keys[group, k]) for k in shown)
        light = tuple(
            float(keys[group, has.index(name)]) if name in has else 0.0
            for name in ("illumination_zenith", "illumination_azimuth", "sample_rotation")
        )
        result.append(Facet(title, rows, (light[0], light[1], light[2])))
    return result


def _said(name: str, value: float) -> str:
    if name == "wavelength":
        return f"{value:g} nm"
    if name == "polarization":
        return f"pol. {POLARIZATIONS[int(value)]}"
    word = {
        "sample_rotation": "turned",
        "illumination_azimuth": "from",
        "illumination_zenith": "ill.",
        "sensor_azimuth": "azimuth",
    }[name]
    return f"{word} {value:g}°"


def mirrored_rows(data: xr.Dataset, facet: Facet, *, isotropic: bool) -> IntArray:
    """For every point of a facet, the row of the point that symmetry makes equal to it; -1 where there is none.

    Two points are alike when the plane of incidence mirrors one into the other. At normal incidence a point in a plane
    that is its own mirror image is like the one on the other side of the normal.

    Parameters
    ----------
    isotropic
        A flat, isotropic sample. Else a square array of holes is assumed, whose mirror planes lie along its rows and
        diagonals: with the plane of incidence elsewhere nothing is alike.

    Returns
    -------
    array, shape (point of the facet,)
    """
    zenith, azimuth, rotation = facet.light
    relative = azimuth - rotation
    none = np.full(len(facet.rows), -1)
    if not isotropic and abs(relative / _MIRRORS - round(relative / _MIRRORS)) > 1e-6:
        return none
    whole = _same_light(data, facet)
    offered = data.isel(point=whole).drop_vars("sample_rotation", errors="ignore")
    points = data.isel(point=facet.rows).drop_vars("sample_rotation", errors="ignore")
    mirrored = points.assign_coords(sensor_azimuth=2 * azimuth - points["sensor_azimuth"])
    found = find_points(mirrored, offered)
    result = np.where(found >= 0, whole[found], -1)
    own = (result == facet.rows) | (_at_normal(points) & (result >= 0))
    if abs(zenith) > 1e-6:
        # A plane that mirrors into itself point by point says nothing.
        return none if np.all(own | (result < 0)) else np.where(result == facet.rows, -1, result)
    if not np.all(own | (result < 0)):
        return result
    turned = points.assign_coords(sensor_zenith=-points["sensor_zenith"])
    found = find_points(turned, offered)
    return np.where(found >= 0, whole[found], -1)


def _same_light(data: xr.Dataset, facet: Facet) -> IntArray:
    """Rows of all planes in the light of a facet."""
    names = [name for name in _LIGHT if name in data.variables]
    same = np.ones(data.sizes["point"], dtype=bool)
    for name in names:
        same &= np.abs(data[name].values.astype(float) - float(data[name].values[facet.rows[0]])) < 1e-6
    return np.flatnonzero(same)


def _at_normal(points: xr.Dataset) -> NDArray[np.bool_]:
    return np.abs(points["sensor_zenith"].values) < 1e-6


def geometry(data: xr.Dataset, rows: IntArray | None = None) -> dict[str, FloatArray]:
    """Columns that say where the points of a figure were measured."""
    chosen = slice(None) if rows is None else rows
    names = ("wavelength", "illumination_zenith", "illumination_azimuth", "sensor_zenith", "sensor_azimuth")
    further = [name for name in ("sample_rotation", "polarization", "repetition") if name in data.variables]
    return {name: data[name].values[chosen].astype(float) for name in (*names, *further)}
