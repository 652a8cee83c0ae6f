"""The run file as a plain table: one row a point, header with the names of the data contract.

What does not fit a row is written so that it does: the samples of a point as ``signal_1`` ... ``signal_9``, a global
attribute as a column that is constant. The readings of the reference have no place in it.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import xarray as xr

from instrument.errors import InputError
from instrument.files import write_atomically
from instrument.run_check import checked
from instrument.run_schema import GLOBALS, RUN

_SAMPLE = re.compile(r"signal_(\d+)")


def read_csv(path: Path) -> xr.Dataset:
    """Read the table; not yet checked against the data contract.

    Raises
    ------
    InputError
        Naming line and column of text where a number is expected, of a row that is too short or too long.
    """
    header, rows = _rows(path)
    columns = {name: [row[i] for row in rows] for i, name in enumerate(header)}
    attributes = {name: _constant(path, name, columns.pop(name)) for name in GLOBALS if name in columns}
    samples = sorted((name for name in columns if _SAMPLE.fullmatch(name)), key=lambda name: int(name[7:]))
    variables: dict[str, tuple[tuple[str, ...], np.ndarray]] = {}
    if samples:
        volts = [_numbers(path, name, columns.pop(name)) for name in samples]
        variables["signal"] = (("point", "sample"), np.stack(volts, axis=-1))
    for name, texts in columns.items():
        if name == "time":
            variables[name] = (("point",), _times(path, texts))
        elif name == "quality_flag":
            variables[name] = (("point",), _numbers(path, name, texts).astype(np.int8))
        elif name != "point":
            variables[name] = (("point",), _numbers(path, name, texts))
    return xr.Dataset(variables, attrs=attributes)


def write_csv(dataset: xr.Dataset, path: Path) -> None:
    """Write a run as a table, atomically; the readings of the reference are left out."""
    run = checked(dataset, str(path), RUN)
    columns: dict[str, list[str]] = {}
    for name in [*RUN, *(n for n in map(str, run.variables) if n not in RUN)]:
        if name not in run.variables or name == "point":
            continue
        array = run[name]
        if array.dims == ("point", "sample") and name == "signal":
            columns |= {f"signal_{i + 1}": _texts(array.values[:, i]) for i in range(run.sizes["sample"])}
        elif array.dims == ("point",) and array.dtype.kind in "iufbM":
            columns[name] = _texts(array.values)
    for name in GLOBALS:
        if name in run.attrs:
            columns[name] = [str(run.attrs[name])] * run.sizes["point"]
    lines = [",".join(columns), *(",".join(row) for row in zip(*columns.values(), strict=True))]
    write_atomically(path, ("\n".join(lines) + "\n").encode())


def _texts(values: np.ndarray) -> list[str]:
    if values.dtype.kind == "M":
        return [str(text) + "Z" for text in np.datetime_as_string(values, unit="ns")]
    return [repr(value) for value in values.tolist()]


def _rows(path: Path) -> tuple[list[str], list[list[str]]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as handle:
            table = [(number, row) for number, row in enumerate(csv.reader(handle), start=1) if any(row)]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; expected a CSV table") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a CSV table ({error})") from None
    if not table:
        raise InputError(f"{path}: empty; expected a header and one row a point")
    header = [name.strip() for name in table[0][1]]
    doubled = sorted({name for name in header if header.count(name) > 1})
    if doubled:
        raise InputError(f"{path}: header: {doubled[0]!r} stands twice")
    for number, row in table[1:]:
        if len(row) != len(header):
            raise InputError(
                f"{path}: line {number}: found {len(row)} columns; expected {len(header)} as in the header"
            )
    return header, [row for _, row in table[1:]]


def _numbers(path: Path, name: str, texts: list[str]) -> np.ndarray:
    values = np.empty(len(texts))
    for row, text in enumerate(texts):
        try:
            values[row] = float(text)
        except ValueError:
            raise InputError(f"{path}: row {row + 1}: {name}: found {text!r}; expected a number") from None
    return values


def _times(path: Path, texts: list[str]) -> np.ndarray:
    values = np.empty(len(texts), dtype="datetime64[ns]")
    for row, text in enumerate(texts):
        try:
            values[row] = np.datetime64(text.strip().removesuffix("Z").removesuffix("+00:00"), "ns")
        except ValueError:
            raise InputError(
                f"{path}: row {row + 1}: time: found {text!r}; expected UTC like 2026-03-02T08:00:00Z"
            ) from None
    return values


def _constant(path: Path, name: str, texts: list[str]) -> float | str:
    different = sorted(set(texts))
    if len(different) != 1:
        raise InputError(f"{path}: {name}: found {', '.join(different[:3])}; expected one value for the whole run")
    if GLOBALS[name][0] is str:
        return different[0]
    return float(_numbers(path, name, different)[0])
