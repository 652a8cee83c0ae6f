"""Compares a measured run with its prediction: per point, by azimuth plane, in-plane, out-of-plane and globally.

The JSON form is the section Comparison of the data contract.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from instrument.errors import InputError
from twin import metrics
from twin.matching import GEOMETRY, describe_geometry, geometry_table, match_points

BoolArray = NDArray[np.bool_]

#: Bits of ``quality_flag`` that make a reading no measurement of the BRF: saturated, overload, shadowed.
UNUSABLE_FLAGS = 1 | 2 | 4

#: Said wherever u_sim holds nothing but the ray tracer's noise.
MONTE_CARLO_ONLY = (
    "u_sim is the Monte Carlo error of the ray tracer alone: uncertainties of dimensions, material and instrument"
    " are not propagated, so t' is larger and n' closer to a step than with a full budget."
)


@dataclass(frozen=True)
class Shares:
    """Fractions of the points in the three categories of Table V; not a number where there are no points."""

    good: float
    acceptable: float
    poor: float


@dataclass(frozen=True)
class Group:
    """Aggregates over a group of points."""

    points: int
    relative_rmse: float
    mean_absolute_relative_difference: float
    rms_t: float
    level_of_agreement: float
    shares: Mapping[str, Shares]

    def to_dict(self) -> dict[str, Any]:
        """The keys of the data contract; numbers that do not exist are None."""
        return {
            "points": self.points,
            "relative_rmse": _number(self.relative_rmse),
            "mean_absolute_relative_difference": _number(self.mean_absolute_relative_difference),
            "rms_t": _number(self.rms_t),
            "level_of_agreement": _number(self.level_of_agreement),
            "shares": {
                metric: {"good": _number(s.good), "acceptable": _number(s.acceptable), "poor": _number(s.poor)}
                for metric, s in self.shares.items()
            },
        }


@dataclass(frozen=True)
class Plane:
    """One azimuth plane: what is constant in it, its aggregates and its rows in :attr:`Comparison.points`."""

    wavelength: float
    illumination_zenith: float
    illumination_azimuth: float
    sensor_azimuth: float
    group: Group
    rows: tuple[int, ...]


@dataclass(frozen=True)
class Comparison:
    """The outcome of :func:`compare`.

    Attributes
    ----------
    points
        One row per compared point: the coordinates; ``row`` (in the measured file); ``measured``, ``u_measured``,
        ``simulated``, ``u_simulated``, ``u_monte_carlo``; ``relative_difference``, ``t``, ``level_of_agreement``.
    overall, in_plane, out_of_plane, planes
        The groups; planes stand in the order in which they were measured.
    median_relative_standard_error
        Of the ray tracer, over the compared points.
    notes
        What a reader of the numbers must know.
    """

    points: xr.Dataset
    overall: Group
    in_plane: Group
    out_of_plane: Group
    planes: tuple[Plane, ...]
    median_relative_standard_error: float
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The form ``comparison.json`` of the data contract."""
        turned = any(plane.illumination_azimuth != 0 for plane in self.planes)
        return {
            "global": self.overall.to_dict(),
            "in_plane": self.in_plane.to_dict(),
            "out_of_plane": self.out_of_plane.to_dict(),
            "planes": [_plane_dict(plane, turned) for plane in self.planes],
            "monte_carlo": {"median_relative_standard_error": _number(self.median_relative_standard_error)},
        }


def compare(measurement: xr.Dataset, prediction: xr.Dataset, *, notes: tuple[str, ...] = ()) -> Comparison:
    """Compare a run with a prediction of the same points.

    Parameters
    ----------
    measurement
        Run form: the coordinates, ``brf`` and ``u_brf`` along ``point``; ``quality_flag`` if there is one.
    prediction
        Prediction form: the coordinates, ``brf``, ``u_brf`` and ``u_brf_monte_carlo``, in any order; points that
        were not measured are left out.
    notes
        What the caller already has to say about the data.

    Raises
    ------
    InputError
        If a measured point has no prediction, a value is missing or no point can be compared; names the point.
    """
    usable, remarks = _usable(measurement)
    rows = np.flatnonzero(usable)
    measured = measurement[list(GEOMETRY)].isel(point=rows)
    matched = prediction.isel(point=match_points(measured, prediction, rows))
    points = _point_table(measurement.isel(point=rows), matched, rows)
    if np.array_equal(points.u_simulated.values, points.u_monte_carlo.values):
        remarks.append(MONTE_CARLO_ONLY)
    if material := prediction.attrs.get("material"):
        remarks.append(f"The twin's {material}.")
    in_plane = _in_plane(points)
    return Comparison(
        points=points,
        overall=_group(points, np.ones(len(rows), dtype=bool)),
        in_plane=_group(points, in_plane),
        out_of_plane=_group(points, ~in_plane),
        planes=_planes(points),
        median_relative_standard_error=float(np.median(points.u_monte_carlo.values / points.simulated.values)),
        notes=(*notes, *remarks),
    )


