"""What the lines of a journal hold: one pydantic model a kind (``docs/journal.md``)."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from instrument.events import Geometry

Index = Annotated[int, Field(ge=0)]
Volts = Annotated[tuple[float, ...], Field(min_length=1)]


class _Record(BaseModel):
    """Unknown fields are kept: a later version may write more."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)


class Header(_Record):
    """The first line: what is measured, with what, by what."""

    format: Literal["goniotwin-journal"] = "goniotwin-journal"
    version: Literal[1] = 1
    created: datetime
    title: str = ""
    plan: str  # text of plan.toml
    facility: str  # text of facility.toml
    samples: int
    scan_direction: Literal["unidirectional", "serpentine"]
    points: int  # how many the plan has, blocked ones apart
    software_version: str


class _Reading(_Record):
    index: Index
    geometry: Geometry  # commanded
    time: datetime  # laboratory time, UTC, when the readings were taken
    signal: Volts
    dark: float  # V
    gain: Annotated[float, Field(gt=0)]  # V/A
    quality_flag: Annotated[int, Field(ge=0, le=15)] = 0
    readback: dict[str, float] = Field(default_factory=dict)  # degree, by axis
    source_power: float | None = None  # fraction of full power
    wavelength_readback: float | None = None  # nm
    #: Surroundings by name: value and unit.
    environment: dict[str, tuple[float, str]] = Field(default_factory=dict)


class PointRecord(_Reading):
    """``kind`` point: the readings of one point of the plan."""


class ReferenceRecord(_Reading):
    """``kind`` reference: the readings of the reference sample at one sensor azimuth."""


class SkippedRecord(_Record):
    """``kind`` skipped: a point that could not be measured."""

    index: Index
    geometry: Geometry
    time: datetime
    reason: str


class StateRecord(_Record):
    """``kind`` state: the engine is about to change its state."""

    time: datetime
    old: str
    new: str
    reason: str = ""


class AmendmentRecord(_Record):
    """``kind`` amendment: what the run says of operator, sample and standard from now on, and why."""

    time: datetime
    by: str
    reason: str
    changes: dict[str, str]


class NoteRecord(_Record):
    """``kind`` note: anything else a person should find later."""

    text: str


#: Kinds with a fixed form; any other kind is kept as it is.
RECORDS: dict[str, type[_Record]] = {
    "header": Header,
    "point": PointRecord,
    "reference": ReferenceRecord,
    "skipped": SkippedRecord,
    "state": StateRecord,
    "note": NoteRecord,
    "amendment": AmendmentRecord,
}
