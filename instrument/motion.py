"""Moving one arm and knowing where it is.

A move is done when the drive stands still, says that it has arrived, and the readback agrees with the target;
nothing else counts. No motion command is ever re-sent blindly: after a lost reply, a stall or a deadline the axis
is stopped and read back, and only then decided. At most one new command is given, and it is recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from drivers.clock import Clock
from drivers.errors import CommandRefused, CommunicationError, DeviceError, DeviceFault
from drivers.interfaces import Axis, AxisStatus
from instrument.control import Controls, Interruption, ask
from instrument.durations import AXES, move_time
from instrument.safety import Pose
from instrument.settings import MotionSettings
from instrument.sightings import Sightings

Note = Callable[[str], None]


class MotionFailed(DeviceError):
    """An arm did not arrive, after everything that may be tried was tried.

    Attributes
    ----------
    at_rest
        True when the arm is known to stand still: then other moves may follow. False: nobody knows.
    """

    def __init__(self, device: str, problem: str, *, at_rest: bool) -> None:
        self.at_rest = at_rest
        super().__init__(device, problem, "look at the arm and its drive before going on")


class AxisSilent(MotionFailed):
    """An arm does not answer: where it is, and whether it moves, nobody knows until it does."""

    def __init__(self, device: str, problem: str) -> None:
        super().__init__(device, problem, at_rest=False)


@dataclass(frozen=True)
class _Trouble:
    """Why an attempt ended without arrival; ``reply_lost`` when nobody knows whether the command was taken."""

    problem: str
    reply_lost: bool = False


class Mover:
    """Moves the arms, one at a time.

    Parameters
    ----------
    axes
        By role.
    clock
        Laboratory time.
    controls
        Consulted at every poll: an interruption stops the arm before it goes on.
    note
        Records what was decided, durably, before it is done.
    settings
        Times and deadlines.
    sightings
        Hear of positions as they are read, and now and then of an axis on its way.
    """

    def __init__(
        self,
        axes: Mapping[str, Axis],
        clock: Clock,
        controls: Controls,
        note: Note,
        settings: MotionSettings,
        sightings: Sightings | None = None,
    ) -> None:
        self._axes, self._clock, self._controls, self._note, self._settings = axes, clock, controls, note, settings
        self._sightings = sightings or Sightings()

    def readback(self) -> dict[str, float]:
        """Actual position of every arm, degree."""
        positions = {name: ask(axis.position) for name, axis in self._axes.items()}
        self._sightings.told(positions)
        return positions

    def readback_of(self, name: str) -> float:
        """Actual position of one axis, degree."""
        return ask(self._axes[name].position)

    def pose(self) -> Pose:
        """Where the arms stand."""
        positions = self.readback()
        return Pose(*(positions[name] for name in AXES))

    def tolerance(self, name: str) -> float:
        """How far off an arm may stand and still be in position, degree."""
        return self._axes[name].tolerance

    def home(self, name: str) -> None:
        """Find the zero of an arm that does not know it.

        Raises
        ------
        MotionFailed, DeviceFault
        """
        axis = self._axes[name]
        if ask(axis.status).homed:
            return
        for attempt in (1, 2):
            trouble = self._guarded(axis, axis.home, lambda: self._await_homed(axis))
            if trouble is None:
                return
            self._bring_to_rest(axis)
            status = ask(axis.status)
            if status.homed:
                self._note(f"{name}: {trouble.problem}, yet the axis is homed and stands still")
                return
            if attempt == 2 or status.fault or not trouble.reply_lost:
                raise MotionFailed(name, f"homing: {trouble.problem}" + _suffix(status.fault), at_rest=True)
            self._note(f"{name}: {trouble.problem}; stopped, stands still, not homed: homing is started anew")

    def move(self, name: str, target: float) -> float:
        """Move an arm and return its readback, degree.

        Raises
        ------
        MotionFailed
            If it did not arrive.
        DeviceFault
            If the drive reports an alarm or has lost its zero.
        CommandRefused
            If the drive refuses the target; nothing has moved.
        """
        axis = self._axes[name]
        start = ask(axis.position)
        _require_healthy(name, ask(axis.status))
        for attempt in (1, 2):
            trouble = self._attempt(axis, start, target)
            if trouble is None:
                position = ask(axis.position)
                self._sightings.told({name: position})
                return position
            position = self._bring_to_rest(axis)
            _require_healthy(name, ask(axis.status))
            if abs(position - target) <= axis.tolerance:
                self._note(f"{name}: {trouble.problem}; stopped and read back: it stands at its target {target:g}")
                return position
            where = f"stands still at {position:.4f} on the way from {start:.4f} to {target:g} degrees"
            if attempt == 2 or not self._may_command_anew(axis, trouble, start, target, position):
                raise MotionFailed(name, f"{trouble.problem}; stopped, {where}", at_rest=True)
            self._note(f"{name}: {trouble.problem}; stopped, {where}, homed and without fault: one new command is sent")
            start = position
        raise AssertionError("unreachable")

    def stops(self) -> list[Callable[[], object]]:
        """What stops each arm; all are told before the first is waited for."""
        return [partial(ask, axis.stop) for axis in self._axes.values()]

    def rests(self) -> list[Callable[[], object]]:
        """What makes sure, after a stop, that each arm stands still: some drives do not acknowledge a stop."""
        return [partial(self._await_rest, axis) for axis in self._axes.values()]

    def _attempt(self, axis: Axis, start: float, target: float) -> _Trouble | None:
        return self._guarded(axis, lambda: axis.start_move(target), lambda: self._await_arrival(axis, start, target))

    def _guarded(
        self, axis: Axis, command: Callable[[], None], watch: Callable[[], _Trouble | None]
    ) -> _Trouble | None:
        """Send a command and watch it; whatever interrupts, the arm is stopped first."""
        try:
            try:
                command()
            except CommunicationError as error:
                return _Trouble(f"the reply to the command was lost ({error.problem})", reply_lost=True)
            return watch()
        except CommandRefused:
            raise
        except CommunicationError as error:
            return _Trouble(f"no answer while it moved ({error.problem})", reply_lost=True)
        except Interruption:
            ask(axis.stop)
            self._await_rest(axis)
            raise
        except BaseException:
            ask(axis.stop)
            raise

    def _await_arrival(self, axis: Axis, start: float, target: float) -> _Trouble | None:
        settings = self._settings
        wire = settings.wire_wall * self._clock.speed
        expected = move_time(target - start, axis.limits)
        began = self._clock.monotonic()
        deadline = began + settings.deadline_factor * expected + settings.deadline_extra + wire
        grace = settings.start_grace + 0.25 * wire
        still_since: float | None = None
        while True:
            status = ask(axis.status)
            now = self._clock.monotonic()
            _require_healthy(axis.name, status)
            if status.moving:
                still_since = None
                self._sightings.look(axis)
            else:
                still_since = now if still_since is None else still_since
                position = ask(axis.position)
                if status.in_position and abs(position - target) <= axis.tolerance:
                    return None
                if now - still_since > grace:
                    return _Trouble(f"it stands still at {position:.4f} instead of moving to {target:g} degrees")
            if now > deadline:
                return _Trouble(f"it has not arrived at {target:g} degrees after {now - began:.1f} s")
            self._controls.sleep(settings.poll, settings.poll_wall)

    def _await_homed(self, axis: Axis) -> _Trouble | None:
        settings = self._settings
        wire = settings.wire_wall * self._clock.speed
        began = self._clock.monotonic()
        while True:
            status = ask(axis.status)
            if status.fault:
                raise DeviceFault(axis.name, f"while homing: {status.fault}", "clear the fault at the drive")
            if status.homed and not status.moving:
                return None
            if (elapsed := self._clock.monotonic() - began) > settings.homing_deadline + wire:
                return _Trouble(f"no zero found after {elapsed:.0f} s")
            self._controls.sleep(settings.poll, settings.poll_wall)

    def _bring_to_rest(self, axis: Axis) -> float:
        """Stop an arm and read back where it stands.

        Raises
        ------
        MotionFailed
            With ``at_rest`` False, if it cannot be known to stand still.
        """
        try:
            ask(axis.stop)
            return self._await_rest(axis)
        except CommunicationError as error:
            raise AxisSilent(axis.name, f"it does not answer: {error.problem}") from error

    def _await_rest(self, axis: Axis) -> float:
        settings = self._settings
        wire = settings.wire_wall * self._clock.speed
        now = self._clock.monotonic()
        end, again = now + settings.stop_deadline + wire, now + settings.stop_again + 0.25 * wire
        before: float | None = None
        looks = 0
        while (now := self._clock.monotonic()) <= end or looks < 3:  # a busy computer is no fault of the arm
            looks += 1
            moving = ask(axis.status).moving
            if moving and now > again:
                # A stop may be given again, unlike a move; the first one may have been lost without a trace.
                ask(axis.stop)
                again = now + settings.stop_again + 0.25 * wire
            position = ask(axis.position)
            if not moving and before is not None and abs(position - before) <= 0.1 * axis.tolerance:
                return position
            before = None if moving else position
            # A stop must be seen through even when an interruption is waiting.
            self._clock.sleep(max(settings.poll, settings.poll_wall * self._clock.speed))
        raise MotionFailed(axis.name, "it was told to stop and does not come to rest", at_rest=False)

    def _may_command_anew(self, axis: Axis, trouble: _Trouble, start: float, target: float, position: float) -> bool:
        """Only from a known rest: where the first command had no effect, or where our own stop cut it short."""
        if abs(position - start) <= axis.tolerance:
            return True
        low, high = sorted((start, target))
        return trouble.reply_lost and low - axis.tolerance <= position <= high + axis.tolerance


def _require_healthy(name: str, status: AxisStatus) -> None:
    if status.fault:
        raise DeviceFault(name, status.fault, "clear the fault at the drive, then resume the run")
    if not status.homed:
        raise DeviceFault(name, "the axis has lost its zero", "resume the run: it is homed again")


def _suffix(fault: str) -> str:
    return f" ({fault})" if fault else ""
