"""The points of a scan, kept in columns: a run needs no more memory at its end than at its beginning. Without Qt."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import NamedTuple, overload

from gui.scores import CATEGORIES, Score
from instrument.events import Geometry, ScanStarted

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_VALUES = ("brf", "u_brf", "simulated", "u_simulated")
_METRICS = ("relative_difference", "t", "level")
_CATEGORIES = ("category", "difference_category", "level_category")
_NEVER = -(2**63)


class PlaneKey(NamedTuple):
    """Points that share everything but the sensor zenith; nm and degree."""

    wavelength: float
    illumination_zenith: float
    illumination_azimuth: float
    sensor_azimuth: float


def plane_of(geometry: Geometry) -> PlaneKey:
    """The azimuth plane a geometry lies in."""
    return PlaneKey(
        geometry.wavelength, geometry.illumination_zenith, geometry.illumination_azimuth, geometry.sensor_azimuth
    )


@dataclass(frozen=True)
class Point:
    """Everything known of one point of the plan; None for what has not arrived."""

    index: int
    geometry: Geometry
    brf: float | None = None
    u_brf: float | None = None
    time: datetime | None = None
    quality_flag: int = 0
    simulated: float | None = None
    u_simulated: float | None = None
    score: Score | None = None
    skipped: str = ""
    earlier: bool = False  # measured before a resumption; its values may not have arrived

    @property
    def settled(self) -> bool:
        """True when nothing more will be measured at this point."""
        return self.brf is not None or bool(self.skipped) or self.earlier


class Points(Sequence[Point]):
    """Points by their index; each is made when it is asked for.

    Parameters
    ----------
    geometries
        In the order of the plan.
    done
        Indices measured before a resumption.
    """

    def __init__(self, geometries: Sequence[Geometry] = (), done: Iterable[int] = ()) -> None:
        self.geometries = geometries
        count = len(geometries)
        self._numbers = {name: array("d", [0.0]) * count for name in (*_VALUES, *_METRICS)}
        self._known = {name: bytearray(count) for name in _VALUES}  # a value may be no number, and yet be known
        self._time = array("q", [_NEVER]) * count  # microseconds
        self._flags = array("l", [0]) * count
        self._categories = {name: bytearray(count) for name in _CATEGORIES}  # 0: no score; else one more than its place
        self._skipped: dict[int, str] = {}
        self._earlier = bytearray(count)
        for index in done:
            self._earlier[index] = 1

    def __len__(self) -> int:
        """Number of points."""
        return len(self.geometries)

    @overload
    def __getitem__(self, index: int) -> Point: ...
    @overload
    def __getitem__(self, index: slice) -> list[Point]: ...
    def __getitem__(self, index: int | slice) -> Point | list[Point]:
        """A point, or several."""
        if isinstance(index, slice):
            return [self[each] for each in range(*index.indices(len(self)))]
        brf, u_brf, simulated, u_simulated = (self._number(name, index) for name in _VALUES)
        micros = self._time[index]
        return Point(
            index % len(self),
            self.geometries[index],
            brf,
            u_brf,
            None if micros == _NEVER else _EPOCH + micros * _MICROSECOND,
            self._flags[index],
            simulated,
            u_simulated,
            self._score(index),
            self._skipped.get(index % len(self), ""),
            bool(self._earlier[index]),
        )

    def standing(self, index: int, of: str) -> str:
        """How a point stands, without making it: ``missing``, a category, ``measured`` or ``waiting``.

        Parameters
        ----------
        of
            Which category: ``category``, ``difference_category`` or ``level_category``.
        """
        if index in self._skipped:
            return "missing"
        if number := self._categories[of][index]:
            return CATEGORIES[number - 1]
        return "measured" if self._known["brf"][index] or self._earlier[index] else "waiting"

    def store(self, point: Point) -> None:
        """Replace a point; its geometry stays."""
        index, score = point.index, point.score
        for name in _VALUES:
            value = getattr(point, name)
            self._known[name][index] = value is not None
            self._numbers[name][index] = value or 0.0
        for name in _METRICS:
            self._numbers[name][index] = getattr(score, name) if score else 0.0
        for name in _CATEGORIES:
            self._categories[name][index] = CATEGORIES.index(getattr(score, name)) + 1 if score else 0
        self._time[index] = _NEVER if point.time is None else (point.time - _EPOCH) // _MICROSECOND
        self._flags[index] = point.quality_flag
        self._earlier[index] = point.earlier
        if point.skipped:
            self._skipped[index] = point.skipped
        else:
            self._skipped.pop(index, None)

    def _number(self, name: str, index: int) -> float | None:
        return self._numbers[name][index] if self._known[name][index] else None

    def _score(self, index: int) -> Score | None:
        if not self._categories["category"][index]:
            return None
        difference, t, level = (self._numbers[name][index] for name in _METRICS)
        of_t, of_difference, of_level = (CATEGORIES[self._categories[name][index] - 1] for name in _CATEGORIES)
        return Score(difference, t, of_t, level, of_difference, of_level)


@dataclass(frozen=True)
class LaidOut:
    """A scan that starts, with its points and planes; made by :func:`lay_out` on whatever thread brings the event."""

    event: ScanStarted
    points: Points
    planes: dict[PlaneKey, list[int]]


def lay_out(event: ScanStarted) -> LaidOut:
    """Points and planes of a scan; the indices of each plane by ascending sensor zenith."""
    planes: dict[PlaneKey, list[int]] = {}
    for index, geometry in enumerate(event.points):
        planes.setdefault(plane_of(geometry), []).append(index)
    for indices in planes.values():
        indices.sort(key=lambda index: event.points[index].sensor_zenith)
    return LaidOut(event, Points(event.points, event.done), planes)
