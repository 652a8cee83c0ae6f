"""Tables of points as laboratories write them: CSV, one row a point, units in the header.

A column is called ``sensor_zenith``, ``sensor_zenith (deg)``, ``sensor_zenith [rad]`` or ``sensor_zenith / degree``;
without a unit it is in degree, a wavelength in nm. Commas, semicolons or tabs part the columns; where semicolons do, a
number may be written with a decimal comma. Empty lines, and lines that begin with ``#``, are no rows.
"""

from __future__ import annotations

import csv
import difflib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from instrument.errors import InputError
from instrument.events import Polarization
from instrument.files import text_of
from instrument.plan_forms import tidy
from instrument.plan_units import check_units
from instrument.run_schema import ALIASES

NEEDED = ("wavelength", "illumination_zenith", "sensor_azimuth", "sensor_zenith")
OPTIONAL = ("illumination_azimuth", "sample_rotation", "polarization")
COLUMNS = (*NEEDED, *OPTIONAL)
_WORDS = get_args(Polarization)
_DEGREES = dict.fromkeys(("deg", "degree", "degrees", "°"), 1.0)
_RADIANS = dict.fromkeys(("rad", "radian", "radians"), 180.0 / math.pi)
_LENGTHS = {"nm": 1.0, "nanometre": 1.0, "nanometer": 1.0, "um": 1e3, "µm": 1e3, "μm": 1e3, "micrometre": 1e3}
_HEADER = re.compile(r"\s*(?P<name>[^()\[\]/]+?)\s*(?:[(\[]\s*(?P<unit>[^()\[\]]*?)\s*[)\]]|/\s*(?P<other>\S+))?\s*")
#: A table larger than this is no plan, bytes.
_LARGEST = 200_000_000


