"""What the engine tells the world while it works. Windows, records and the live twin only ever see these.

Every event is a pydantic model with a ``kind`` and can be written as one JSON line and read back
(:func:`to_json`, :func:`from_json`), so that a listener may live in another process.
"""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, TypeAdapter, model_serializer

#: What a polariser lets through: across the plane of incidence, in it, or one after the other and their mean.
Polarization = Literal["mean", "s", "p"]


class _Event(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")
    time: datetime  # laboratory time, UTC


class Geometry(BaseModel):
    """One commanded geometry: wavelength in nm, angles in degree (data contract, section Angles and frames).

    Attributes
    ----------
    sample_rotation
        Of the sample about its normal, right-handed. Illumination and sensor angles stay those of the laboratory.
    polarization
        None where the instrument has no polariser.
    repetition
        How many times the point was measured before in the same plan.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    wavelength: float
    illumination_zenith: float
    illumination_azimuth: float = 0.0
    sensor_zenith: float
    sensor_azimuth: float
    sample_rotation: float = 0.0
    polarization: Polarization | None = None
    repetition: Annotated[int, Field(ge=0)] = 0

    @model_serializer(mode="wrap")
    def _as_before(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """What an instrument of three arms does not know is left out: its records read as they always did."""
        data: dict[str, Any] = handler(self)
        for name, usual in (("sample_rotation", 0.0), ("polarization", None), ("repetition", 0)):
            if data.get(name) == usual:
                data.pop(name, None)
        return data


class ScanStarted(_Event):
    """A scan begins or goes on; ``points`` are all points of the plan, in the order in which they are measured."""

    kind: Literal["scan_started"] = "scan_started"
    run_dir: str
    title: str
    points: tuple[Geometry, ...]
    done: tuple[int, ...] = ()  # indices measured before a resumption
    duration_s: float  # estimate, laboratory seconds
    clock_speed: float = 1.0
    facility: str | None = None  # paths of the copies in the run folder
    artifact: str | None = None
    material: str | None = None


class StateChanged(_Event):
    """The engine went from one state to another."""

    kind: Literal["state_changed"] = "state_changed"
    old: str
    new: str
    reason: str = ""


class ReferenceMeasured(_Event):
    """One reading of the reference sample: photocurrent in A and its relative standard error."""

    kind: Literal["reference_measured"] = "reference_measured"
    index: int
    sensor_azimuth: float
    current: float
    relative_standard_error: float


class AxesRead(_Event):
    """Where the drives say that the axes stand, in degree by role. It passes by: no record, and nobody who comes later
    is told of it.
    """

    kind: Literal["axes_read"] = "axes_read"
    positions: dict[str, float]


class PointStarted(_Event):
    """The arms set out for a point."""

    kind: Literal["point_started"] = "point_started"
    index: int
    geometry: Geometry


class PointMeasured(_Event):
    """A point is measured and in the journal."""

    kind: Literal["point_measured"] = "point_measured"
    index: int
    geometry: Geometry
    brf: float
    u_brf: float
    signal: tuple[float, ...]  # V
    dark: float  # V
    gain: float  # V/A
    quality_flag: int = 0
    done: int  # points measured so far, of ``total``
    total: int
    time_left_s: float  # wall-clock seconds


class PointSkipped(_Event):
    """A point could not be measured; it is marked as missing and why."""

    kind: Literal["point_skipped"] = "point_skipped"
    index: int
    geometry: Geometry
    reason: str


class PointAnnotated(_Event):
    """An observer adds values to a point: the twin its prediction (``brf``, ``u_brf``) before or after the reading."""

    kind: Literal["point_annotated"] = "point_annotated"
    index: int
    source: str
    values: dict[str, float]


class Message(_Event):
    """Something a person should read."""

    kind: Literal["message"] = "message"
    level: Literal["info", "warning", "error"]
    text: str
    advice: str = ""


class ScanEnded(_Event):
    """The scan is over; ``outcome`` is the final state's name."""

    kind: Literal["scan_ended"] = "scan_ended"
    outcome: Literal["finished", "aborted", "halted", "faulted"]
    done: int
    total: int
    reason: str = ""
    run_file: str | None = None


Event = Annotated[
    ScanStarted
    | StateChanged
    | ReferenceMeasured
    | AxesRead
    | PointStarted
    | PointMeasured
    | PointSkipped
    | PointAnnotated
    | Message
    | ScanEnded,
    Field(discriminator="kind"),
]
_ADAPTER: TypeAdapter[Event] = TypeAdapter(Event)


def to_json(event: Event) -> str:
    """One line of JSON without a line break."""
    return _ADAPTER.dump_json(event).decode()


def from_json(line: str | bytes) -> Event:
    """Read an event back.

    Raises
    ------
    pydantic.ValidationError
        If the line is no event.
    """
    return _ADAPTER.validate_json(line)
