"""Angle terms of a run that exists already: computed anew from slopes, or set beside what its budget states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.angles import FloatArray
from instrument.budget import COMPONENTS, combined
from instrument.errors import InputError
from instrument.facility import Facility, read_facility
from instrument.forms import parse_form, parse_toml
from instrument.quality.slopes import ANGLES, Slope, angle_terms, brf_slopes, flux_slopes
from instrument.request import FACILITY_NAME
from instrument.run_budget import add_coverage, correlated, geometry_columns, say_slope
from instrument.run_check import component_names


def facility_of(path: Path, run: xr.Dataset, named: Path | None, *, required: bool) -> Facility | None:
    """The facility of a run: the file that is named, the copy in its folder, or what the run file holds.

    Raises
    ------
    InputError
        If there is none and it is required.
    """
    if named is not None:
        return read_facility(named)
    if path.is_dir() and (path / FACILITY_NAME).exists():
        return read_facility(path / FACILITY_NAME)
    if "facility" in run.attrs:
        source = f"{path}: global attribute facility"
        return parse_form(parse_toml(str(run.attrs["facility"]), source), Facility, source)
    if required:
        raise InputError(f"{path}: does not hold its facility; name it with --facility")
    return None


def with_slopes(run: xr.Dataset, facility: Facility, prediction: xr.Dataset | None = None) -> xr.Dataset:
    """The same run with its angle terms from slopes: of its own reflectance factor, or of a predicted one.

    Parameters
    ----------
    prediction
        Its ``sensitivity`` to the angles where it has one, else the differences between its points; it has to hold
        every geometry of the run.

    Raises
    ------
    InputError
        If the run has no components, no angle has an uncertainty, or the prediction lacks a point.
    """
    names = component_names(run)
    if not names:
        raise InputError("the run has no uncertainty components; expected u_brf_noise, u_brf_sensor_zenith ...")
    if not any(getattr(facility.arms, f"u_{angle}") > 0 for angle in ANGLES):
        raise InputError("facility: arms.u_illumination_zenith, u_sensor_zenith, u_sensor_azimuth: all are 0")
    columns, brf = geometry_columns(run), run["brf"].values
    known = None if prediction is None else predicted_slopes(run, facility, prediction)
    result = run.copy()
    for angle, term in angle_terms(_left_to_slopes(facility), columns, brf, known).items():
        if getattr(facility.arms, f"u_{angle}") == 0:
            continue
        name = COMPONENTS[angle]
        attributes = correlated("systematic") | {"units": "1", "degrees_of_freedom": np.inf}
        attributes["long_name"] = f"standard uncertainty (k=1) of brf: {angle.replace('_', ' ')}"
        result[name] = ("point", np.abs(term.signed), attributes)
        say_slope(result, name, term, "" if prediction is None else "predicted ")
        names = names if name in names else [*names, name]
    result["brf"].attrs["unc_comps"] = names
    attributes = run["u_brf"].attrs
    result["u_brf"] = ("point", combined({name: result[name].values for name in names}), attributes)
    add_coverage(result)
    return result


def predicted_slopes(run: xr.Dataset, facility: Facility, prediction: xr.Dataset) -> dict[str, Slope]:
    """Relative slopes of a predicted reflectance factor at the points of a run.

    A sensitivity is the whole response of the reading; what the flux does is taken off, so that both ways agree.

    Raises
    ------
    InputError
        If the prediction lacks a geometry of the run.
    """
    rows = _rows(run, prediction)
    parameters = [str(name) for name in prediction["parameter"].values] if "sensitivity" in prediction else []
    brf = prediction["brf"].values
    measured = brf_slopes(geometry_columns(prediction), brf)
    flux = flux_slopes(facility, geometry_columns(prediction)) if parameters else {}
    result = {}
    for angle in ANGLES:
        if (label := angle.replace("_", " ")) in parameters:
            response = prediction["sensitivity"].values[:, parameters.index(label)] / brf
            result[angle] = Slope((response - flux[angle])[rows], np.ones(len(rows), dtype=bool))
        else:
            result[angle] = Slope(measured[angle].relative[rows], measured[angle].known[rows])
    return result


def compared_slopes(run: xr.Dataset, facility: Facility) -> list[dict[str, Any]]:
    """What the slopes of the run make of each angle's uncertainty, per cent of brf, beside what its budget says."""
    brf = np.abs(run["brf"].values)
    rows = []
    for angle, term in angle_terms(_left_to_slopes(facility), geometry_columns(run), run["brf"].values).items():
        u = getattr(facility.arms, f"u_{angle}")
        name = COMPONENTS[angle]
        if u > 0 and name in run and isinstance(getattr(facility.budget, angle), float | tuple):
            stated = _range(run[name].values / brf)
            rows.append({"angle": angle, "u_degree": u, "stated": stated, "slope": _range(np.abs(term.signed) / brf)})
    return rows


def _left_to_slopes(facility: Facility) -> Facility:
    """The same facility with the term of every uncertain angle left to the slope; the paper's way stays where asked."""
    uncertain = [angle for angle in ANGLES if getattr(facility.arms, f"u_{angle}") > 0]
    rows = {angle: "slope" for angle in uncertain if not isinstance(getattr(facility.budget, angle), str)}
    return facility.model_copy(update={"budget": facility.budget.model_copy(update=rows)})


def _range(relative: FloatArray) -> list[float]:
    return [float(value) for value in 100 * np.percentile(relative, [0, 50, 100])]


def _rows(run: xr.Dataset, prediction: xr.Dataset) -> list[int]:
    """Row of the prediction for every point of the run."""
    axes = [name for name in geometry_columns(run) if name in prediction.variables]
    where = {key: row for row, key in enumerate(_keys(prediction, axes))}
    keys = _keys(run, axes)
    missing = [key for key in keys if key not in where]
    if missing:
        said = ", ".join(f"{axis} {value:g}" for axis, value in zip(axes, missing[0], strict=True))
        raise InputError(f"the prediction lacks {len(missing)} of {len(keys)} points of the run; the first: {said}")
    return [where[key] for key in keys]


def _keys(data: xr.Dataset, axes: list[str]) -> list[tuple[Any, ...]]:
    columns = (data[axis].values for axis in axes)
    return list(zip(*(np.round(c, 4).tolist() if c.dtype.kind in "iuf" else c.tolist() for c in columns), strict=True))
