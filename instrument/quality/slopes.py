"""How a reading answers to the angles: slopes of the measured reflectance factor, and the angle terms of the budget.

A reading is scaled with the commanded geometry (data contract, section What the measured BRF is), so an arm that stands
at another angle changes it by the slope of the reflectance factor and by that of the flux N: d ln brf = d ln(brf N).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from instrument.angles import FloatArray
from instrument.facility import Facility
from instrument.lambertian import lambertian_flux

#: Angles of the budget's rows of the same names.
ANGLES = ("illumination_zenith", "sensor_zenith", "sensor_azimuth")
#: Neighbours farther apart than this (degree) tell no slope.
REACH = {"illumination_zenith": 20.0, "sensor_zenith": 20.0, "sensor_azimuth": 60.0}
#: Half of the step (degree) over which the slope of the flux is taken.
_STEP = 0.05

Columns = Mapping[str, ArrayLike]


@dataclass(frozen=True)
class Slope:
    """Relative change of brf with one angle, 1/degree, shape (point,); ``known`` where neighbours tell it."""

    relative: FloatArray
    known: np.ndarray


@dataclass(frozen=True)
class AngleTerm:
    """What the uncertainty of one angle does to brf.

    Attributes
    ----------
    signed, shape (point,)
        Change of brf for one standard uncertainty of the angle; the errors of two points have the sign of the product.
    source
        Where the slope comes from, in words.
    """

    signed: FloatArray
    source: str

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of the errors of the points, 1 or -1, shape (point, point): one error of the angle moves all."""
        sign = np.where(self.signed < 0, -1, 1).astype(np.int8)
        return np.multiply.outer(sign, sign)


