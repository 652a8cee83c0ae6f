"""Errors of a coupon run as independent normal numbers: what its uncertainty components say, and how they correlate.

A component of standard uncertainty u and correlation R along the points has the covariance diag(u) R diag(u) = M M^T.
Its errors are M z with independent standard normal z: one column of M for a component that is common to all points,
one a point for a random one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.dataset import component_names
from instrument.errors import InputError

#: Rows of the budget whose errors change their sign with the direction: what their standard uncertainty is multiplied
#: with, columns whose squares add up to 1 at most, by the sensor's signed zenith and its azimuth from that of the light
#: (degree).
_PATTERNS: dict[str, Callable[[FloatArray, FloatArray], tuple[FloatArray, ...]]] = {
    "sensor_zenith": lambda zenith, azimuth: (np.sign(zenith),),
    "sensor_azimuth": lambda zenith, azimuth: (np.sign(zenith) * np.sign(np.sin(np.deg2rad(azimuth)).round(9)),),
    "placement": lambda zenith, azimuth: (
        np.sign(zenith) * np.cos(np.deg2rad(azimuth)),
        np.sign(zenith) * np.sin(np.deg2rad(azimuth)),
    ),
    "polarization": lambda zenith, azimuth: (np.cos(np.deg2rad(2 * azimuth)),),
}
#: How the errors of a component are taken to correlate where the file does not say: common to all points, to the points
#: of a slice (one wavelength, illumination zenith and sensor azimuth), or to none.
Unstated = Literal["common", "slice", "independent"]
_SLICE = ("wavelength", "illumination_zenith", "sensor_azimuth")


@dataclass(frozen=True)
class Component:
    """Errors of one row of the coupon's budget.

    Attributes
    ----------
    name
        Without ``u_brf_``.
    modes, shape (point, number)
        The errors are ``modes @ z``, z independent and standard normal.
    assumed
        What was assumed of the correlation; empty where the file states it.
    """

    name: str
    modes: FloatArray
    assumed: str = ""


def coupon_components(
    run: xr.Dataset, name: str, unstated: Unstated = "slice", *, by_direction: bool = False
) -> list[Component]:
    """Split the uncertainty of a coupon run into independent errors.

    Parameters
    ----------
    run
        A run file's content. Components without ``err_corr_1_form`` follow ``unstated``; so does ``u_brf`` of a run
        without components.
    name
        Names the file in errors.
    by_direction
        Whether systematic errors of zenith, azimuth, tilt and polarisation change their sign as their physics does: a
        sensor arm that is off by an angle reads more on one side of the normal and less on the other, where one factor
        for all directions would be a scale.

    Raises
    ------
    InputError
        For a correlation of unknown form, or a matrix that is missing, of the wrong shape or not positive.
    """
    if unstated not in get_args(Unstated):
        raise InputError(f"correlation: found {unstated!r}; expected {', '.join(get_args(Unstated))}")
    names = component_names(run) or ["u_brf"]
    found = [_component(run, variable, name, unstated) for variable in names]
    if by_direction:
        found = [_turned(run, component) for component in found]
    return [component for component in found if np.any(component.modes)]


def _component(run: xr.Dataset, variable: str, name: str, unstated: Unstated) -> Component:
    u = np.asarray(run[variable].values, dtype=float)
    attributes = run[variable].attrs
    short = variable.removeprefix("u_brf_") if variable != "u_brf" else "all components"
    form = attributes.get("err_corr_1_form")
    if form is None:
        modes = _common(u) if unstated == "common" else np.diag(u) if unstated == "independent" else _by_slice(run, u)
        return Component(short, modes, f"{short}: correlation not stated, taken as {unstated}")
    if form == "random":
        return Component(short, np.diag(u))
    if form == "systematic":
        return Component(short, _common(u))
    if form == "err_corr_matrix":
        return Component(short, u[:, None] * _root(_matrix(run, variable, name), f"{name}: {variable}"))
    raise InputError(
        f"{name}: {variable}: err_corr_1_form: found {form!r}; expected random, systematic or err_corr_matrix"
    )


def _turned(run: xr.Dataset, component: Component) -> Component:
    """A component that is common to all points, with the sign that it has in each direction."""
    if component.name not in _PATTERNS or component.modes.shape[1] != 1 or component.assumed:
        return component
    zenith, sensor, light = (
        np.asarray(run[axis].values, dtype=float)
        for axis in ("sensor_zenith", "sensor_azimuth", "illumination_azimuth")
    )
    pattern = np.stack(_PATTERNS[component.name](zenith, sensor - light), axis=1)
    return replace(component, modes=component.modes * pattern)


def _common(u: FloatArray) -> FloatArray:
    return u[:, None]


def _by_slice(run: xr.Dataset, u: FloatArray) -> FloatArray:
    keys = np.stack([np.round(np.asarray(run[axis].values, dtype=float), 6) for axis in _SLICE], axis=1)
    _, index = np.unique(keys, axis=0, return_inverse=True)
    member = np.ravel(index)[:, None] == np.arange(int(np.max(index)) + 1)
    return np.where(member, u[:, None], 0.0)


def _matrix(run: xr.Dataset, variable: str, name: str) -> FloatArray:
    params = [str(p) for p in np.atleast_1d(run[variable].attrs.get("err_corr_1_params", []))]
    if not params or params[0] not in run.variables:
        raise InputError(
            f"{name}: {variable}: err_corr_1_params: found {params}; expected the name of a variable with the matrix"
        )
    matrix = np.asarray(run[params[0]].values, dtype=float)
    count = run.sizes["point"]
    if matrix.shape != (count, count):
        raise InputError(f"{name}: {params[0]}: found shape {matrix.shape}; expected ({count}, {count})")
    if not np.all(np.isfinite(matrix)) or not np.allclose(matrix, matrix.T, atol=1e-6):
        raise InputError(f"{name}: {params[0]}: expected a symmetric matrix of finite numbers")
    return matrix


def _root(matrix: FloatArray, where: str) -> FloatArray:
    """M with M M^T the matrix, without columns that do not matter."""
    values, vectors = np.linalg.eigh(matrix)
    if values[0] < -1e-6 * values[-1]:
        raise InputError(f"{where}: the correlation matrix has the eigenvalue {values[0]:.3g}; expected none below 0")
    keep = values > 1e-9 * values[-1]
    return np.asarray(vectors[:, keep] * np.sqrt(values[keep]))
