"""Tables of other laboratories: a mapping file says which of their columns is which coordinate.

The mapping is a TOML file of the project's own form (``docs/column_mapping.md``); the table is any delimited text with
one row a point, or a netCDF file whose variables are the columns. The result is a run as the data contract has it,
checked like one.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field, model_validator

from instrument.angles import FloatArray
from instrument.budget import COMPONENTS
from instrument.errors import InputError
from instrument.files import text_of
from instrument.forms import Form, read_form
from instrument.mapped_variables import NETCDF_SUFFIXES, Variables
from instrument.run_check import checked
from instrument.run_schema import RUN

#: What turns a value in a unit into the contract's unit.
UNITS = {
    "nm": {"nm": 1.0, "um": 1e3, "m": 1e9},
    "degree": {"degree": 1.0, "rad": 180 / np.pi},
    # A BRDF times pi is a reflectance factor.
    "1": {"1": 1.0, "%": 0.01, "1/sr": np.pi},
}
_GEOMETRY = {
    "wavelength": "nm",
    "illumination_zenith": "degree",
    "illumination_azimuth": "degree",
    "sensor_zenith": "degree",
    "sensor_azimuth": "degree",
}


class Source(Form):
    """Where a value comes from: a column, or a constant for every row.

    Attributes
    ----------
    column
        Name in the header.
    constant
        Value of every row instead.
    unit
        Of either; by default the contract's.
    least
        Smaller values count as this one (an uncertainty that a table rounds to zero).
    relative
        The value is relative to ``brf``; for uncertainties.
    """

    column: str | None = None
    constant: float | None = None
    unit: str | None = None
    least: float | None = None
    relative: bool = False

    @model_validator(mode="after")
    def _one(self) -> Source:
        if (self.column is None) == (self.constant is None):
            raise ValueError("expected either column or constant")
        return self


class Rows(Form):
    """Rows that are kept: those whose value in a column is one of these, or lies between two."""

    column: str
    one_of: tuple[float, ...] | None = None
    least: float | None = None
    most: float | None = None


class Table(Form):
    """How the text is laid out.

    Attributes
    ----------
    delimiter
        Between columns.
    header
        Line of the names, counted from 1.
    comment
        Lines that begin with it are no rows; before the names it is taken off.
    """

    delimiter: Annotated[str, Field(min_length=1, max_length=1)] = ","
    header: Annotated[int, Field(ge=1)] = 1
    comment: str = "#"


class Clock(Form):
    """When a row was read: a column of seconds since a moment."""

    column: str
    since: str = "1970-01-01T00:00:00"


class ColumnMapping(Form):
    """The mapping file.

    Attributes
    ----------
    form, version
        Of the file.
    table
        How the text is laid out.
    columns
        By name in the data contract: the five coordinates, ``brf``, and ``u_brf`` or components of it.
    time
        When rows were read.
    rows
        All must hold for a row to be kept.
    arm_on_other_side_above
        Sensor azimuth relative to the light, in degree, above which the sensor arm stood on its other side: the azimuth
        that was commanded lies 180 degrees lower, with the zenith negative. The direction is the same.
    """

    form: Literal["column mapping"]
    version: Literal[1]
    table: Table = Table()
    columns: dict[str, Source]
    time: Clock | None = None
    rows: tuple[Rows, ...] = ()
    arm_on_other_side_above: float | None = None

    @model_validator(mode="after")
    def _complete(self) -> ColumnMapping:
        components = tuple(COMPONENTS.values())
        known = (*_GEOMETRY, "brf", "u_brf", *components)
        missing = [name for name in (*_GEOMETRY, "brf") if name not in self.columns]
        if missing:
            raise ValueError(f"columns: {', '.join(missing)} missing")
        if not any(name in self.columns for name in ("u_brf", *components)):
            raise ValueError("columns: u_brf missing; expected it or components of it (u_brf_noise, ...)")
        for name, source in self.columns.items():
            if name not in known:
                raise ValueError(f"columns: {name} is not known; expected one of {', '.join(known)}")
            units = UNITS[_GEOMETRY.get(name, "1")]
            if source.unit is not None and source.unit not in units:
                raise ValueError(f"columns.{name}: unit {source.unit!r}; expected one of {', '.join(units)}")
            if source.relative and source.unit == "1/sr":
                raise ValueError(f"columns.{name}: relative to brf, and in 1/sr; expected 1 or %")
            if source.relative and not name.startswith("u_"):
                raise ValueError(f"columns.{name}: only an uncertainty can be relative to brf")
        return self


def read_mapped(path: Path, mapping: Path) -> xr.Dataset:
    """Read a table of any laboratory as a run.

    Raises
    ------
    InputError
        Naming the file and what is wrong with it or with the mapping.
    """
    form = read_form(mapping, ColumnMapping)
    if path.suffix.lower() in NETCDF_SUFFIXES:
        columns: _Columns | Variables = Variables(path, mapping, _named(form))
    else:
        columns = _Columns(path, mapping, *_read_table(path, form.table))
    kept = _kept(form.rows, columns)
    if not np.any(kept):
        raise InputError(f"{path}: no row is left by rows of {mapping}; expected at least one")
    values = {name: _of(name, source, columns)[kept] for name, source in form.columns.items()}
    for name, source in form.columns.items():
        if source.relative:
            values[name] = values[name] * values["brf"]
    if "u_brf" not in values:
        values["u_brf"] = np.sqrt(np.sum([values[n] ** 2 for n in values if n.startswith("u_brf_")], axis=0))
    if form.arm_on_other_side_above is not None:
        values |= _other_side(values, "sensor_azimuth", "illumination_azimuth", form)
    variables: dict[str, tuple[tuple[str, ...], NDArray[np.generic]]] = {n: (("point",), v) for n, v in values.items()}
    if form.time is not None:
        start = _moment(form.time.since, mapping)
        seconds = columns.numbers(form.time.column)[kept]
        variables["time"] = (("point",), start + np.round(seconds * 1e9).astype("timedelta64[ns]"))
    run = xr.Dataset(variables)
    for name in values:
        run[name].attrs["units"] = _GEOMETRY.get(name, "1")
    if form.time is not None:
        run = run.isel(point=np.argsort(run["time"].values, kind="stable"))
    return checked(run, str(path), RUN)


class _Columns:
    """Columns of a table by name, as numbers."""

    def __init__(self, path: Path, mapping: Path, names: list[str], rows: list[list[str]]) -> None:
        self._path, self._mapping, self._names, self._rows = path, mapping, names, rows

    def numbers(self, name: str) -> FloatArray:
        if name not in self._names:
            raise InputError(f"{self._mapping}: column {name!r}: not in {self._path}; found {', '.join(self._names)}")
        place = self._names.index(name)
        found = np.empty(len(self._rows))
        for number, row in enumerate(self._rows):
            try:
                found[number] = float(row[place])
            except ValueError:
                text = row[place].strip()
                raise InputError(f"{self._path}: row {number + 1}: {name}: found {text!r}; expected a number") from None
        return found

    def present(self) -> NDArray[np.bool_]:
        """Every row of a text was measured."""
        return np.ones(len(self._rows), dtype=bool)

    def __len__(self) -> int:
        return len(self._rows)


def _read_table(path: Path, layout: Table) -> tuple[list[str], list[list[str]]]:
    lines = text_of(path, encoding="utf-8-sig").splitlines()
    if len(lines) < layout.header:
        raise InputError(f"{path}: found {len(lines)} lines; expected names in line {layout.header}")
    head = lines[layout.header - 1].lstrip()
    names = [_bare(text) for text in next(csv.reader([head.removeprefix(layout.comment)], delimiter=layout.delimiter))]
    rows = []
    for number, line in enumerate(lines[layout.header :], start=layout.header + 1):
        if not line.strip() or (layout.comment and line.lstrip().startswith(layout.comment)):
            continue
        row = next(csv.reader([line], delimiter=layout.delimiter))
        if len(row) != len(names):
            raise InputError(f"{path}: line {number}: found {len(row)} columns; expected {len(names)} as in the header")
        rows.append(row)
    if not rows:
        raise InputError(f"{path}: no rows; expected one a point")
    return names, rows


def _bare(text: str) -> str:
    return text.strip().strip("'\"").strip()


def _named(form: ColumnMapping) -> dict[str, str]:
    """Columns that the mapping names, and the unit in which their values are wanted (empty: any)."""
    names = {
        source.column: source.unit or _GEOMETRY.get(name, "1") for name, source in form.columns.items() if source.column
    }
    if form.time is not None:
        names.setdefault(form.time.column, "")
    for rule in form.rows:
        names.setdefault(rule.column, "")
    return names


def _kept(rules: tuple[Rows, ...], columns: _Columns | Variables) -> NDArray[np.bool_]:
    kept = columns.present()
    for rule in rules:
        values = columns.numbers(rule.column)
        if rule.one_of is not None:
            kept &= np.isin(values, rule.one_of)
        if rule.least is not None:
            kept &= values >= rule.least
        if rule.most is not None:
            kept &= values <= rule.most
    return kept


def _of(name: str, source: Source, columns: _Columns | Variables) -> FloatArray:
    unit = _GEOMETRY.get(name, "1")
    factor = UNITS[unit][source.unit or unit]
    if source.column is None:
        assert source.constant is not None
        values = np.full(len(columns), source.constant)
    else:
        values = columns.numbers(source.column)
    if source.least is not None:
        values = np.maximum(values, source.least)
    return np.asarray(values * factor)


def _other_side(values: dict[str, FloatArray], sensor: str, light: str, form: ColumnMapping) -> dict[str, FloatArray]:
    """The commanded angles of rows that were reached with the sensor arm on its other side."""
    assert form.arm_on_other_side_above is not None
    turned = light if form.columns[light].column is not None else sensor
    apart = values[sensor] - values[light]
    other = np.abs(apart) > form.arm_on_other_side_above
    azimuth = np.where(other, values[turned] - 180.0, values[turned])
    return {turned: azimuth, "sensor_zenith": np.where(other, -values["sensor_zenith"], values["sensor_zenith"])}


def _moment(text: str, mapping: Path) -> np.datetime64:
    try:
        return np.datetime64(text.removesuffix("Z"), "ns")
    except ValueError:
        raise InputError(f"{mapping}: time.since: found {text!r}; expected UTC like 2026-03-02T08:00:00Z") from None
