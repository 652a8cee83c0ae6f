"""Where the arms may be and how they get there, decided before anything moves.

The illumination arm moves in the x-z plane; the detector head must never come closer to its direction than the
half-angle of the shadow cone, neither at a point nor on the way between two. Arms move one after the other, so
that the path is known exactly: nobody knows how two drives share their time. Where the direct ways cross the
cone, the shortest way around it is sought (swing the azimuth aside, or the illumination arm).

Degrees throughout; see the data contract, section Angles and frames.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count, permutations
from typing import NamedTuple

from drivers.interfaces import AxisLimits
from instrument.approach import Leg, beyond_target, one_sided
from instrument.durations import AXES, move_time
from instrument.errors import InputError, SafetyError
from instrument.events import Geometry
from instrument.facility import Arms
from instrument.plan import SHADOW_SLACK, describe
from instrument.turning import driven, require_turnable

__all__ = ["Box", "CheckedPlan", "Envelope", "Leg", "Pose", "check_plan", "closest"]

#: Spacing of the ways around the cone that are tried, degree: a coarse lattice first.
_DETOUR_STEPS = (45.0, 15.0)
#: How far ways keep from boxes, degree, where they turn beside one.
_BESIDE = 1.0
#: Seconds that a move costs beyond its profile (settling, read-back): prefers ways with few moves.
_MOVE_COST = 1.0


class Pose(NamedTuple):
    """Where the three arms stand, degree."""

    illumination_zenith: float
    sensor_azimuth: float
    sensor_zenith: float

    @classmethod
    def of(cls, geometry: Geometry) -> Pose:
        """The pose that measures a geometry, the sample turned by hands where that needs it."""
        return cls(*driven(geometry))

    def moved(self, axis: str, target: float) -> Pose:
        """This pose with one arm elsewhere."""
        return self._replace(**{axis: target})

    def separation(self) -> float:
        """Angle between illumination and sensor direction, degree."""
        return _separation(self.illumination_zenith, self.sensor_azimuth, self.sensor_zenith)


class Box(NamedTuple):
    """Poses that must not be taken: mechanical interference, or anything else in the way (degree, rims included)."""

    name: str
    low: Pose
    high: Pose

    def touched(self, pose: Pose, leg: Leg | None = None) -> bool:
        """Whether a pose, or any on the way of one arm, lies in the box. Exact: a leg is a line along an axis.

        Parameters
        ----------
        pose
            Where the other arms stand.
        leg
            The move; None for the pose alone.
        """
        for axis, low, high, value in zip(AXES, self.low, self.high, pose, strict=True):
            first, last = (value, value) if leg is None or axis != leg.axis else sorted((leg.start, leg.target))
            if last < low or first > high:
                return False
        return True


def closest(pose: Pose, leg: Leg) -> float:
    """Smallest angle (degree) between illumination and sensor direction while one arm moves.

    Exact: along a leg the cosine of the angle is a sinusoid of the moving coordinate, so its largest value lies
    at an end or where the sinusoid peaks.
    """
    low, high = sorted((leg.start, leg.target))
    candidates = [low, high]
    peak = math.degrees(_peak_rad(pose, leg.axis))
    first = peak + 360.0 * math.ceil((low - peak) / 360.0)
    while first <= high:
        candidates.append(first)
        first += 360.0
    return min(pose.moved(leg.axis, value).separation() for value in candidates)


def _peak_rad(pose: Pose, axis: str) -> float:
    """Where the moving coordinate brings the two directions closest."""
    ill_rad, azimuth_rad, zenith_rad = (math.radians(value) for value in pose)
    if axis == "sensor_azimuth":
        return 0.0 if math.sin(ill_rad) * math.sin(zenith_rad) >= 0 else math.pi
    fixed_rad = ill_rad if axis == "sensor_zenith" else zenith_rad
    return math.atan2(math.sin(fixed_rad) * math.cos(azimuth_rad), math.cos(fixed_rad))


def _separation(illumination_zenith: float, sensor_azimuth: float, sensor_zenith: float) -> float:
    i, a, s = (math.radians(value) for value in (illumination_zenith, sensor_azimuth, sensor_zenith))
    dx = math.sin(s) * math.cos(a) - math.sin(i)
    dy = math.sin(s) * math.sin(a)
    dz = math.cos(s) - math.cos(i)
    return math.degrees(2.0 * math.asin(min(math.sqrt(dx * dx + dy * dy + dz * dz) / 2.0, 1.0)))


@dataclass(frozen=True)
class Envelope:
    """Where the arms may be: travel (degree, (lower, upper)), half-angle of the cone, boxes where they would touch;
    ``turning`` is how far hands can turn the sample."""

    travel: Mapping[str, tuple[float, float]]
    cone: float
    speeds: Mapping[str, AxisLimits] = field(default_factory=dict)
    keep_out: tuple[Box, ...] = ()
    turning: tuple[float, float] | None = None
    _known: dict[tuple[Pose, Pose, frozenset[str]], tuple[Leg, ...]] = field(
        default_factory=dict, repr=False, compare=False
    )

    @classmethod
    def of(cls, arms: Arms, limits: Mapping[str, AxisLimits]) -> Envelope:
        """What both the facility and the drives allow.

        Raises
        ------
        SafetyError
            If the two leave an arm no travel at all.
        """
        travel = {}
        for axis in AXES:
            low, high = getattr(arms, axis)
            travel[axis] = (max(low, limits[axis].lower), min(high, limits[axis].upper))
            if travel[axis][0] > travel[axis][1]:
                raise SafetyError(
                    f"{axis}: the facility allows {low:g} to {high:g} degrees, the drive {limits[axis].lower:g} to"
                    f" {limits[axis].upper:g}: nothing in common"
                )
        boxes = (
            Box(kept.name, *(Pose(*(getattr(kept, axis)[end] for axis in AXES)) for end in (0, 1)))
            for kept in arms.keep_out
        )
        return cls(travel, arms.shadow_half_angle, dict(limits), tuple(boxes), arms.illumination_azimuth)

    def check_point(self, geometry: Geometry, name: str) -> Pose:
        """The pose of a point, which may be taken.

        Raises
        ------
        InputError
            If an angle lies beyond an arm, or beyond the stage under the sample.
        SafetyError
            If the detector head would stand in the beam, or where it must be kept out of.
        """
        require_turnable(geometry, self.turning, name)
        pose = Pose.of(geometry)
        for axis, value in zip(AXES, pose, strict=True):
            low, high = self.travel[axis]
            if not low <= value <= high:
                raise InputError(
                    f"{name}: {axis}: found {value:g} degrees, beyond the arm; expected {low:g} to {high:g}"
                    f" ({describe(geometry)})"
                )
            self._check_approach(axis, value, name)
        if pose.separation() < self.cone - SHADOW_SLACK:
            raise SafetyError(
                f"{name}: {describe(geometry)}: {pose.separation():.2f} degrees from retro-reflection, the detector"
                f" head would stand in the beam (at least {self.cone:g} degrees)"
            )
        for box in self.keep_out:
            if box.touched(pose):
                raise SafetyError(f"{name}: {describe(geometry)}: lies where the arms are kept out ({box.name})")
        return pose

    def _check_approach(self, axis: str, value: float, name: str) -> None:
        if axis not in self.one_sided:
            return
        (low, high), first = self.travel[axis], beyond_target(value, self.speeds[axis])
        if not low <= first <= high:
            side = "rising" if self.speeds[axis].approach > 0 else "falling"
            raise InputError(
                f"{name}: {axis}: {value:g} degrees cannot be reached on {side} angles: the arm would go to {first:g}"
                f" first, beyond its travel of {low:g} to {high:g}"
            )

    @property
    def one_sided(self) -> frozenset[str]:
        """Arms that reach their targets from one side only."""
        return frozenset(axis for axis, limits in self.speeds.items() if limits.approach)

    def clear(self, pose: Pose, leg: Leg) -> bool:
        """Whether an arm may move: within its travel (or towards it), and never closer to the beam than the cone.

        Arms that already stand inside the cone, after homing for example, may only move away from the beam. Out of a
        box that is kept out of no way is known: a person has to bring the arms out of it.
        """
        low, high = self.travel[leg.axis]
        if not low <= leg.target <= high:
            return False
        if any(box.touched(pose, leg) for box in self.keep_out):
            return False
        return closest(pose, leg) >= min(self.cone, pose.separation()) - SHADOW_SLACK

    def route(self, start: Pose, target: Pose, loose: frozenset[str] = frozenset()) -> tuple[Leg, ...]:
        """Moves, one arm at a time, from a pose to another: the direct way, or else the shortest found around.

        Parameters
        ----------
        loose
            Arms whose gears may be anywhere within their play: those that have an approach are made to take it.

        Raises
        ------
        SafetyError
            If every way crosses the cone, leads where arms are kept out, or leaves the travel.
        """
        for box in self.keep_out:
            if box.touched(start):
                raise SafetyError(
                    f"the arms stand at {_say(start)}, where they are kept out ({box.name}); bring them out by hand"
                )
        key = (start, target, loose & self.one_sided)
        if key not in self._known:
            self._known[key] = self._find(*key)
        return self._known[key]

    def _find(self, start: Pose, target: Pose, loose: frozenset[str]) -> tuple[Leg, ...]:
        direct = min(self._direct(start, target, loose), key=self._cost, default=None)
        if direct is not None:
            return direct
        for step in _DETOUR_STEPS:
            around = self._search(start, target, loose, step)
            if around is not None:
                return around
        raise SafetyError(
            f"no way from {_say(start)} to {_say(target)} keeps {self.cone:g} degrees from the beam within the"
            " travel of the arms; reorder the plan or widen the travel"
        )

    def _direct(self, start: Pose, target: Pose, loose: frozenset[str]) -> Iterator[tuple[Leg, ...]]:
        for order in permutations(_to_move(start, target, loose)):
            legs: list[Leg] = []
            pose = start
            for axis in order:
                moves = self._moves(pose, axis, getattr(target, axis), loose)
                if moves is None:
                    break
                legs += moves
                pose = pose.moved(axis, getattr(target, axis))
            else:
                yield tuple(legs)

    def _moves(self, pose: Pose, axis: str, target: float, loose: frozenset[str]) -> tuple[Leg, ...] | None:
        """What brings one arm to a target from the side it has to come from; None where it must not go there."""
        leg = Leg(axis, getattr(pose, axis), target)
        moves = one_sided(leg, self.speeds.get(axis), loose=axis in loose)
        for move in moves:
            if not self.clear(pose, move):
                return None
            pose = pose.moved(axis, move.target)
        return moves

    def _search(self, start: Pose, target: Pose, loose: frozenset[str], step: float) -> tuple[Leg, ...] | None:
        """The A* algorithm over a lattice of poses; what a direct way would still cost never overestimates."""
        stops = self._stops(start, target, step)
        order = count()
        queue: list[tuple[float, int, float, Pose, frozenset[str], tuple[Leg, ...]]] = [
            (0.0, next(order), 0.0, start, loose, ())
        ]
        done: set[tuple[Pose, frozenset[str]]] = set()
        while queue:
            _, _, cost, pose, still_loose, legs = heapq.heappop(queue)
            if pose == target and not still_loose:
                return legs
            if (pose, still_loose) in done:
                continue
            done.add((pose, still_loose))
            for axis in AXES:
                engaged = still_loose - {axis}
                for value in stops[axis]:
                    after = pose.moved(axis, value)
                    if (after, engaged) in done:
                        continue
                    moves = self._moves(pose, axis, value, still_loose)
                    if moves:
                        spent = cost + self._cost(moves)
                        likely = spent + self._cost(_straight(after, target))
                        heapq.heappush(queue, (likely, next(order), spent, after, engaged, (*legs, *moves)))
        return None

    def _stops(self, start: Pose, target: Pose, step: float) -> dict[str, list[float]]:
        """Values of each arm that a way around may use: a lattice, beside both ends by a cone's width, beside boxes."""
        stops = {}
        for axis in AXES:
            low, high = self.travel[axis]
            ends = {getattr(start, axis), getattr(target, axis)}
            steps = max(math.ceil((high - low) / step), 1)
            lattice = {low + (high - low) * number / steps for number in range(steps + 1)}
            beside = {end + side * 2.5 * self.cone for end in ends for side in (-1, 1)}
            around = {getattr(box.low, axis) - _BESIDE for box in self.keep_out}
            around |= {getattr(box.high, axis) + _BESIDE for box in self.keep_out}
            allowed = {value for value in lattice | beside | around if low <= value <= high}
            stops[axis] = sorted(allowed | ends)
        return stops

    def _cost(self, legs: Iterable[Leg]) -> float:
        return sum(_MOVE_COST + self._seconds(leg) for leg in legs)

    def _seconds(self, leg: Leg) -> float:
        distance = leg.target - leg.start
        return move_time(distance, self.speeds[leg.axis]) if leg.axis in self.speeds else abs(distance) / 10.0

    def duration(self, legs: Iterable[Leg]) -> float:
        """Laboratory seconds of moves, without settling."""
        return sum(self._seconds(leg) for leg in legs)


