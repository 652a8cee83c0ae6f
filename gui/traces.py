"""Readings over time, kept so that a plot of many costs no more than one of few. Without Qt."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

_KEPT = 20_000  # readings
_COLUMNS = 300  # intervals that are drawn at most

Array = NDArray[np.float64]


class Trace:
    """Rows of numbers, the first of which ascends (a time).

    Parameters
    ----------
    width
        Numbers in a row.
    room
        Rows for which there is room from the beginning.
    """

    def __init__(self, width: int, room: int = 256) -> None:
        self._data: Array = np.zeros((min(max(room, 256), _KEPT), width))
        self._count = 0

    @property
    def rows(self) -> Array:
        """Every row that is kept, shape (rows, width)."""
        return self._data[: self._count]

    def clear(self) -> None:
        """Forget everything."""
        self._count = 0

    def extend(self, rows: Iterable[tuple[float, ...]]) -> None:
        """Append rows; the oldest ones are forgotten where there are too many."""
        new = np.array(list(rows), dtype=float).reshape(-1, self._data.shape[1])[-_KEPT:]
        if self._count + len(new) > _KEPT:
            keep = self.rows[max(self._count - (_KEPT - len(new)) // 2, 0) :].copy()
            self._data[: len(keep)], self._count = keep, len(keep)
        if self._count + len(new) > len(self._data):
            grown = np.empty((min(2 * (self._count + len(new)), _KEPT), self._data.shape[1]))
            grown[: self._count] = self.rows
            self._data = grown
        self._data[self._count : self._count + len(new)] = new
        self._count += len(new)

    def outline(self, column: int) -> tuple[Array, Array]:
        """Abscissae and values of a curve that looks as all rows would.

        Where rows are many, each of at most 300 intervals of rows gives its least and its greatest value.
        """
        rows = self.rows
        if len(rows) <= 2 * _COLUMNS:
            return rows[:, 0], rows[:, column]
        starts = np.linspace(0, len(rows), _COLUMNS, endpoint=False).astype(int)
        ends = np.append(starts[1:], len(rows)) - 1
        x = np.stack([rows[starts, 0], rows[ends, 0]], axis=1).ravel()
        low, high = np.minimum.reduceat(rows[:, column], starts), np.maximum.reduceat(rows[:, column], starts)
        return x, np.stack([low, high], axis=1).ravel()

    def nearest(self, at: float) -> Array | None:
        """The row whose first number is nearest to a value; None where there is none."""
        if not self._count:
            return None
        found: Array = self.rows[int(np.argmin(np.abs(self.rows[:, 0] - at)))]
        return found


def roomy(
    low: float, high: float, shown: tuple[float, float] | None, least: float, ahead: float = 0.0
) -> tuple[float, float]:
    """A range to show, which stays as it is while the values fit and fill a third of it.

    Parameters
    ----------
    shown
        What is shown now; None where nothing is.
    least
        Extent that is shown around values that do not differ.
    ahead
        Share of the extent that is left free above, beside the margin of a tenth on both sides.
    """
    missing = max(least - (high - low), 0.0)
    low, high = low - missing / 2, high + missing / 2
    extent = high - low
    if shown is not None and shown[0] <= low and high <= shown[1] and 3 * extent >= shown[1] - shown[0]:
        return shown
    return low - 0.1 * extent, high + (0.1 + ahead) * extent
