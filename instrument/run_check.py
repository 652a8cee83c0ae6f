"""Checks that a dataset is a run file or a prediction; every message names file, variable and what was expected."""

from __future__ import annotations

import difflib
from collections.abc import Mapping

import numpy as np
import xarray as xr

from instrument.errors import InputError
from instrument.plan_units import looks_like_radians, wavelength_unit
from instrument.run_schema import ALIASES, GLOBALS, REQUIRED, SCAN_DIRECTIONS, UNIT_SPELLINGS, Variable

#: How alike an unknown name must be to a missing known one to count as a slip.
_LIKENESS = 0.8
_NUMERIC = "iufb"
#: Coordinates of instruments with more than three arms (:mod:`instrument.run_axes`): never a slip of another name.
_FURTHER = ("sample_rotation", "polarization", "repetition")


def checked(dataset: xr.Dataset, source: str, known: Mapping[str, Variable]) -> xr.Dataset:
    """The same dataset with units in the contract's spelling and coordinates set.

    Parameters
    ----------
    dataset
        As it was read or made.
    source
        Name of the file, for messages.
    known
        Variables that have a fixed meaning.

    Raises
    ------
    InputError
        For a variable that is missing, mis-named, mis-united, of the wrong shape, or not finite.
    """
    _check_names(dataset, source, known)
    result = dataset.copy()
    unstated = [name for name, v in known.items() if v.unit and name in result and "units" not in result[name].attrs]
    for name, variable in known.items():
        if name in result.variables:
            _check_shape(result[name], variable, source)
            _check_unit(result[name], variable, source)
            _check_numbers(result[name], variable, source)
            if variable.unit is not None:
                result[name].attrs["units"] = variable.unit
    if result.sizes["point"] == 0:
        raise InputError(f"{source}: no points; expected at least one")
    _check_uncertainties(result, source)
    _check_angles(result, source)
    _check_unstated(result, source, unstated)
    _check_globals(result, source)
    result = result.set_coords([name for name, v in known.items() if v.coordinate and name in result.variables])
    result.encoding["unstated_units"] = unstated
    return result


def _check_names(dataset: xr.Dataset, source: str, known: Mapping[str, Variable]) -> None:
    found = [str(name) for name in dataset.variables]
    strangers = [name for name in found if name not in (*known, *_FURTHER, *dataset.dims)]
    for name, variable in known.items():
        if name in found:
            continue
        slip = _slip(name, strangers)
        if slip is not None:
            raise InputError(
                f"{source}: {slip}: unknown variable; did you mean {name!r} ({_expected(variable)})?"
                if name not in REQUIRED
                else f"{source}: {name}: missing; expected {_expected(variable)}; found {slip!r}, is that it?"
            )
        if name in REQUIRED:
            raise InputError(f"{source}: {name}: missing; expected {_expected(variable)}; found {', '.join(found)}")


def _slip(name: str, strangers: list[str]) -> str | None:
    for stranger in strangers:
        if stranger in ALIASES.get(name, ()) or stranger.lower() == name:
            return stranger
    close = difflib.get_close_matches(name, strangers, n=1, cutoff=_LIKENESS)
    return close[0] if close else None


def _expected(variable: Variable) -> str:
    unit = f" in {variable.unit}" if variable.unit not in (None, "1") else ""
    return f"{variable.long_name}{unit}, dimensions ({', '.join(variable.dims)})"


def _check_shape(array: xr.DataArray, variable: Variable, source: str) -> None:
    if array.dims != variable.dims:
        raise InputError(
            f"{source}: {variable.name}: found dimensions ({', '.join(map(str, array.dims))});"
            f" expected ({', '.join(variable.dims)})"
        )
    time = variable.name in ("time", "reference_time")
    if time and array.dtype.kind != "M":
        raise InputError(f"{source}: {variable.name}: not a time; expected CF time (units like 'seconds since ...')")
    if not time and array.dtype.kind not in _NUMERIC:
        raise InputError(f"{source}: {variable.name}: found {array.dtype}; expected numbers")