@dataclass(frozen=True)
class CheckedPlan:
    """A plan all of whose points and ways are allowed.

    Attributes
    ----------
    routes
        The moves that lead to each point from the one before; the first from ``start``.
    moving_time
        Laboratory seconds of all moves.
    detours
        How many points need a way around the cone, or around where arms are kept out.
    """

    start: Pose
    routes: tuple[tuple[Leg, ...], ...]
    moving_time: float
    detours: int


def check_plan(points: Iterable[tuple[str, Geometry]], start: Pose, envelope: Envelope) -> CheckedPlan:
    """Check every named point and every segment between them, before anything moves.

    Parameters
    ----------
    points
        Name (for messages) and geometry, in the order in which they are measured.
    start
        Where the arms will stand at the beginning, their gears loose.

    Raises
    ------
    InputError
        If a point lies beyond an arm.
    SafetyError
        If a point lies in the shadow cone, or no allowed way leads to it.
    """
    named = [(name, envelope.check_point(geometry, name)) for name, geometry in points]
    routes, pose, detours, loose = [], start, 0, envelope.one_sided
    for name, target in named:
        try:
            legs = envelope.route(pose, target, loose)
        except SafetyError as error:
            raise SafetyError(f"{name}: {error}") from None
        detours += sum(not leg.overshoot for leg in legs) > len(_to_move(pose, target, loose))
        routes.append(legs)
        pose, loose = target, frozenset()
    return CheckedPlan(start, tuple(routes), sum(envelope.duration(legs) for legs in routes), detours)


def _to_move(start: Pose, target: Pose, loose: frozenset[str]) -> list[str]:
    """Arms that cannot stay as they are."""
    return [axis for axis, a, b in zip(AXES, start, target, strict=True) if a != b or axis in loose]


def _straight(start: Pose, target: Pose) -> list[Leg]:
    return [Leg(axis, a, b) for axis, a, b in zip(AXES, start, target, strict=True) if a != b]


def _say(pose: Pose) -> str:
    return ", ".join(f"{axis.replace('_', ' ')} {value:g}" for axis, value in zip(AXES, pose, strict=True))
