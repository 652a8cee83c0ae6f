"""Time on the bench: seconds of the laboratory, which may pass faster than those of the wall clock."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Time(Protocol):
    """What the bench needs of a clock."""

    speed: float

    def now(self) -> float:
        """Laboratory seconds since the bench was switched on."""
        ...

    def wait_until(self, moment: float, cancelled: threading.Event | None = None) -> None:
        """Return at a laboratory time, or as soon as ``cancelled`` is set."""
        ...


class BenchClock:
    """Laboratory seconds that pass ``speed`` times faster than wall-clock seconds.

    Raises
    ------
    ValueError
        If ``speed`` is not positive.
    """

    def __init__(self, speed: float = 1.0) -> None:
        if not speed > 0:
            raise ValueError(f"clock speed must be positive, found {speed}")
        self.speed = float(speed)
        self._origin = time.monotonic()

    def now(self) -> float:
        return (time.monotonic() - self._origin) * self.speed

    def wait_until(self, moment: float, cancelled: threading.Event | None = None) -> None:
        remaining = (moment - self.now()) / self.speed
        if remaining <= 0:
            return
        if cancelled is None:
            time.sleep(remaining)
        else:
            cancelled.wait(remaining)


class ManualClock:
    """A clock that stands still until it is told to go on; waiting moves it to the moment waited for."""

    speed = 1.0

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        return self._now

    def wait_until(self, moment: float, cancelled: threading.Event | None = None) -> None:
        self._now = max(self._now, moment)

    def advance(self, seconds: float) -> None:
        """Let laboratory time pass."""
        self._now += seconds