def brf_slopes(columns: Columns, brf: ArrayLike) -> dict[str, Slope]:
    """Relative slopes of a measured reflectance factor, from the neighbours of every point.

    Along each angle the points that agree in everything else are joined by second-order differences of unequal steps,
    of first order at the ends; points of the same geometry count with their mean. A point at sensor zenith 0 has no
    slope in azimuth.

    Parameters
    ----------
    columns
        Everything that the geometries differ in, shape (point,) each: the five coordinates of the data contract, and
        others where there are any.
    brf
        Shape (point,).
    """
    brf_values: FloatArray = np.asarray(brf, dtype=float)
    keys = {name: _key(np.asarray(values)) for name, values in columns.items()}
    result = {}
    for angle in ANGLES:
        relative, known = np.zeros(len(brf_values)), np.zeros(len(brf_values), dtype=bool)
        position, others = _along(angle, keys)
        _, group = np.unique(np.stack(others, axis=1), axis=0, return_inverse=True)
        group = np.ravel(group)
        order = np.argsort(group, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
            slope, sure = _differences(position[rows], brf_values[rows], REACH[angle], angle == "sensor_azimuth")
            relative[rows], known[rows] = slope / brf_values[rows], sure
        if angle == "sensor_azimuth":
            upright = keys["sensor_zenith"] == 0
            relative[upright], known[upright] = 0.0, True
        result[angle] = Slope(relative, known)
    return result


def flux_slopes(facility: Facility, columns: Columns) -> dict[str, FloatArray]:
    """Relative slopes of the flux N of the ideal sample, 1/degree, shape (point,), by angle."""
    given = {name: np.asarray(columns[name], dtype=float) for name in (*ANGLES, "illumination_azimuth")}
    result = {}
    for angle in ANGLES:
        lower, upper = (lambertian_flux(facility, **(given | {angle: given[angle] + step})) for step in (-_STEP, _STEP))
        with np.errstate(divide="ignore", invalid="ignore"):
            result[angle] = np.nan_to_num((upper - lower) / (upper + lower) / _STEP)
    return result


def angle_terms(
    facility: Facility, columns: Columns, brf: ArrayLike, slopes: Mapping[str, Slope] | None = None
) -> dict[str, AngleTerm]:
    """The rows of the budget that ``facility.toml`` leaves to the slope.

    Where no neighbour tells the slope of the reflectance factor, the root mean square of the relative slopes along that
    angle stands for it.

    Parameters
    ----------
    columns, brf
        As for :func:`brf_slopes`.
    slopes
        Of the reflectance factor; those of ``brf`` itself where it is None.
    """
    rows = {angle: how for angle in ANGLES if isinstance(how := getattr(facility.budget, angle), str)}
    wanted = {angle: how for angle, how in rows.items() if getattr(facility.arms, f"u_{angle}") > 0}
    values: FloatArray = np.asarray(brf, dtype=float)
    if not wanted:
        return {angle: AngleTerm(np.zeros(len(values)), f"{angle} is known exactly") for angle in rows}
    slopes = brf_slopes(columns, values) if slopes is None else slopes
    flux = flux_slopes(facility, columns) if "slope" in wanted.values() else {}
    none: FloatArray = np.zeros(len(values))
    terms = {angle: AngleTerm(none, "the angle is known exactly") for angle in rows}
    for angle, how in wanted.items():
        own = flux.get(angle, none) if how == "slope" else none
        u = getattr(facility.arms, f"u_{angle}")
        terms[angle] = AngleTerm(_response(slopes[angle], own) * np.abs(values) * u, _source(slopes[angle], how, u))
    return terms


def _response(slope: Slope, flux: FloatArray) -> FloatArray:
    known = slope.known
    typical = float(np.sqrt(np.mean(slope.relative[known] ** 2))) if np.any(known) else 0.0
    guessed = np.where(flux < 0, -1.0, 1.0) * np.hypot(typical, flux)
    return np.asarray(np.where(known, slope.relative + flux, guessed))


def _source(slope: Slope, how: str, u: float) -> str:
    what = "of brf and flux" if how == "slope" else "of brf"
    count = int(slope.known.sum())
    rest = "" if count == len(slope.known) else f"; from neighbours at {count} of {len(slope.known)} points"
    if 0 < count < len(slope.known):
        rest += ", elsewhere their root mean square"
    elif count == 0:
        rest = "; no neighbours: brf is taken as flat"
    return f"slope {what} times {u:g} degrees{rest}"


def _key(values: np.ndarray) -> FloatArray:
    """Numbers that are equal where two values are the same geometry; texts become their rank."""
    if values.dtype.kind in "iufb":
        return np.round(values.astype(float), 6)
    return np.asarray(np.unique(values.astype(str), return_inverse=True)[1], dtype=float)


def _along(angle: str, keys: Mapping[str, FloatArray]) -> tuple[FloatArray, list[FloatArray]]:
    """Position along an angle, and what has to agree; the azimuth of a negative zenith is that of the other side."""
    others = dict(keys)
    position = others.pop(angle)
    if angle == "sensor_azimuth":
        zenith = others["sensor_zenith"]
        position = np.mod(position + np.where(zenith < 0, 180.0, 0.0), 360.0)
        others["sensor_zenith"] = np.abs(zenith)
    return position, list(others.values())


def _differences(
    position: FloatArray, values: FloatArray, reach: float, periodic: bool
) -> tuple[FloatArray, np.ndarray]:
    """Slope at every row of one group, and whether a neighbour within reach tells it."""
    places, where = np.unique(position, return_inverse=True)
    where = np.ravel(where)
    level = np.bincount(where, weights=values) / np.bincount(where)
    if periodic and len(places) > 2:
        places = np.concatenate([[places[-1] - 360.0], places, [places[0] + 360.0]])
        level = np.concatenate([level[-1:], level, level[:1]])
        where = where + 1
    step = np.diff(places)
    near = step <= reach
    slope, known = np.zeros(len(places)), np.zeros(len(places), dtype=bool)
    for i in range(len(places)):
        before, after = i > 0 and near[i - 1], i + 1 < len(places) and near[i]
        if not (before or after):
            continue
        known[i] = True
        left = (level[i] - level[i - 1]) / step[i - 1] if before else 0.0
        right = (level[i + 1] - level[i]) / step[i] if after else 0.0
        if before and after:
            # Parabola through the three points.
            slope[i] = (left * step[i] + right * step[i - 1]) / (step[i - 1] + step[i])
        else:
            slope[i] = left if before else right
    return slope[where], known[where]
