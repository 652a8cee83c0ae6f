"""Reading run files and predictions, from netCDF and CSV."""

from __future__ import annotations

import warnings
from pathlib import Path

import xarray as xr

from instrument.errors import InputError
from instrument.run_check import checked, component_names, listed_components
from instrument.run_csv import read_csv
from instrument.run_schema import GLOBALS, PREDICTION, REQUIRED, RUN


def read_run(path: Path) -> xr.Dataset:
    """Read a measurement, of this program or of any other, from netCDF-4 (``.nc``) or CSV (``.csv``).

    A file with no more than the coordinates, ``brf`` and ``u_brf`` is accepted; :func:`capabilities` tells what
    cannot be done with it.

    Returns
    -------
    xarray.Dataset
        In memory; units in the spelling of the data contract, angles and time as coordinates.

    Raises
    ------
    InputError
        Naming file and variable, what was found and what was expected.
    """
    dataset = read_csv(path) if path.suffix.lower() == ".csv" else _open(path)
    return checked(dataset, str(path), RUN)


def read_prediction(path: Path) -> xr.Dataset:
    """Read a prediction (``prediction.nc``); errors as :func:`read_run`."""
    return checked(_open(path), str(path), REQUIRED | PREDICTION)


def _open(path: Path) -> xr.Dataset:
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected a netCDF-4 or CSV file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what a foreign file does wrong is said by the checks
            with xr.open_dataset(path, engine="h5netcdf") as dataset:
                loaded = dataset.load()
    except (OSError, ValueError, KeyError, RuntimeError, OverflowError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: {_unreadable(path, error)}") from None
    if "point" not in loaded.dims:
        found = ", ".join(map(str, loaded.dims)) or "none"
        raise InputError(f"{path}: dimension point: missing; found {found}; expected one row a point")
    return loaded


def _unreadable(path: Path, error: Exception) -> str:
    try:
        start = path.read_bytes()[:8]
    except OSError as reason:
        return f"cannot be read ({reason.strerror})"
    if start.startswith(b"CDF"):
        return "a netCDF-3 file; expected netCDF-4 (convert it with nccopy -k netCDF-4)"
    if start != b"\x89HDF\r\n\x1a\n":
        return "not a netCDF-4 file"
    return (
        f"a damaged or truncated netCDF-4 file ({str(error).splitlines()[0] if str(error) else type(error).__name__})"
    )


def capabilities(dataset: xr.Dataset) -> list[str]:
    """What a run cannot support and why, one sentence each; empty when it holds everything."""
    lacks = []
    has = set(map(str, dataset.variables))
    if "time" not in has:
        lacks.append("no `time`: no test for drift of the source")
    if not {"signal", "dark", "gain"} <= has:
        missing = ", ".join(f"`{name}`" for name in ("signal", "dark", "gain") if name not in has)
        lacks.append(f"no {missing}: no test of dark offset, linearity, gain steps or the noise of the readings")
    if not {"reference_signal", "reference_dark", "reference_gain"} <= has:
        lacks.append("no reference readings: `brf` cannot be recomputed, its calibration is taken as it stands")
    if "quality_flag" not in has:
        lacks.append("no `quality_flag`: saturated or repeated points cannot be told from good ones")
    components = component_names(dataset)
    if not components:
        lacks.append("no uncertainty components: how the errors of points are correlated is not known")
    gone = [name for name in listed_components(dataset) or () if name not in has]
    if components and gone:
        lacks.append(
            f"no {', '.join(f'`{name}`' for name in gone)}, which `unc_comps` lists: the budget is not complete"
        )
    unstated = [name for name in components if "err_corr_1_form" not in dataset[name].attrs]
    if unstated:
        lacks.append(f"no correlation stated for {', '.join(f'`{name}`' for name in unstated)}")
    for name, (_, reason) in GLOBALS.items():
        if name not in dataset.attrs:
            lacks.append(f"no global attribute `{name}`: {reason}")
    assumed = dataset.encoding.get("unstated_units", ())
    if assumed:
        names = ", ".join(f"`{name}`" for name in assumed)
        lacks.append(f"no unit stated for {names}: the units of the data contract are assumed")
    return lacks