def _check_unit(array: xr.DataArray, variable: Variable, source: str) -> None:
    if variable.unit is None or "units" not in array.attrs:
        return
    found = str(array.attrs["units"]).strip()
    if found in UNIT_SPELLINGS[variable.unit]:
        return
    hint = "; a BRDF in sr-1 times pi is a reflectance factor" if found in ("sr-1", "1/sr", "sr^-1") else ""
    raise InputError(f"{source}: {variable.name}: found unit {found!r}; expected {variable.unit!r}{hint}")


def _check_numbers(array: xr.DataArray, variable: Variable, source: str) -> None:
    bad = np.isnat(array.values) if array.dtype.kind == "M" else ~np.isfinite(array.values)
    if np.any(bad):
        where = ", ".join(f"{dim} {index}" for dim, index in zip(array.dims, np.argwhere(bad)[0], strict=True))
        raise InputError(
            f"{source}: {variable.name}: no finite value at {where} ({int(bad.sum())} such values);"
            " leave out points that were not measured"
        )


def _check_uncertainties(dataset: xr.Dataset, source: str) -> None:
    for name in (str(name) for name in dataset.data_vars):
        if name != "u_brf" and not name.startswith("u_brf_"):
            continue
        values = dataset[name].values
        bad = values <= 0 if name == "u_brf" else values < 0
        if np.any(bad):
            point = int(np.argmax(bad))
            raise InputError(
                f"{source}: {name}: found {values[point]:g} at point {point};"
                f" expected a standard uncertainty {'above 0' if name == 'u_brf' else 'of 0 or more'}"
            )


def _check_angles(dataset: xr.Dataset, source: str) -> None:
    for name in ("illumination_zenith", "sensor_zenith"):
        values = dataset[name].values
        if np.any(np.abs(values) > 90):
            point = int(np.argmax(np.abs(values) > 90))
            raise InputError(f"{source}: {name}: found {values[point]:g} at point {point}; expected -90 to 90 degrees")
    for name in ("illumination_azimuth", "sensor_azimuth"):
        values = dataset[name].values
        if np.any(np.abs(values) > 360):
            point = int(np.argmax(np.abs(values) > 360))
            raise InputError(
                f"{source}: {name}: found {values[point]:g} at point {point}; expected -360 to 360 degrees"
            )
    unit = wavelength_unit([float(value) for value in np.unique(dataset["wavelength"].values)])
    if unit is not None:
        found = float(dataset["wavelength"].values[0])
        raise InputError(f"{source}: wavelength: found {found:g}; expected nm (are these {unit}?)")


def _check_unstated(dataset: xr.Dataset, source: str, unstated: list[str]) -> None:
    """Without a unit attribute, numbers that look like radians are not taken for degrees."""
    for name in ("sensor_zenith", "illumination_zenith"):
        if name in unstated and looks_like_radians([float(v) for v in np.unique(dataset[name].values)], 1.58):
            raise InputError(
                f"{source}: {name}: no unit, and no value beyond pi/2; expected degrees (are these radians?"
                " If they are degrees, say so with a unit attribute in a netCDF file)"
            )


def _check_globals(dataset: xr.Dataset, source: str) -> None:
    for name, (kind, _) in GLOBALS.items():
        if name not in dataset.attrs:
            continue
        value = dataset.attrs[name]
        if kind is float:
            if not np.isscalar(value) or isinstance(value, str) or not np.isfinite(float(np.real(value))):
                raise InputError(f"{source}: global attribute {name}: found {value!r}; expected a number")
        elif value not in SCAN_DIRECTIONS:
            raise InputError(
                f"{source}: global attribute {name}: found {value!r}; expected {' or '.join(SCAN_DIRECTIONS)}"
            )


def component_names(dataset: xr.Dataset) -> list[str]:
    """Uncertainty components that a run holds: of those that ``brf`` lists, or else of every ``u_brf_*``."""
    listed = listed_components(dataset)
    if listed is None:
        return [str(n) for n in dataset.data_vars if str(n).startswith("u_brf_") and n != "u_brf_monte_carlo"]
    return [name for name in listed if name in dataset.variables]


def listed_components(dataset: xr.Dataset) -> list[str] | None:
    """What the attribute ``unc_comps`` of ``brf`` says; None without it."""
    listed = dataset["brf"].attrs.get("unc_comps")
    return None if listed is None else [str(name) for name in np.atleast_1d(listed)]
