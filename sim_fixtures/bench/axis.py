"""An arm of the goniometer: where it stands at any laboratory time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sim_fixtures.bench.clock import Time
from sim_fixtures.bench.profile import Motion, Segment, plan_motion, plan_stop


@dataclass(frozen=True)
class AxisDesign:
    """What an arm is built for: degree, degree/s, degree/s^2, seconds.

    Attributes
    ----------
    lower, upper
        Mechanical travel, between the limit switches.
    step
        Encoder step; a position at rest is a multiple of it.
    parked
        Where the arm happens to stand when the power comes on; the drive counts from 0 there until it has homed.
    """

    lower: float
    upper: float
    step: float
    velocity: float = 20.0
    acceleration: float = 10.0
    homing_time: float = 10.0
    parked: float = 0.0


class AxisModel:
    """One arm. Not locked: the bench's lock guards it."""

    def __init__(self, name: str, design: AxisDesign, clock: Time) -> None:
        self.name, self.design = name, design
        self._homed = False
        self._homing = False
        self._at_limit = 0
        self.stalled = False
        self.stalls_to_come = 0
        self.on_target: Callable[[], None] = lambda: None
        self._clock = clock
        self._rest = design.parked
        self._zero_error = design.parked
        self._motion: Motion | None = None
        self._stall_time: float | None = None

    @property
    def homed(self) -> bool:
        """True once the search for the zero has succeeded."""
        self._settle()
        return self._homed

    @property
    def homing(self) -> bool:
        """True during the search for the zero."""
        self._settle()
        return self._homing

    @property
    def at_limit(self) -> int:
        """Limit switch that is closed: -1 lower, 1 upper, 0 none."""
        self._settle()
        return self._at_limit

    def true_position(self) -> float:
        """Where the arm stands, degree of the laboratory frame."""
        self._settle()
        return self._motion_state()[0]

    def position(self) -> float:
        """What the drive's counter shows, degree, rounded to the encoder step."""
        return self._grid(self.true_position() - self._zero_error)

    def target(self) -> float:
        """Where the arm will rest if nothing else is commanded, degree of the laboratory frame."""
        return self._motion.target if self._motion is not None else self._rest

    def moving(self) -> bool:
        """True while the drive believes that it moves; a stalled arm counts as moving until it is stopped."""
        self._settle()
        return self._motion is not None

    def velocity(self) -> float:
        """Degree/s now."""
        self._settle()
        return self._motion_state()[1]

    def move(self, target: float, velocity: float, acceleration: float, deceleration: float | None = None) -> None:
        """Go to a position of the drive's counter with the given limits."""
        position, speed = self.true_position(), self.velocity()
        self._homing, self.stalled, self._stall_time = False, False, None
        goal = self._grid(target) + self._zero_error
        now = self._clock.now()
        self._motion = plan_motion(now, position, speed, goal, velocity, acceleration, deceleration)
        if self.stalls_to_come > 0:
            self.stalls_to_come -= 1
            self._stall_time = now + self._motion.duration / 2
        self.on_target()

    def stop(self, deceleration: float | None = None) -> None:
        """Brake; a search for the zero is given up."""
        position, speed = self.true_position(), self.velocity()
        if self._motion is None:
            return
        self._homing, self.stalled, self._stall_time = False, False, None
        halt = plan_stop(self._clock.now(), position, speed, deceleration or self.design.acceleration)
        end = self._grid(halt.target - self._zero_error) + self._zero_error
        self._motion = Motion(halt.start_time, halt.start, end, halt.segments)
        self._settle()

    def halt(self) -> None:
        """Stand still at once: power cut, limit switch or drive fault."""
        self._rest = self._grid(self.true_position() - self._zero_error) + self._zero_error
        self._motion, self._stall_time = None, None
        self._homing = self.stalled = False

    def home(self) -> None:
        """Search the zero: drive there, then feel for the index, ``homing_time`` in all."""
        position, speed = self.true_position(), self.velocity()
        design = self.design
        approach = plan_motion(self._clock.now(), position, speed, 0.0, design.velocity, design.acceleration)
        feel = Segment(max(design.homing_time - approach.duration, 0.0), 0.0, 0.0)
        self._motion = Motion(approach.start_time, position, 0.0, (*approach.segments, feel))
        self._stall_time, self.stalled = None, False
        self._homed, self._homing = False, True

    def lose_home(self) -> None:
        """Forget the zero: reset, or a limit switch was hit."""
        self._homed = False

    def stall(self, count: int = 1) -> None:
        """Let the next ``count`` motions (or the one under way) stop half-way without the drive noticing."""
        if self.moving() and not self._homing and count > 0:
            self._stall_time = self._clock.now()
            count -= 1
        self.stalls_to_come = count

    def hit_limit(self, direction: int) -> None:
        """Close a limit switch: -1 lower, +1 upper; 0 releases it."""
        self._at_limit = direction
        if direction:
            self.halt()

    def release_limit(self) -> None:
        """The arm has been moved off the limit switch."""
        self._at_limit = 0

    def _grid(self, position: float) -> float:
        return round(round(position / self.design.step) * self.design.step, 9)

    def _motion_state(self) -> tuple[float, float]:
        if self._motion is None:
            return self._rest, 0.0
        if self.stalled and self._stall_time is not None:
            return self._motion.at(self._stall_time)[0], 0.0
        return self._motion.at(self._clock.now())

    def _settle(self) -> None:
        """Bring the state up to the present: motion ended, stalled, or run into a limit switch."""
        if self._motion is None:
            return
        now = self._clock.now()
        if self._stall_time is not None and now >= self._stall_time:
            self.stalled = True
            return
        position = self._motion.at(now)[0]
        if not self.design.lower <= position <= self.design.upper:
            self._rest = min(max(position, self.design.lower), self.design.upper)
            self._motion, self._homing = None, False
            self._at_limit = -1 if position < self.design.lower else 1
            return
        if now >= self._motion.end_time:
            self._rest, self._motion = self._motion.target, None
            self._at_limit = 0
            if self._homing:
                self._homing, self._homed, self._zero_error = False, True, 0.0
