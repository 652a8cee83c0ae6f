"""Which points the live twin predicts next. No threads, no clock: only what is known and what is wanted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from instrument.events import Geometry

#: A point that failed alone this often is given up.
PATIENCE = 3
#: A failed batch is cut into parts of this fraction, so that one bad point does not take its neighbours with it.
CUT = 4


@dataclass(frozen=True)
class Batch:
    """Points to predict in one request, and how accurately: as of :class:`Stage`."""

    indices: tuple[int, ...]
    standard_error: float
    sight_lines: int | None = None


@dataclass(frozen=True)
class Stage:
    """One pass over the points: how accurate, and how many points a request may hold.

    Attributes
    ----------
    standard_error
        Relative Monte Carlo standard error to reach.
    batch
        Points of a request, at most.
    sight_lines
        Trace so many for every point instead, whatever error they leave: there in a third of the time, because
        nothing has to be tried out first.
    """

    standard_error: float
    batch: int
    sight_lines: int | None = None


class Schedule:
    """Order of work: every point once in the first stage, nearest ahead of the scan first, then again in finer ones.

    Parameters
    ----------
    points
        All points of the plan, in the order in which they are measured.
    stages
        From coarse to fine.
    """

    def __init__(self, points: Sequence[Geometry], stages: Sequence[Stage]) -> None:
        self._points = tuple(points)
        self._stages = tuple(stages)
        self._reached = [0] * len(self._points)  # number of stages done
        self._failures = [0] * len(self._points)
        self._largest = [max(stage.batch for stage in stages)] * len(self._points)
        self._position = 0
        self._wanted = set(range(len(self._points)))
        self._given_up: set[int] = set()

    @property
    def given_up(self) -> frozenset[int]:
        """Points that failed too often, or were refused."""
        return frozenset(self._given_up)

    @property
    def remaining(self) -> int:
        """How many wanted points have not yet reached the last stage and are not given up."""
        return len(self._open())

    def move_to(self, position: int) -> None:
        """The scan is about to measure this point: what lies ahead of it comes first."""
        self._position = position

    def restrict(self, wanted: Iterable[int]) -> None:
        """From now on predict only these."""
        self._wanted = set(wanted)

    def next_batch(self) -> Batch | None:
        """What to do next; None when nothing is left."""
        todo = self._open()
        if not todo:
            return None
        first = min(todo, key=self._urgency)
        stage = self._stages[self._reached[first]]
        size = min(stage.batch, self._largest[first])
        alike = [i for i in todo if self._belongs_with(i, first)]
        alike.sort(key=self._urgency)
        return Batch(tuple(sorted(alike[:size])), stage.standard_error, stage.sight_lines)

    def succeeded(self, batch: Batch) -> None:
        """Mark the points of a batch as predicted."""
        for index in batch.indices:
            self._reached[index] += 1
            self._failures[index] = 0

    def failed(self, batch: Batch) -> None:
        """Ask for smaller batches where one failed, and give points up that fail alone again and again."""
        size = len(batch.indices)
        for index in batch.indices:
            self._failures[index] += 1
            self._largest[index] = max(1, size // CUT)
            if size == 1 and self._failures[index] >= PATIENCE:
                self._given_up.add(index)

    def refused(self, batch: Batch) -> None:
        """Find the points that the twin will never predict by asking for each alone, and give those up at once."""
        for index in batch.indices:
            self._largest[index] = 1
        if len(batch.indices) == 1:
            self._given_up.update(batch.indices)

    def _open(self) -> list[int]:
        last = len(self._stages)
        return [i for i in sorted(self._wanted - self._given_up) if self._reached[i] < last]

    def _urgency(self, index: int) -> tuple[bool, int, bool, int]:
        """A first failure may be anybody's; points that were there twice go last, for they may be the cause."""
        return (self._failures[index] > 1, self._reached[index], index < self._position, index)

    def _belongs_with(self, index: int, first: int) -> bool:
        return (
            self._slice(index) == self._slice(first)
            and self._reached[index] == self._reached[first]
            and self._largest[index] == self._largest[first]
            and (index < self._position) == (first < self._position)
        )

    def _slice(self, index: int) -> tuple[float, float, float, float]:
        point = self._points[index]
        return (point.wavelength, point.illumination_zenith, point.illumination_azimuth, point.sensor_azimuth)
