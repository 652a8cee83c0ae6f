"""What of a scan is done, what is not, and how long the rest will take."""

from __future__ import annotations

import time
from collections.abc import Iterable

#: Points after which the pace that was seen replaces the estimate.
_TRUSTED = 5


class Progress:
    """Points measured and skipped, and their pace.

    Parameters
    ----------
    total
        Points of the plan.
    measured
        Indices measured before this program took over.
    """

    def __init__(self, total: int, measured: Iterable[int] = ()) -> None:
        self.total = total
        self.measured: set[int] = set(measured)
        self.skipped: set[int] = set()
        self._expected = 0.0
        self._spent = 0.0
        self._timed = 0
        self._began: float | None = None

    def missing(self) -> list[int]:
        """Points neither measured nor skipped, in order."""
        return [i for i in range(self.total) if i not in self.measured and i not in self.skipped]

    @property
    def left(self) -> int:
        """How many points are missing; costs the same however many there are."""
        return self.total - len(self.measured) - len(self.skipped)

    def summary(self) -> str:
        """What is lacking, in words; empty when nothing is."""
        lacking = self.total - len(self.measured)
        return f"{lacking} of {self.total} points could not be measured" if lacking else ""

    def expect(self, wall_seconds: float) -> None:
        """Take in the estimate: wall-clock seconds for what is missing now."""
        self._expected = wall_seconds / max(self.left, 1)

    def begin(self) -> None:
        """A point begins."""
        self._began = time.monotonic()

    def done(self, index: int) -> None:
        """The point that began last is measured."""
        self.measured.add(index)
        if self._began is not None:
            self._spent += time.monotonic() - self._began
            self._timed += 1
            self._began = None

    def time_left(self) -> float:
        """Wall-clock seconds for what is missing: the estimate at first, then the mean pace that was seen."""
        seen = min(self._timed, _TRUSTED)
        mean = self._spent / self._timed if self._timed else 0.0
        return self.left * (mean * seen + self._expected * (_TRUSTED - seen)) / _TRUSTED
