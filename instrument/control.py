"""What a person can ask of a running scan, and where the engine listens.

The engine's thread looks at every checkpoint (at least once a poll of a moving axis); the requests themselves
may come from any thread and return at once.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

from drivers.clock import Clock
from drivers.errors import CommunicationError, DeviceFault

T = TypeVar("T")


class Interruption(Exception):
    """The work at hand is to stop; ``reason`` says who asked and why."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class PauseNow(Interruption):
    """Rest at once; what is at hand is repeated afterwards."""


class AbortAsked(Interruption):
    """End in an orderly way."""


class HaltAsked(Interruption):
    """Stop everything at once."""


class Controls:
    """Requests to the engine, and its heartbeat."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._changed = threading.Condition()
        self._wake = threading.Event()
        self._pause: str | None = None
        self._pause_now = False
        self._held = False
        self._abort: str | None = None
        self._halt: str | None = None
        self._beat_wall = time.monotonic()

    def pause(self, *, now: bool, reason: str) -> None:
        """Ask for a rest after the point at hand, or at once."""
        with self._changed:
            self._pause, self._pause_now = reason, self._pause_now or now
            self._notify()

    def resume(self) -> None:
        """Withdraw a pause, or say that a suspension's cause is dealt with."""
        with self._changed:
            self._pause, self._pause_now, self._held = None, False, False
            self._notify()

    def abort(self, reason: str) -> None:
        """Ask for an orderly end; the first reason counts."""
        with self._changed:
            self._abort = self._abort or reason
            self._notify()

    def halt(self, reason: str) -> None:
        """Ask to stop everything at once; the first reason counts."""
        with self._changed:
            self._halt = self._halt or reason
            self._notify()

    @property
    def pause_reason(self) -> str | None:
        """Why to rest; None when nobody asked."""
        return self._pause

    def checkpoint(self) -> None:
        """Prove that the engine lives, and obey.

        Raises
        ------
        HaltAsked, AbortAsked, PauseNow
            In this order of precedence.
        """
        self._beat_wall = time.monotonic()
        with self._changed:
            if self._halt is not None:
                raise HaltAsked(self._halt)
            if self._abort is not None:
                raise AbortAsked(self._abort)
            if self._pause is not None and self._pause_now:
                raise PauseNow(self._pause)

    def silence_wall(self) -> float:
        """Wall-clock seconds since the last checkpoint."""
        return time.monotonic() - self._beat_wall

    def sleep(self, seconds: float, wall: float = 0.0) -> None:
        """Wait for laboratory seconds, but at least ``wall`` seconds of the wall clock; obeys like a checkpoint."""
        clock = self._clock
        end = clock.monotonic() + max(seconds, wall * clock.speed)
        while True:
            self.checkpoint()
            left = end - clock.monotonic()
            if left <= 0:
                return
            clock.wait(self._wake, min(left, clock.speed))

    def rest(self) -> None:
        """Rest until someone resumes.

        Raises
        ------
        HaltAsked, AbortAsked
        """
        while not self._resting(lambda: self._pause is None, 1.0):
            pass

    def hold(self) -> None:
        """Begin a suspension: a resume counts from here on, before anybody has heard of it."""
        with self._changed:
            self._held = True

    def suspended(self, limit_wall: float, look_wall: float, ready: Callable[[], bool]) -> bool:
        """Wait until someone resumes or the cause has gone, at most ``limit_wall`` seconds; False when neither came.

        Parameters
        ----------
        look_wall
            Wall-clock seconds between looks.
        ready
            Whether the scan may go on by itself; not asked while a person wants a pause.

        Raises
        ------
        HaltAsked, AbortAsked
        """
        end = time.monotonic() + limit_wall
        while True:
            if self._resting(lambda: not self._held, min(look_wall, max(end - time.monotonic(), 0.0))):
                return True
            if self._pause is None and ready():
                with self._changed:
                    self._held = False
                return True
            if time.monotonic() >= end:
                return False

    def _resting(self, over: Callable[[], bool], wall: float) -> bool:
        """Wait at most so long until a condition holds; obeys."""
        with self._changed:
            self._beat_wall = time.monotonic()
            self._changed.wait_for(lambda: over() or self._halt is not None or self._abort is not None, wall)
            if self._halt is not None:
                raise HaltAsked(self._halt)
            if self._abort is not None:
                raise AbortAsked(self._abort)
            return over()

    def _notify(self) -> None:
        immediate = self._halt is not None or self._abort is not None or (self._pause is not None and self._pause_now)
        if immediate:
            self._wake.set()
        else:
            self._wake.clear()
        self._changed.notify_all()


def ask(question: Callable[[], T], attempts: int = 3) -> T:
    """Ask a device something that changes nothing; a lost reply is asked for again.

    Raises
    ------
    CommunicationError
        If the last attempt fails too.
    """
    for _ in range(attempts - 1):
        try:
            return question()
        except CommunicationError:
            continue
    return question()


def ensure(command: Callable[[], None], reached: Callable[[], bool], name: str, attempts: int = 3) -> None:
    """Bring a device to an absolute setting (never a motion) and read back that it is there.

    A setting may be sent again after a lost reply: sent twice, it means the same.

    Parameters
    ----------
    name
        The device, for errors.

    Raises
    ------
    CommunicationError
        If the last attempt is not answered.
    DeviceFault
        If the readback never agrees.
    """
    for attempt in range(attempts):
        try:
            command()
        except CommunicationError:
            if attempt == attempts - 1:
                raise
            continue
        if reached():
            return
    raise DeviceFault(name, f"the readback disagrees with the setting after {attempts} attempts", "look at the device")
