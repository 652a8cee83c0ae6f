"""How long a scan takes, and by which ways: the scan gone through in thought, step by step as the engine does it.

The moves follow the trapezoidal profiles of the axes along the checked ways, the readings the averaging of the meter;
what lies between them (settling, polls, questions on the wire, changes of the filter, hands at the stage) is counted
as well. Seconds are laboratory seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from drivers.interfaces import AxisLimits, Laboratory
from instrument.approach import Leg
from instrument.durations import move_time
from instrument.errors import SafetyError
from instrument.events import Geometry
from instrument.safety import Envelope, Pose
from instrument.settings import ScanSettings
from instrument.stages import parts_of, stage_legs

#: A meter that does not say how long a burst takes: seconds a sample.
USUAL_SAMPLE = 0.04
#: Questions on the wire: of a move until it is known to have arrived, of a reading with its readbacks, and of a look
#: whether an axis stands still.
_OF_A_MOVE, _OF_A_READING, _OF_A_REST = 9, 34, 6
#: Changes of gain before the first reading that fits; later ones are rare.
_FIRST_GAINS = 1


@dataclass(frozen=True)
class Pace:
    """What things take beside moves.

    Attributes
    ----------
    burst, dark
        Of a burst with light and of one in the dark.
    shutter
        To open or to close.
    gain
        To settle after a change of gain.
    filter
        To change the wavelength.
    exchange
        A question on the wire and its answer.
    speeds
        Limits of every axis, the stages among them.
    """

    settings: ScanSettings
    burst: float
    dark: float
    shutter: float = 0.0
    gain: float = 0.0
    filter: float = 0.0
    exchange: float = 0.0
    speeds: Mapping[str, AxisLimits] = field(default_factory=dict)

    @classmethod
    def of(cls, laboratory: Laboratory, settings: ScanSettings, samples: int, exchange: float = 0.0) -> Pace:
        """What the devices say of themselves; devices that say nothing are quick."""
        detector: Any = laboratory.detector
        time_of = getattr(detector, "burst_time", lambda count: count * USUAL_SAMPLE)
        axes = laboratory.axes() | laboratory.stages()
        return cls(
            settings,
            burst=float(time_of(samples)),
            dark=float(time_of(settings.acquisition.dark_samples)),
            shutter=float(getattr(laboratory.shutter, "moving_time", 0.0)),
            gain=float(laboratory.amplifier.settling_time),
            filter=float(getattr(laboratory.selector, "change_time", 0.0)),
            exchange=exchange,
            speeds={name: axis.limits for name, axis in axes.items()},
        )

    def move(self, leg: Leg) -> float:
        """A move, until it is known that the axis has arrived."""
        poll = self.settings.motion.poll + 2 * self.exchange
        return move_time(leg.target - leg.start, self.speeds[leg.axis]) + poll / 2 + _OF_A_MOVE * self.exchange

    def reading(self, gains: int = 0) -> float:
        """A reading at a gain that fits, after so many changes."""
        settling = self.settings.acquisition.settling
        more = gains * (self.gain + self.burst)
        return 2 * (self.shutter + settling) + self.burst + self.dark + more + _OF_A_READING * self.exchange

    def rest(self) -> float:
        """Making sure that every axis stands still."""
        return len(self.speeds) * (self.settings.motion.poll + _OF_A_REST * self.exchange)


@dataclass(frozen=True)
class Step:
    """One thing of a scan: a reading of the reference or of a point, or hands at the stage.

    Attributes
    ----------
    index
        Of the point or of the reading of the reference; -1 for hands.
    legs
        Moves that lead there.
    begin, moves, end
        When it begins, how long it moves, when it ends: seconds from the start of the scan.
    """

    kind: Literal["reference", "point", "hands"]
    index: int
    geometry: Geometry | None
    legs: tuple[Leg, ...]
    begin: float
    moves: float
    end: float


@dataclass(frozen=True)
class Forecast:
    """A scan gone through in thought."""

    steps: tuple[Step, ...]
    preparation: float
    duration: float

    @property
    def moving(self) -> float:
        """Seconds of all moves."""
        return sum(step.moves for step in self.steps)

    @property
    def references(self) -> int:
        """Readings of the reference, repetitions on schedule among them."""
        return sum(step.kind == "reference" for step in self.steps)


Numbered = Sequence[tuple[int, Geometry]]


def forecast(
    points: Numbered,
    references: Numbered,
    every_reference: Numbered,
    envelope: Envelope,
    pace: Pace,
    *,
    start: Pose,
    to_home: int = 0,
    repeat_minutes: float = 0.0,
    reference_age: float = 0.0,
    turned: float | None = 0.0,
) -> Forecast:
    """Go through a scan.

    Parameters
    ----------
    points, references
        What is to be measured, and the readings of the reference before it, with their indices.
    every_reference
        What a repetition on schedule reads.
    envelope
        Where the arms may be.
    start
        Where the arms stand once they are homed.
    to_home
        How many axes have to look for their zero.
    repeat_minutes
        After how long the reference is repeated; 0 for never.
    reference_age
        Seconds since the reference was read that a resumed scan goes on with.
    turned
        Illumination azimuth (degree) at which the manual stage stands; None where a person has to set it first.

    Raises
    ------
    SafetyError
        If no allowed way leads to a point, or to a repetition of the reference and back.
    """
    walk = _Walk(envelope, pace, start)
    walk.now += to_home * (pace.settings.motion.homing + pace.settings.motion.poll)
    preparation = walk.now
    calibrated = walk.now if references else walk.now - reference_age
    if references:
        walk.calibrate(references)
    walk.hands()
    for index, geometry in points:
        if repeat_minutes > 0 and walk.now - calibrated >= 60.0 * repeat_minutes:
            calibrated = walk.now
            walk.calibrate(every_reference)
            walk.hands()
        if geometry.illumination_azimuth != turned:
            turned = geometry.illumination_azimuth
            walk.hands()
        walk.measure("point", index, geometry)
    if repeat_minutes > 0:
        walk.calibrate(every_reference)
    return Forecast(tuple(walk.steps), preparation, walk.now + pace.rest())


class _Walk:
    """Where everything stands in the course of a scan."""

    def __init__(self, envelope: Envelope, pace: Pace, start: Pose) -> None:
        self._envelope, self._pace = envelope, pace
        self._pose, self._loose = start, envelope.one_sided
        self._stages: dict[str, float] = {}
        self._wavelength: float | None = None
        self._last_reading = 0.0
        self._gains = _FIRST_GAINS
        self.now = 0.0
        self.steps: list[Step] = []

    def hands(self) -> None:
        """Somebody changes what lies on the stage, or turns it: arms at rest, source off and on again."""
        begin, pace = self.now, self._pace
        self.now += pace.rest() + pace.settings.hands + pace.settings.warm_up
        self._wavelength = self._wavelength if pace.settings.emission_while_mounting else None
        self.steps.append(Step("hands", -1, None, (), begin, 0.0, self.now))

    def calibrate(self, references: Numbered) -> None:
        """Hands put the reference on the stage, and it is read."""
        self.hands()
        for index, geometry in references:
            self.measure("reference", index, geometry)

    def measure(self, kind: Literal["reference", "point"], index: int, geometry: Geometry) -> None:
        """Go to a geometry and read."""
        begin, pace = self.now, self._pace
        if geometry.wavelength != self._wavelength:
            self._wavelength = geometry.wavelength
            self.now += pace.filter
        turns = [
            stage_legs(self._stages, geometry.sample_rotation, part, pace.speeds)
            for part in parts_of(geometry.polarization)
        ]
        legs = [*turns[0], *self._way(kind, index, geometry), *(leg for turn in turns[1:] for leg in turn)]
        moves = sum(pace.move(leg) for leg in legs)
        self.now += moves + sum(self._read() for _ in turns)
        self.steps.append(Step(kind, index, geometry, tuple(legs), begin, moves, self.now))

    def _way(self, kind: str, index: int, geometry: Geometry) -> Iterator[Leg]:
        target = Pose.of(geometry)
        try:
            yield from self._envelope.route(self._pose, target, self._loose)
        except SafetyError as error:
            name = f"point {index + 1}" if kind == "point" else f"reference {index + 1}"
            raise SafetyError(f"{name}: {error}") from None
        self._pose, self._loose = target, frozenset()

    def _read(self) -> float:
        """Settling, or what the reading before left of the dwell, and the reading itself."""
        pace = self._pace
        wait = max(pace.settings.acquisition.settling, pace.settings.dwell - self._last_reading)
        self._last_reading = pace.reading(self._gains)
        self._gains = 0
        return wait + self._last_reading
