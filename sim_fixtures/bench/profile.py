"""Trapezoidal motion: constant acceleration, constant speed, constant deceleration."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Segment:
    """A stretch of constant acceleration: seconds, degree/s at its begin, degree/s^2."""

    duration: float
    velocity: float
    acceleration: float

    def advance(self, elapsed: float) -> tuple[float, float]:
        """Way (degree) and velocity (degree/s) after ``elapsed`` seconds of the segment."""
        way = self.velocity * elapsed + 0.5 * self.acceleration * elapsed * elapsed
        return way, self.velocity + self.acceleration * elapsed


@dataclass(frozen=True)
class Motion:
    """A motion that begins at ``start_time`` and ends, at rest, in ``target`` (degree)."""

    start_time: float
    start: float
    target: float
    segments: tuple[Segment, ...]

    @property
    def duration(self) -> float:
        """Seconds from the start to rest."""
        return sum(segment.duration for segment in self.segments)

    @property
    def end_time(self) -> float:
        return self.start_time + self.duration

    def at(self, time: float) -> tuple[float, float]:
        """Position (degree) and velocity (degree/s) at a time; exactly ``target`` from the end on."""
        remaining = time - self.start_time
        if remaining >= self.duration:
            return self.target, 0.0
        position, velocity = self.start, self.segments[0].velocity
        remaining = max(remaining, 0.0)
        for segment in self.segments:
            way, velocity = segment.advance(min(remaining, segment.duration))
            position += way
            if remaining < segment.duration:
                break
            remaining -= segment.duration
        return position, velocity


def plan_stop(time: float, position: float, velocity: float, deceleration: float) -> Motion:
    """Brake to rest with ``deceleration`` (degree/s^2)."""
    brake = Segment(abs(velocity) / deceleration, velocity, -math.copysign(deceleration, velocity))
    return Motion(time, position, position + brake.advance(brake.duration)[0], (brake,))


def plan_motion(
    time: float,
    position: float,
    velocity: float,
    target: float,
    top_speed: float,
    acceleration: float,
    deceleration: float | None = None,
) -> Motion:
    """Motion from a moving or resting state to rest in ``target``, as fast as the limits allow.

    An arm that moves the wrong way, or too fast to stop in time, brakes to rest first.

    Parameters
    ----------
    time
        Laboratory time of the begin, s.
    position, velocity
        State at the begin, degree and degree/s.
    top_speed, acceleration, deceleration
        Positive limits, degree/s and degree/s^2; ``deceleration`` is ``acceleration`` where not given.

    Raises
    ------
    ValueError
        If a limit is not positive.
    """
    braking = acceleration if deceleration is None else deceleration
    if min(top_speed, acceleration, braking) <= 0:
        raise ValueError(f"speed and rates must be positive, found {top_speed}, {acceleration}, {braking}")
    sign = math.copysign(1.0, target - position) if target != position else math.copysign(1.0, velocity)
    forward, distance = velocity * sign, abs(target - position)
    if forward < 0 or forward**2 / (2 * braking) > distance:
        halt = plan_stop(time, position, velocity, braking)
        rest = plan_motion(halt.end_time, halt.target, 0.0, target, top_speed, acceleration, braking)
        return Motion(time, position, target, halt.segments + rest.segments)
    profile = _forward_profile(forward, distance, top_speed, acceleration, braking)
    segments = tuple(Segment(s.duration, sign * s.velocity, sign * s.acceleration) for s in profile if s.duration > 0)
    return Motion(time, position, target, segments or (Segment(0.0, 0.0, 0.0),))


def _forward_profile(
    velocity: float, distance: float, top_speed: float, acceleration: float, braking: float
) -> tuple[Segment, ...]:
    """Segments of a motion forwards whose initial speed can still be braked within the distance."""
    if velocity > top_speed:
        slow = Segment((velocity - top_speed) / braking, velocity, -braking)
        rest = distance - slow.advance(slow.duration)[0]
        return (slow, *_forward_profile(top_speed, rest, top_speed, acceleration, braking))
    reachable = math.sqrt((distance + velocity**2 / (2 * acceleration)) / (0.5 / acceleration + 0.5 / braking))
    peak = max(min(reachable, top_speed), velocity)
    ramp = (peak**2 - velocity**2) / (2 * acceleration) + peak**2 / (2 * braking)
    cruise = max(distance - ramp, 0.0) / peak if peak > 0 else 0.0
    return (
        Segment((peak - velocity) / acceleration, velocity, acceleration),
        Segment(cruise, peak, 0.0),
        Segment(peak / braking, peak, -braking),
    )