@dataclass(frozen=True)
class PointTable:
    """Rows of a table in nm and degree.

    Attributes
    ----------
    columns
        Names, of :data:`COLUMNS`.
    rows
        One value a column; the polarisation is a word.
    lines
        Line of each row in the file, for messages.
    source
        The file.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[float | str, ...], ...]
    lines: tuple[int, ...]
    source: str

    def place(self, row: int) -> str:
        """Where a row (from 0) is to be found, for messages."""
        return f"{self.source}: row {self.lines[row]}"


def table_path(name: str, folder: Path, where: str) -> Path:
    """The file of a table, which has to lie in the folder of its plan.

    Parameters
    ----------
    where
        File and key, for the message.

    Raises
    ------
    InputError
        If the name leads out of the folder, be it by ``..``, as an absolute path or through a link.
    """
    home = folder.resolve()
    try:
        path = (home / name).resolve()
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"{where}: table: found {name!r}; no name of a file ({error})") from None
    if path == home or home not in path.parents:
        raise InputError(f"{where}: table: found {name!r}; expected a file in the folder of the plan, or below it")
    return path


def read_table(path: Path, lacking: Sequence[str] = (), *, guess: bool = True) -> PointTable:
    """Read a CSV table of points.

    Parameters
    ----------
    lacking
        Columns that the plan gives for all rows.
    guess
        Refuse numbers without a unit that look like radians or micrometres.

    Raises
    ------
    InputError
        Naming file, row and column: an unknown or missing column, an unknown unit, text where a number is expected.
    """
    lines = _lines(path)
    (first, header), body = lines[0], lines[1:]
    delimiter = _delimiter(header)
    names, factors = _header(path, first, next(csv.reader([header], delimiter=delimiter)), lacking)
    rows: list[tuple[float | str, ...]] = []
    for number, text in body:
        try:
            cells = next(csv.reader([text], delimiter=delimiter, strict=True))
        except csv.Error as error:
            raise InputError(f"{path}: row {number}: {error}") from None
        if len(cells) != len(names):
            raise InputError(
                f"{path}: row {number}: found {len(cells)} columns; expected {len(names)} as in the header"
            )
        rows.append(
            tuple(
                _value(path, number, name, cell, factor, comma=delimiter == ";")
                for name, cell, factor in zip(names, cells, factors, strict=True)
            )
        )
    if not rows:
        raise InputError(f"{path}: holds no row; expected one a point below the header")
    table = PointTable(names, tuple(rows), tuple(number for number, _ in body), str(path))
    if guess:
        _check_unstated(table, factors)
    return table


def written_out(
    columns: Sequence[str], rows: Sequence[Sequence[float | str]], where: str, lacking: Sequence[str] = ()
) -> PointTable:
    """A table that stands in the plan itself, in nm and degree; errors as :func:`read_table`."""
    _check_names(where, columns, lacking)
    for number, row in enumerate(rows, start=1):
        if len(row) != len(columns):
            raise InputError(f"{where}: row {number}: found {len(row)} values; expected {len(columns)} as in columns")
        for name, value in zip(columns, row, strict=True):
            if (name == "polarization") != isinstance(value, str):
                expected = " or ".join(_WORDS) if name == "polarization" else "a number"
                raise InputError(f"{where}: row {number}, column {name}: found {value!r}; expected {expected}")
            if name == "polarization" and value not in _WORDS:
                raise InputError(
                    f"{where}: row {number}, column {name}: found {value!r}; expected {' or '.join(_WORDS)}"
                )
    if not rows:
        raise InputError(f"{where}: rows: none; expected one a point")
    return PointTable(tuple(columns), tuple(tuple(row) for row in rows), tuple(range(1, len(rows) + 1)), where)


def _lines(path: Path) -> list[tuple[int, str]]:
    if path.is_file() and path.stat().st_size > _LARGEST:
        raise InputError(f"{path}: {path.stat().st_size} bytes; expected a table of at most {_LARGEST}")
    text = text_of(path, "a CSV table of points", "utf-8-sig")
    kept = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip(" \t,;") and not line.lstrip().startswith("#")
    ]
    if not kept:
        raise InputError(f"{path}: empty; expected a header and one row a point")
    return kept


def _delimiter(header: str) -> str:
    return max(",;\t", key=lambda sign: (header.count(sign), sign == ","))


def _header(
    path: Path, line: int, cells: Sequence[str], lacking: Sequence[str]
) -> tuple[tuple[str, ...], tuple[float | None, ...]]:
    """Names, and what turns each column into nm or degree (None where no unit is given)."""
    names: list[str] = []
    factors: list[float | None] = []
    for number, cell in enumerate(cells, start=1):
        match = _HEADER.fullmatch(cell)
        if match is None:
            raise InputError(
                f"{path}: row {line}, column {number}: found {cell!r}; expected a name like sensor_zenith (deg)"
            )
        name, unit = match["name"], match["unit"] or match["other"]
        names.append(name)
        factors.append(None if unit is None or name not in COLUMNS else _factor(path, line, name, unit))
    _check_names(f"{path}: row {line}", names, lacking)
    return tuple(names), tuple(factors)


def _factor(path: Path, line: int, name: str, unit: str) -> float:
    known = _LENGTHS if name == "wavelength" else {"1": 1.0} if name == "polarization" else _DEGREES | _RADIANS
    if unit not in known:
        expected = "nm or um" if name == "wavelength" else "no unit" if name == "polarization" else "degree or rad"
        raise InputError(f"{path}: row {line}, column {name}: found unit {unit!r}; expected {expected}")
    return known[unit]


def _check_names(where: str, names: Sequence[str], lacking: Sequence[str]) -> None:
    for name in names:
        if name in COLUMNS:
            continue
        meant = next((known for known in COLUMNS if name in ALIASES.get(known, ()) or name.lower() == known), None)
        meant = meant or next(iter(difflib.get_close_matches(name, COLUMNS, n=1, cutoff=0.7)), None)
        hint = f"; did you mean {meant!r}?" if meant else f"; expected some of {', '.join(COLUMNS)}"
        raise InputError(f"{where}: column {name!r}: unknown{hint}")
    doubled = [name for name in names if list(names).count(name) > 1]
    if doubled:
        raise InputError(f"{where}: column {doubled[0]!r} stands twice")
    for name in lacking:
        if name in names:
            raise InputError(f"{where}: column {name!r}: the plan gives {name} for the whole table too; leave out one")
    missing = [name for name in NEEDED if name not in names and name not in lacking]
    if missing:
        raise InputError(f"{where}: column {missing[0]!r}: missing; found {', '.join(names)}")


def _value(path: Path, line: int, name: str, cell: str, factor: float | None, *, comma: bool) -> float | str:
    text = cell.strip()
    if name == "polarization":
        if text not in _WORDS:
            raise InputError(f"{path}: row {line}, column {name}: found {text!r}; expected {' or '.join(_WORDS)}")
        return text
    unit = "nm" if name == "wavelength" else "degree"
    try:
        number = float(text.replace(",", ".") if comma else text)
    except ValueError:
        raise InputError(f"{path}: row {line}, column {name}: found {text!r}; expected a number ({unit})") from None
    if not math.isfinite(number):
        raise InputError(f"{path}: row {line}, column {name}: found {text!r}; expected a finite number ({unit})")
    return tidy(number * (1.0 if factor is None else factor))


def _check_unstated(table: PointTable, factors: Sequence[float | None]) -> None:
    for column, (name, factor) in enumerate(zip(table.columns, factors, strict=True)):
        if factor is None and name != "polarization":
            numbers = list(dict.fromkeys(float(row[column]) for row in table.rows))
            check_units(table.source, name, numbers)
