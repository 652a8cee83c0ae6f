"""Where the axes were last seen, for whoever watches; at a low rate, and never at the cost of the scan."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from drivers.errors import DeviceError
from drivers.interfaces import Axis

#: Seconds of the wall clock between two tellings: a picture goes between them, and the wires stay free.
EVERY_WALL = 0.5


class Sightings:
    """Tells positions to a listener, not more often than so.

    Parameters
    ----------
    tell
        Receives every axis's last known position, degree; None: nobody listens, and nothing is asked of any drive.
    every_wall
        Seconds of the wall clock between two tellings.
    """

    def __init__(self, tell: Callable[[dict[str, float]], None] | None = None, every_wall: float = EVERY_WALL) -> None:
        self._tell, self._every = tell, every_wall
        self._positions: dict[str, float] = {}
        self._said: dict[str, float] = {}
        self._next = 0.0

    def told(self, positions: Mapping[str, float]) -> None:
        """Positions that were read for a purpose of their own."""
        self._positions.update(positions)
        if self._tell is not None and time.monotonic() >= self._next:
            self.arrived()

    def look(self, axis: Axis) -> None:
        """Ask an axis on its way where it is, when it is time for that; no answer is no trouble."""
        if self._tell is None or time.monotonic() < self._next:
            return
        try:
            position = axis.position()
        except DeviceError:  # who waits for the axis asks too, and knows what to do
            self._next = time.monotonic() + self._every
            return
        self.told({axis.name: position})

    def arrived(self) -> None:
        """Tell what is known now, unless it was told already."""
        if self._tell is not None and self._positions != self._said:
            self._next = time.monotonic() + self._every
            self._said = dict(self._positions)
            self._tell(dict(self._said))
