"""The light: source with its watchdog and interlock, tunable filter, shutter."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from sim_fixtures.bench.clock import Time

INTERLOCK_OPEN, INTERLOCK_WAITING, INTERLOCK_CLOSED = 0, 1, 2


@dataclass
class Source:
    """A supercontinuum laser.

    The watchdog runs in wall-clock seconds, as every time-out of a wire does: it guards the connection, and a
    program that feeds it must not have to be faster because the bench is. ``now`` is laboratory time, and
    ``switched_on`` the time at which the emission began.
    """

    wall: Callable[[], float] = time.monotonic
    now: Callable[[], float] = time.monotonic
    switched_on: float = 0.0
    power: float = 0.0
    interlock: int = INTERLOCK_WAITING
    interlock_cause: int = 0
    watchdog: float = 0.0
    watchdog_trips: int = 0
    _emission: bool = False
    _last_contact: float = field(default=0.0)

    def emitting(self) -> bool:
        """True while light leaves the source; an expired watchdog has switched it off."""
        if self._emission and self.watchdog > 0 and self.wall() - self._last_contact > self.watchdog:
            self._emission = False
            self.watchdog_trips += 1
        return self._emission

    def contact(self) -> None:
        """A telegram arrived: the watchdog starts anew, unless it has already bitten."""
        self.emitting()
        self._last_contact = self.wall()

    def switch(self, on: bool) -> bool:
        """Switch the emission; False when the interlock forbids it."""
        if on and self.interlock != INTERLOCK_CLOSED:
            return False
        if on and not self._emission:
            self.switched_on = self.now()
        self._emission = on
        return True

    def open_interlock(self, cause: int = 2) -> None:
        """A door opens (``cause`` 2): the light goes off."""
        self.interlock, self.interlock_cause = INTERLOCK_OPEN, cause
        self._emission = False

    def close_interlock(self) -> None:
        """The loop is closed again; the source waits for a reset."""
        self.interlock, self.interlock_cause = INTERLOCK_WAITING, 0

    def reset_interlock(self) -> None:
        """What the reset telegram does: nothing while the loop is open."""
        if self.interlock == INTERLOCK_WAITING:
            self.interlock = INTERLOCK_CLOSED


@dataclass
class Selector:
    """An acousto-optic filter with eight channels, whose light joins in one beam; channel 0 is the usual one.

    Wavelengths in nm, amplitudes as fractions.
    """

    wavelengths: list[float] = field(default_factory=lambda: [500.0] * 8)
    amplitudes: list[float] = field(default_factory=lambda: [0.0] * 8)
    rf_on: bool = False

    def transmission(self, channel: int = 0) -> float:
        """Fraction of the light at a channel's wavelength that passes."""
        return self.amplitudes[channel] if self.rf_on else 0.0


class Shutter:
    """A blade that takes ``travel`` seconds; closed without power."""

    def __init__(self, clock: Time, travel: float = 0.05) -> None:
        self._clock, self._travel = clock, travel
        self.commanded = False
        self.stuck = False
        self._changed = -1e9
        self._was_open = False

    def command(self, is_open: bool) -> None:
        """Energise (open) or release (closed)."""
        if is_open != self.commanded:
            self._was_open = self.is_open()
            self.commanded, self._changed = is_open, self._clock.now()

    def is_open(self) -> bool:
        """Position of the blade."""
        if self.stuck:
            return False
        return self.commanded if self._clock.now() - self._changed >= self._travel else self._was_open