def _usable(measurement: xr.Dataset) -> tuple[BoolArray, list[str]]:
    """Which points can be compared, and what to say about the others."""
    notes = []
    finite = np.isfinite(measurement["brf"].values) & np.isfinite(measurement["u_brf"].values)
    if not finite.all():
        notes.append(f"{np.count_nonzero(~finite)} points without a measured value are left out.")
    flagged = np.zeros_like(finite)
    if "quality_flag" in measurement:
        flags = np.nan_to_num(measurement["quality_flag"].values).astype(np.int64)
        flagged = finite & ((flags & UNUSABLE_FLAGS) != 0)
    if flagged.any():
        count = np.count_nonzero(flagged)
        notes.append(f"{count} points flagged saturated, overloaded or shadowed are left out.")
    usable = finite & ~flagged
    if not usable.any():
        raise InputError("the run has no point that can be compared: " + (" ".join(notes) or "it is empty"))
    return usable, notes


def _point_table(measured: xr.Dataset, predicted: xr.Dataset, rows: NDArray[np.int64]) -> xr.Dataset:
    brf, u_brf = _values(measured, "brf"), _values(measured, "u_brf")
    simulated, u_simulated = _values(predicted, "brf"), _values(predicted, "u_brf")
    u_monte_carlo = _values(predicted, "u_brf_monte_carlo")
    _check(measured, rows, "predicted brf or its uncertainty", np.isfinite(simulated + u_simulated + u_monte_carlo))
    _check(measured, rows, "measured brf (found 0)", brf != 0)
    _check(measured, rows, "standard uncertainty (found a negative one)", (u_brf >= 0) & (u_simulated >= 0))
    _check(measured, rows, "standard uncertainty (found 0 for both sides)", (u_brf > 0) | (u_simulated > 0))
    t = metrics.t_score(simulated, brf, u_simulated, u_brf)
    columns = {
        "row": rows,
        "measured": brf,
        "u_measured": u_brf,
        "simulated": simulated,
        "u_simulated": u_simulated,
        "u_monte_carlo": u_monte_carlo,
        "relative_difference": metrics.relative_difference(simulated, brf),
        "t": t,
        "level_of_agreement": metrics.level_of_agreement(t, u_simulated, u_brf),
    }
    table = geometry_table(measured)
    coordinates = {name: ("point", table[:, column]) for column, name in enumerate(GEOMETRY)}
    return xr.Dataset({name: ("point", values) for name, values in columns.items()}, coords=coordinates)


def _values(dataset: xr.Dataset, name: str) -> metrics.FloatArray:
    if name not in dataset:
        raise InputError(f"variable {name} missing; found {', '.join(map(str, dataset.data_vars))}")
    return np.asarray(dataset[name].values, dtype=np.float64)


def _check(measured: xr.Dataset, rows: NDArray[np.int64], what: str, good: BoolArray) -> None:
    if not good.all():
        bad = int(np.argmin(good))
        geometry = describe_geometry(geometry_table(measured)[bad])
        raise InputError(f"point {rows[bad]} ({geometry}) has no usable {what}")


def _in_plane(points: xr.Dataset) -> BoolArray:
    """In-plane is sensor azimuth 0, counted from the illumination's azimuth (section II-A of the paper)."""
    turned = np.mod(points["sensor_azimuth"].values - points["illumination_azimuth"].values, 180.0)
    return np.minimum(turned, 180.0 - turned) < 1e-6


def _planes(points: xr.Dataset) -> tuple[Plane, ...]:
    members: dict[tuple[float, ...], list[int]] = {}
    table = np.round(geometry_table(points)[:, [0, 1, 2, 4]], 6) + 0.0
    for row, key in enumerate(map(tuple, table.tolist())):
        members.setdefault(key, []).append(row)
    planes = []
    for (wavelength, illumination_zenith, illumination_azimuth, sensor_azimuth), rows in members.items():
        mask = np.zeros(points.sizes["point"], dtype=bool)
        mask[rows] = True
        group = _group(points, mask)
        planes.append(Plane(wavelength, illumination_zenith, illumination_azimuth, sensor_azimuth, group, tuple(rows)))
    return tuple(planes)


def _group(points: xr.Dataset, mask: BoolArray) -> Group:
    difference = points["relative_difference"].values[mask]
    t = points["t"].values[mask]
    level = points["level_of_agreement"].values[mask]
    return Group(
        points=int(mask.sum()),
        relative_rmse=metrics.relative_rmse(difference),
        mean_absolute_relative_difference=metrics.mean_absolute(difference),
        rms_t=metrics.root_mean_square(t),
        level_of_agreement=float(np.mean(level)) if level.size else math.nan,
        shares={
            "relative_difference": _shares(metrics.categorise_relative_difference(difference)),
            "t": _shares(metrics.categorise_t(t)),
            "level_of_agreement": _shares(metrics.categorise_level_of_agreement(level)),
        },
    )


def _shares(categories: metrics.IntArray) -> Shares:
    if not categories.size:
        return Shares(math.nan, math.nan, math.nan)
    return Shares(*(float(np.mean(categories == category)) for category in metrics.Category))


def _plane_dict(plane: Plane, turned: bool) -> dict[str, Any]:
    """``illumination_azimuth`` is written where it is not 0 everywhere: without it two planes could look alike."""
    label = {"wavelength": plane.wavelength, "illumination_zenith": plane.illumination_zenith}
    if turned:
        label["illumination_azimuth"] = plane.illumination_azimuth
    return {**label, "sensor_azimuth": plane.sensor_azimuth, **plane.group.to_dict()}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
