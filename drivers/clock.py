"""Laboratory time: real time on hardware, N times faster on the simulated laboratory."""

from __future__ import annotations

import threading
import time
from datetime import UTC, datetime, timedelta


class Clock:
    """Laboratory time, in seconds, running ``speed`` times faster than the wall clock.

    Every duration that belongs to the laboratory (a settling time, the deadline of a move, an averaging
    time) is given to this clock; time-outs of a wire stay in wall-clock seconds.

    Parameters
    ----------
    speed
        Laboratory seconds that pass in one second of the wall clock; 1 on hardware.
    start
        Laboratory time (UTC) at construction; now, where it is not given.

    Raises
    ------
    ValueError
        If ``speed`` is not positive.
    """

    def __init__(self, speed: float = 1.0, start: datetime | None = None) -> None:
        if not speed > 0:
            raise ValueError(f"clock speed must be positive, found {speed}")
        self.speed = float(speed)
        self._start = start or datetime.now(UTC)
        self._origin = time.monotonic()

    def monotonic(self) -> float:
        """Laboratory seconds since construction."""
        return (time.monotonic() - self._origin) * self.speed

    def now(self) -> datetime:
        """Laboratory time, UTC."""
        return self._start + timedelta(seconds=self.monotonic())

    def sleep(self, seconds: float) -> None:
        """Wait for a number of laboratory seconds."""
        if seconds > 0:
            time.sleep(seconds / self.speed)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        """Wait until ``event`` is set, at most ``seconds`` of laboratory time; True when it was set."""
        return event.wait(max(seconds, 0.0) / self.speed)
