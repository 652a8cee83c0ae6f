"""Variables of a netCDF file as the columns of a table: for :mod:`instrument.column_mapping`.

Variables may lie along one dimension, a row a point, or span a grid: then every point of the grid is a row, and those
where a value is missing were not measured.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.errors import InputError

NETCDF_SUFFIXES = (".nc", ".nc4", ".cdf", ".h5")
#: Spellings of a unit in the files of others, by ours in a mapping.
_SPELLINGS = {
    "nm": ("nm", "nanometer", "nanometers", "nanometre", "nanometres"),
    "um": ("um", "μm", "µm", "micrometer", "micrometers", "micron", "microns", "micrometre", "micrometres"),
    "m": ("m", "meter", "metre"),
    "degree": ("degree", "degrees", "deg", "°", "degree_angle"),
    "rad": ("rad", "radian", "radians"),
    "1": ("1", "", "dimensionless", "unitless", "-"),
    "%": ("%", "percent"),
    "1/sr": ("1/sr", "sr-1", "sr^-1", "sr**-1", "1/steradian"),
}


class Variables:
    """Columns of a netCDF file, read at once.

    Parameters
    ----------
    path
        netCDF-4 or HDF5 with dimension scales.
    mapping
        The mapping file, for messages.
    wanted
        Names of variables, and the unit that the mapping takes them to be in; empty where it says nothing.

    Raises
    ------
    InputError
        For a file that cannot be read, a variable that is missing, is no number, or states another unit.
    """

    def __init__(self, path: Path, mapping: Path, wanted: Mapping[str, str]) -> None:
        self._path = path
        dataset = _opened(path)
        for name, unit in wanted.items():
            if name not in dataset.variables:
                found = ", ".join(map(str, dataset.variables))
                raise InputError(f"{mapping}: column {name!r}: not in {path}; found {found}")
            array = dataset[name]
            if array.dtype.kind not in "iufb":
                raise InputError(f"{path}: {name}: found {array.dtype}; expected numbers")
            stated = str(array.attrs.get("units", "")).strip()
            if unit and stated and stated not in _SPELLINGS[unit]:
                raise InputError(f"{mapping}: column {name!r}: taken for {unit}; {path} says {stated!r}")
        arrays = xr.broadcast(*(dataset[name].drop_vars(list(dataset[name].coords)) for name in wanted))
        self._columns = {name: array.values.ravel().astype(float) for name, array in zip(wanted, arrays, strict=True)}

    def numbers(self, name: str) -> FloatArray:
        """Values of a variable, one a row."""
        return self._columns[name]

    def present(self) -> NDArray[np.bool_]:
        """Rows where nothing is missing; a grid has some that were not measured.

        Raises
        ------
        InputError
            If there is none.
        """
        kept = np.all([np.isfinite(values) for values in self._columns.values()], axis=0)
        if not np.any(kept):
            names = ", ".join(self._columns)
            raise InputError(f"{self._path}: no point has a value of each of {names}; expected at least one")
        return np.asarray(kept)

    def __len__(self) -> int:
        return len(next(iter(self._columns.values())))


def _opened(path: Path) -> xr.Dataset:
    if not path.exists():
        raise InputError(f"{path}: no such file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what a foreign file does wrong is said by the checks
            with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
                return dataset.load()
    except (OSError, ValueError, KeyError, RuntimeError, OverflowError, TypeError, AttributeError) as error:
        words = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: cannot be read as netCDF-4: {words}") from None
