"""What a window knows of a scan: plain Python that follows engine events, without Qt and without files.

The model is a pure function of the events applied to it, so a window that joins a running scan, or opens a
finished one, only has to be given the same events.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import singledispatchmethod
from statistics import fmean, stdev

from gui.notices import (
    ControllerClosed,
    ControllerFailed,
    ControllerStarting,
    Notice,
    OperatorAnswered,
    OperatorAsked,
    ProcedureEnded,
    ProcedureStarted,
)
from gui.points import LaidOut, PlaneKey, Point, Points, lay_out, plane_of
from gui.scores import Category, ScoreFunction
from gui.traces import Trace
from instrument.events import (
    AxesRead,
    Event,
    Message,
    PointAnnotated,
    PointMeasured,
    PointSkipped,
    PointStarted,
    ReferenceMeasured,
    ScanEnded,
    ScanStarted,
    StateChanged,
)
from instrument.operators import Mounted
from instrument.prompts import Prompt
from instrument.states import FINAL, State

MESSAGES_KEPT = 2000


def noise_of(samples: tuple[float, ...]) -> float:
    """Standard deviation of the samples of a reading over their mean; 0 where it cannot be told."""
    mean = fmean(samples) if samples else 0.0
    return stdev(samples) / abs(mean) if len(samples) > 1 and mean else 0.0


@dataclass(frozen=True)
class Line:
    """One entry of the message list."""

    time: datetime
    level: str
    text: str
    advice: str = ""


@dataclass
class Changes:
    """What has changed since a panel last looked."""

    scan: bool = False  # another scan: everything is new
    state: bool = False
    progress: bool = False
    current: bool = False
    messages: int = 0  # lines added
    request: bool = False
    moved: bool = False  # an axis was seen elsewhere
    planes: set[PlaneKey] = field(default_factory=set)
    points: set[int] = field(default_factory=set)  # indices

    def joined(self, later: Changes) -> Changes:
        """Both together."""
        return Changes(
            scan=self.scan or later.scan,
            state=self.state or later.state,
            progress=self.progress or later.progress,
            current=self.current or later.current,
            messages=self.messages + later.messages,
            request=self.request or later.request,
            moved=self.moved or later.moved,
            planes=self.planes | later.planes,
            points=self.points | later.points,
        )


class ScanModel:
    """State of one scan as events tell it.

    Parameters
    ----------
    score
        Compares a measured with a simulated value; the window passes :func:`gui.comparison.score`.
    """

    def __init__(self, score: ScoreFunction) -> None:
        self._score = score
        self.messages: deque[Line] = deque(maxlen=MESSAGES_KEPT)
        self._changes = Changes(scan=True)
        self.procedure = ""  # has the instrument in place of a scan; a run may be looked at meanwhile
        self.request: Mounted | Prompt | None = None
        self._clear()

    def _clear(self) -> None:
        self.state = State.IDLE
        self.state_reason = ""
        self.connected = False  # a controller holds the instrument
        self.title = ""
        self.run_dir = ""
        self.clock_speed = 1.0
        self.duration_s = 0.0
        self.started: datetime | None = None
        self.latest: datetime | None = None
        self.time_left_s: float | None = None
        self.points = Points()
        self.planes: dict[PlaneKey, list[int]] = {}
        self.tally: Counter[Category] = Counter()
        self.plane_tally: dict[PlaneKey, Counter[Category]] = {}
        self.plane_settled: Counter[PlaneKey] = Counter()
        self.plane_missing: Counter[PlaneKey] = Counter()
        self.measured = 0
        self.missing = 0
        self.references: list[ReferenceMeasured] = []
        self.health = Trace(4)  # hours since the start, dark level (V), scatter of the samples (relative), gain (V/A)
        self.current: int | None = None
        self.positions: dict[str, float] = {}  # where the drives said that the axes stand, degree
        self.last: PointMeasured | None = None
        self.request = self.request if self.procedure else None
        self.end: ScanEnded | None = None

    def take_changes(self) -> Changes:
        """What changed since the last call."""
        changes, self._changes = self._changes, Changes()
        return changes

    @property
    def busy(self) -> bool:
        """Whether a scan or a procedure has the instrument."""
        return self.connected or bool(self.procedure)

    @property
    def total(self) -> int:
        """Points of the plan."""
        return len(self.points)

    @property
    def settled(self) -> int:
        """Points measured or given up, those of an earlier part of the run included."""
        return sum(self.plane_settled.values())

    @property
    def current_plane(self) -> PlaneKey | None:
        """The plane the arms are in, or set out for."""
        return None if self.current is None else plane_of(self.points[self.current].geometry)

    def hours(self, time: datetime) -> float:
        """Hours since the scan started."""
        return (time - (self.started or time)).total_seconds() / 3600

    def plane_points(self, plane: PlaneKey) -> list[Point]:
        """Points of a plane by ascending sensor zenith; empty for a plane that the plan does not have."""
        return [self.points[index] for index in self.planes.get(plane, ())]

    @singledispatchmethod
    def apply(self, event: Event | Notice | LaidOut) -> None:
        """Take one event or notice in."""
        raise TypeError(f"no event: {event!r}")

    @apply.register
    def _(self, event: ScanStarted) -> None:
        self.apply(lay_out(event))

    @apply.register
    def _(self, start: LaidOut) -> None:
        event, state, reason, connected = start.event, self.state, self.state_reason, self.connected
        self._clear()
        self.state, self.state_reason, self.connected = state, reason, connected
        self.title, self.run_dir = event.title, event.run_dir
        self.clock_speed, self.duration_s = event.clock_speed, event.duration_s
        self.started = self.latest = event.time
        self.time_left_s = event.duration_s / event.clock_speed
        self.points, self.planes = start.points, start.planes
        self.health = Trace(4, room=len(event.points))
        self.plane_tally = {plane: Counter() for plane in self.planes}
        done = set(event.done)
        self.plane_settled.update(plane_of(event.points[index]) for index in done)
        self.measured = len(done)
        self._changes = Changes(scan=True, messages=self._changes.messages)

    @apply.register
    def _(self, event: StateChanged) -> None:
        self.state, self.state_reason = State(event.new), event.reason
        self._changes.state = True
        self._tick(event.time)

    @apply.register
    def _(self, event: ReferenceMeasured) -> None:
        self.references.append(event)
        self._changes.current = True
        self._tick(event.time)

    @apply.register
    def _(self, event: AxesRead) -> None:
        self.positions = event.positions
        self._changes.moved = True

    @apply.register
    def _(self, event: PointStarted) -> None:
        before = self.current_plane
        self.current = event.index
        self._changes.current = True
        self._changes.planes.update(plane for plane in (before, self.current_plane) if plane is not None)
        self._tick(event.time)

    @apply.register
    def _(self, event: PointMeasured) -> None:
        old = self.points[event.index]
        self.measured += not (old.earlier or old.brf is not None)
        self._update(
            replace(
                old,
                brf=event.brf,
                u_brf=event.u_brf,
                time=event.time,
                quality_flag=event.quality_flag,
                skipped="",
            )
        )
        self.last = event
        self.health.extend([(self.hours(event.time), event.dark, noise_of(event.signal), event.gain)])
        self.time_left_s = event.time_left_s
        self._changes.current = self._changes.progress = True
        self._tick(event.time)

    @apply.register
    def _(self, event: PointSkipped) -> None:
        self._update(replace(self.points[event.index], skipped=event.reason or "not measured"))
        self._changes.progress = True
        self._tick(event.time)

    @apply.register
    def _(self, event: PointAnnotated) -> None:
        if event.source == "twin" and "brf" in event.values:
            self._update(
                replace(
                    self.points[event.index],
                    simulated=event.values["brf"],
                    u_simulated=event.values.get("u_brf", 0.0),
                )
            )

    @apply.register
    def _(self, event: Message) -> None:
        self._say(Line(event.time, event.level, event.text, event.advice))

    @apply.register
    def _(self, event: ScanEnded) -> None:
        self.end = event
        self.state, self.state_reason = State(event.outcome), event.reason
        self.current = None
        self.time_left_s = 0.0 if event.outcome == "finished" else None
        self._changes.state = self._changes.progress = self._changes.current = True
        self._changes.planes.update(self.planes)
        self._tick(event.time)

    @apply.register
    def _(self, notice: ControllerStarting) -> None:
        self._clear()
        self.state, self.connected = State.CONNECTING, True
        self._changes = Changes(scan=True, messages=self._changes.messages)

    @apply.register
    def _(self, notice: ControllerFailed) -> None:
        if self.state not in FINAL:
            self.state, self.state_reason = State.FAULTED, notice.text
        self._changes.state = True
        self._say(Line(notice.time, "error", notice.text, notice.advice))

    @apply.register
    def _(self, notice: ControllerClosed) -> None:
        self.connected = False
        self.request = None
        self._changes.state = self._changes.request = True

    @apply.register
    def _(self, notice: OperatorAsked) -> None:
        self.request = notice.what
        self._changes.request = self._changes.state = True

    @apply.register
    def _(self, notice: OperatorAnswered) -> None:
        self.request = None
        self._changes.request = self._changes.state = True

    @apply.register
    def _(self, notice: ProcedureStarted) -> None:
        self.procedure = notice.title
        self._changes.state = True

    @apply.register
    def _(self, notice: ProcedureEnded) -> None:
        self.procedure, self.request = "", None
        self._changes.state = self._changes.request = True

    def _say(self, line: Line) -> None:
        self.messages.append(line)
        self._changes.messages += 1

    def _tick(self, time: datetime) -> None:
        self.latest = time
        self._changes.progress = True

    def _update(self, point: Point) -> None:
        """Replace a point and keep the counts that depend on it."""
        old, plane = self.points[point.index], plane_of(point.geometry)
        if None not in (point.brf, point.simulated):
            assert point.brf is not None
            assert point.simulated is not None
            score = self._score(point.brf, point.u_brf or 0.0, point.simulated, point.u_simulated or 0.0)
            point = replace(point, score=score)
        for counter in (self.tally, self.plane_tally[plane]):
            if old.score:
                counter[old.score.category] -= 1
            if point.score:
                counter[point.score.category] += 1
        self.plane_settled[plane] += point.settled - old.settled
        newly_missing = bool(point.skipped) - bool(old.skipped)
        self.plane_missing[plane] += newly_missing
        self.missing += newly_missing
        self.points.store(point)
        self._changes.planes.add(plane)
        self._changes.points.add(point.index)
