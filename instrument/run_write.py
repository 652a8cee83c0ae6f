"""Writing run files and predictions: netCDF-4, CF-1.11, atomically."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from instrument.files import replacing
from instrument.run_budget import correlated
from instrument.run_check import checked
from instrument.run_csv import write_csv
from instrument.run_schema import CONVENTIONS, FLAG_MASKS, PREDICTION, REQUIRED, RUN, Variable

#: Times are stored as whole nanoseconds, which is exact.
_TIME_ENCODING = {"units": "nanoseconds since 1970-01-01", "dtype": "int64", "calendar": "proleptic_gregorian"}


def write_run(dataset: xr.Dataset, path: Path) -> None:
    """Write a run, as netCDF-4 or, where the name ends in ``.csv``, as a table; the old file stays until the new
    one is complete.

    Raises
    ------
    InputError
        If the dataset is no run (as :func:`~instrument.run_read.read_run`).
    """
    if path.suffix.lower() == ".csv":
        write_csv(dataset, path)
    else:
        _write(dataset, path, RUN)


def write_prediction(dataset: xr.Dataset, path: Path) -> None:
    """Write a prediction (``prediction.nc``); errors as :func:`write_run`."""
    _write(_with_components(dataset), path, REQUIRED | PREDICTION)


def _with_components(prediction: xr.Dataset) -> xr.Dataset:
    """A prediction that says, after the obsarray convention, what its uncertainty is made of, where it does not yet.

    Errors of the ray tracer are independent from point to point. Those of the inputs are not; how they correlate is in
    the file where it was worked out (``goniotwin predict --uncertainty``), and otherwise stated by nobody.
    """
    parts = [name for name in ("u_brf_inputs", "u_brf_monte_carlo") if name in prediction]
    if "u_brf_monte_carlo" not in parts or "unc_comps" in prediction["brf"].attrs:
        return prediction
    result = prediction.copy()
    result["u_brf_monte_carlo"].attrs = correlated("random") | result["u_brf_monte_carlo"].attrs
    result["brf"].attrs["unc_comps"] = parts
    return result


def described(dataset: xr.Dataset, known: Mapping[str, Variable]) -> xr.Dataset:
    """The dataset with the attributes that the conventions ask for, where it does not have them already."""
    result = dataset.copy()
    result.attrs = {"Conventions": CONVENTIONS} | dict(dataset.attrs)
    for name, variable in known.items():
        if name in result.variables:
            attributes: dict[str, Any] = {"long_name": variable.long_name} | variable.attributes
            if variable.unit is not None:
                attributes["units"] = variable.unit
            result[name].attrs = attributes | result[name].attrs
    if "quality_flag" in result:
        result["quality_flag"] = result["quality_flag"].astype(np.int8)
        result["quality_flag"].attrs["flag_masks"] = np.array(FLAG_MASKS, dtype=np.int8)
    return result


def _write(dataset: xr.Dataset, path: Path, known: Mapping[str, Variable]) -> None:
    result = described(checked(dataset, str(path), known), known)
    encoding: dict[str, dict[str, Any]] = {}
    for name, array in result.variables.items():
        array.encoding = {}
        if array.dtype.kind == "M":
            encoding[str(name)] = dict(_TIME_ENCODING)
        elif array.dtype.kind == "f":
            encoding[str(name)] = {"_FillValue": None}
    with replacing(path) as part:
        result.to_netcdf(part, engine="h5netcdf", encoding=encoding)
