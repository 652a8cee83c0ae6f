"""From the parts of a plan to points in the order in which they are measured."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from instrument.errors import InputError
from instrument.events import Geometry
from instrument.facility import Arms
from instrument.plan_forms import GRID_AXES, Grid, PlanForm, Steps, Table, tidy
from instrument.plan_table import PointTable, read_table, table_path, written_out
from instrument.plan_units import check_units

#: Wavelengths that any instrument of this kind can be asked for, nm.
WAVELENGTH_RANGE = (200.0, 3000.0)
#: More than an instrument of this kind measures in a year.
MOST_POINTS = 1_000_000
#: What a part may give for all rows of a table.
_FOR_ALL = ("wavelength", "polarization", "sample_rotation")

#: One point: values by name of the coordinate.
Values = Mapping[str, Any]


def ordered_points(form: PlanForm, arms: Arms, source: str, folder: Path | None) -> list[Geometry]:
    """Every point that a plan asks for, blocked ones too.

    Parameters
    ----------
    arms
        Travel; what the instrument has beside its arms.
    source
        The file, for messages.
    folder
        Where tables are looked for; None where there are none to be read.

    Raises
    ------
    InputError
        Naming part, row and key of what is wrong.
    """
    counting = _Counting(source, repeat=form.duplicates == "repeat", polarizer=arms.polarizer is not None)
    sweeps = 0
    for cycle in range(form.repeats):
        for name, part in form.parts:
            where = f"{source}: {name}"
            if isinstance(part, Table):
                counting.take(
                    table_points(part, where, arms, folder, guess=form.angle_unit is None), part.repeats, cycle
                )
                continue
            values = _grid_values(part, where)
            _check_grid(where, part, values, arms, guess=form.angle_unit is None)
            counting.require_room(where, math.prod(map(len, values.values())) * part.repeats)
            serpentine = (part.direction or form.direction) == "serpentine"
            for sweep in _sweeps(part, values):
                turned = serpentine and sweeps % 2 == 1
                counting.take(reversed(sweep) if turned else sweep, part.repeats, cycle)
                sweeps += 1
    return counting.points


class _Counting:
    """Collects points, and tells repetitions from slips."""

    def __init__(self, source: str, *, repeat: bool, polarizer: bool) -> None:
        self._source, self._repeat, self._polarizer = source, repeat, polarizer
        self._met: Counter[Geometry] = Counter()
        self.points: list[Geometry] = []

    def require_room(self, where: str, more: int) -> None:
        wanted = len(self.points) + more
        if wanted > MOST_POINTS:
            raise InputError(f"{where}: {wanted} points up to here; expected at most {MOST_POINTS} (a step too small?)")

    def take(self, points: Iterable[Values], repeats: int, cycle: int) -> None:
        """Add points, each so many times in a row; ``cycle`` counts how often the whole plan was gone through."""
        for values in points:
            known = {"polarization": "mean"} | dict(values) if self._polarizer else values
            point = Geometry(**known)
            if self._met[point] and not cycle and not self._repeat:
                raise InputError(
                    f"{self._source}: a point stands twice in the plan: {describe(point)}"
                    ' (if it is meant to be measured again, say repeats = 2, or duplicates = "repeat")'
                )
            for _ in range(repeats):
                again = self._met[point]
                self.points.append(point.model_copy(update={"repetition": again}) if again else point)
                self._met[point] += 1
            self.require_room(self._source, 0)


def table_points(part: Table, where: str, arms: Arms, folder: Path | None, *, guess: bool) -> Iterator[Values]:
    """Points of a table in the order of its rows; errors as :func:`ordered_points`."""
    table = table_of(part, where, folder, guess=guess)
    common = {name: _values_of(where, name, given) for name in _FOR_ALL if (given := getattr(part, name)) is not None}
    if guess:
        for name, given in common.items():
            if name != "polarization":
                check_units(where, name, given)
    for name, given in common.items():
        for value in given:
            _check_value(where, name, value, arms)
    for row, cells in enumerate(table.rows):
        for name, value in zip(table.columns, cells, strict=True):
            _check_value(f"{table.place(row)}, column", name, value, arms, separator=" ")
    for combination in product(*common.values()):
        fixed = dict(zip(common, combination, strict=True))
        for cells in table.rows:
            yield fixed | dict(zip(table.columns, cells, strict=True))


def table_of(part: Table, where: str, folder: Path | None, *, guess: bool = True) -> PointTable:
    """The rows of a part that is a table.

    Raises
    ------
    InputError
        As :func:`instrument.plan_table.read_table`; if the file lies outside the folder of the plan.
    """
    lacking = [name for name in _FOR_ALL if getattr(part, name) is not None]
    if part.table is None:
        assert part.columns is not None
        assert part.rows is not None
        return written_out(part.columns, part.rows, where, lacking)
    if folder is None:
        raise InputError(f"{where}: table: found {part.table!r}, but the plan lies in no folder where it could be")
    return read_table(table_path(part.table, folder, where), lacking, guess=guess)


def _values_of(where: str, name: str, given: Steps | Sequence[Any]) -> tuple[Any, ...]:
    try:
        values = (
            given.values()
            if isinstance(given, Steps)
            else tuple(value if isinstance(value, str) else tidy(value) for value in given)
        )
    except ValueError as error:
        raise InputError(f"{where}: {name}: {error}") from None
    if not values:
        raise InputError(f"{where}: {name}: no value; expected at least one")
    return values


def _grid_values(grid: Grid, where: str) -> dict[str, tuple[Any, ...]]:
    order = grid.order or GRID_AXES
    return {name: _values_of(where, name, given) for name in order if (given := getattr(grid, name)) is not None}


def _check_grid(where: str, grid: Grid, values: Mapping[str, Sequence[Any]], arms: Arms, *, guess: bool) -> None:
    for name, found in values.items():
        given = getattr(grid, name)
        if name != "polarization" and (guess or name == "wavelength"):
            check_units(where, name, given.numbers() if isinstance(given, Steps) else found)
        for value in found:
            _check_value(where, name, value, arms)
    _check_value(where, "illumination_azimuth", grid.illumination_azimuth, arms)


def _check_value(where: str, name: str, value: Any, arms: Arms, separator: str = ": ") -> None:
    at = f"{where}{separator}{name}"
    if name == "polarization":
        if arms.polarizer is None:
            raise InputError(
                f"{at}: found {value!r}, but the instrument has no polariser (arms.polarizer of its facility)"
            )
        return
    if name == "wavelength":
        lower, upper = WAVELENGTH_RANGE
        if not lower <= value <= upper:
            raise InputError(f"{at}: found {value:g}; expected {lower:g} to {upper:g} nm")
        return
    if name == "illumination_azimuth":
        low, high = -360.0, 360.0
    elif name == "sample_rotation":
        if arms.sample_rotation is None:
            raise InputError(
                f"{at}: found {value:g}, but the instrument has no stage that turns the sample"
                " (arms.sample_rotation of its facility)"
            )
        low, high = arms.sample_rotation
    else:
        low, high = getattr(arms, name)
    if not low <= value <= high:
        raise InputError(f"{at}: found {value:g} degrees, beyond the arm; expected {low:g} to {high:g}")


def _sweeps(grid: Grid, values: Mapping[str, Sequence[Any]]) -> Iterator[list[Values]]:
    """Points in lists along the axis that runs fastest."""
    *outer, inner = values
    fixed = {"illumination_azimuth": tidy(grid.illumination_azimuth)}
    for combination in product(*(values[name] for name in outer)):
        at = fixed | dict(zip(outer, combination, strict=True))
        yield [at | {inner: value} for value in values[inner]]


def describe(point: Geometry) -> str:
    """A geometry in words, for messages."""
    azimuth = f", illumination azimuth {point.illumination_azimuth:g}" if point.illumination_azimuth else ""
    turned = f", sample turned by {point.sample_rotation:g}" if point.sample_rotation else ""
    polarised = f", polarisation {point.polarization}" if point.polarization else ""
    again = f", repetition {point.repetition}" if point.repetition else ""
    return (
        f"{point.wavelength:g} nm, illumination zenith {point.illumination_zenith:g}{azimuth},"
        f" sensor azimuth {point.sensor_azimuth:g}, sensor zenith {point.sensor_zenith:g}{turned}{polarised}{again}"
    )
