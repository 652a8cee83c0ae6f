"""The form of ``plan.toml``: parts in sequence, each a grid or a table of points (``docs/plan.md``)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from instrument.events import Polarization
from instrument.forms import Form
from instrument.run_record import RunRecord

Direction = Literal["unidirectional", "serpentine"]
#: What a grid runs through, the last one fastest; a part may say another ``order``.
GRID_AXES = (
    "wavelength",
    "polarization",
    "sample_rotation",
    "illumination_zenith",
    "sensor_azimuth",
    "sensor_zenith",
)
GridAxis = Literal[
    "wavelength", "polarization", "sample_rotation", "illumination_zenith", "sensor_azimuth", "sensor_zenith"
]
#: Angles and wavelengths are kept to this many decimals, so that ``start + 3 * step`` reads as it was meant.
_DECIMALS = 9
_MOST_STEPS = 100_000
Repeats = Annotated[int, Field(ge=1, le=10_000, strict=True)]


class Steps(Form):
    """Equally spaced values from ``start`` to ``stop``, both included."""

    start: float
    stop: float
    step: float

    def values(self) -> tuple[float, ...]:
        """The values; ValueError when ``step`` does not lead from ``start`` to ``stop``."""
        span = self.stop - self.start
        if self.step == 0:
            raise ValueError("step is 0; expected the distance between neighbouring values")
        if span * self.step < 0:
            raise ValueError(
                f"step {self.step:g} has the wrong sign: it leads away from stop ({self.start:g} to {self.stop:g});"
                f" expected {-self.step:g}"
            )
        count = round(span / self.step)
        if abs(span - count * self.step) > 1e-6 * abs(self.step):
            raise ValueError(f"steps of {self.step:g} from {self.start:g} do not meet stop ({self.stop:g})")
        if count >= _MOST_STEPS:
            raise ValueError(f"{count + 1} values between {self.start:g} and {self.stop:g}; expected at most 100000")
        return tuple(tidy(self.start + i * self.step) for i in range(count + 1))

    def numbers(self) -> tuple[float, ...]:
        """The numbers as they were written, for a guess at their unit."""
        return (self.start, self.stop, self.step)


Values = Steps | tuple[float, ...]


class Grid(Form):
    """Every combination of its values.

    Attributes
    ----------
    repeats
        How many times each point is measured in a row, the arms at rest.
    order
        What runs through its values first to last, the last one fastest.
    direction
        ``serpentine`` or ``unidirectional`` where it differs from the plan's.
    """

    wavelength: Values
    polarization: tuple[Polarization, ...] | None = None
    sample_rotation: Values | None = None
    illumination_zenith: Values
    illumination_azimuth: float = 0.0
    sensor_azimuth: Values
    sensor_zenith: Values
    repeats: Repeats = 1
    order: tuple[GridAxis, ...] | None = None
    direction: Direction | None = None

    @model_validator(mode="after")
    def _order_is_whole(self) -> Grid:
        if self.order is None:
            return self
        needed = [name for name in GRID_AXES if getattr(self, name) is not None]
        doubled = {name for name in self.order if self.order.count(name) > 1}
        missing = [name for name in needed if name not in self.order]
        if doubled or missing:
            wrong = f"{sorted(doubled)[0]} stands twice" if doubled else f"{missing[0]} is missing"
            raise ValueError(f"order: {wrong}; expected each of {', '.join(needed)} once")
        return self


class Table(Form):
    """Points one by one, in the order of the rows: a CSV file, or its rows written out.

    Attributes
    ----------
    table
        The file; it has to lie in the folder of the plan, or below it.
    columns, rows
        The same written out, in nm and degree. A run folder holds tables in this form: it needs no file beside it.
    wavelength, polarization, sample_rotation
        For a table that has no such column: its rows are measured at each of these, one after the other.
    """

    table: str | None = None
    columns: tuple[str, ...] | None = None
    rows: tuple[tuple[float | str, ...], ...] | None = None
    wavelength: Values | None = None
    polarization: tuple[Polarization, ...] | None = None
    sample_rotation: Values | None = None
    repeats: Repeats = 1

    @model_validator(mode="after")
    def _one_source(self) -> Table:
        if (self.table is None) == (self.columns is None or self.rows is None):
            raise ValueError("expected either table, the name of a CSV file, or columns and rows")
        return self


def _kind(part: Any) -> str:
    keys = part.keys() if isinstance(part, dict) else vars(part).keys() if isinstance(part, Table) else ()
    return "table" if {"table", "columns", "rows"} & set(keys) else "grid"


Part = Annotated[Annotated[Grid, Tag("grid")] | Annotated[Table, Tag("table")], Discriminator(_kind)]


class PlanForm(Form):
    """Keys of ``plan.toml``.

    Attributes
    ----------
    repeats
        How many times the whole plan is measured, from its first point to its last.
    duplicates
        ``repeat``: a point that stands again in the plan is meant to be measured again.
    record
        Who measures which sample against which standard; the command line has the last word.
    angle_unit
        May only be ``degree``; a plan that says so is never suspected of holding radians.
    part
        Grids and tables in the order in which they are measured.
    grid
        The same for plans that have grids only.
    """

    version: Literal[1]
    title: str = ""
    samples: Annotated[int, Field(ge=1, le=10_000, strict=True)] = 9
    direction: Direction = "unidirectional"
    repeats: Repeats = 1
    duplicates: Literal["refuse", "repeat"] = "refuse"
    record: RunRecord = RunRecord()
    angle_unit: Literal["degree"] | None = None
    grid: tuple[Grid, ...] | None = None
    part: tuple[Part, ...] | None = None

    @property
    def parts(self) -> tuple[tuple[str, Grid | Table], ...]:
        """What each part is called in a message, and the part."""
        name, parts = ("grid", self.grid) if self.part is None else ("part", self.part)
        return tuple((f"{name} {number}", part) for number, part in enumerate(parts or (), start=1))


def tidy(value: float) -> float:
    """A number without the noise of its last digits; -0.0 becomes 0.0."""
    return round(float(value), _DECIMALS) + 0.0
