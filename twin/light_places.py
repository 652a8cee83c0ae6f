"""Places where light was met inside the cavity, and how a kernel finds them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.kernel_math import larger
from twin.plate import NEIGHBOURS, Plate

#: Numbers of a kept place: position, direction to where the light came from, flux.
NUMBERS = 7
#: Bins of places near the end of a sight line: own opening and those around it, two ways of facing each.
BINS = 2 * (NEIGHBOURS + 1)
#: How often places are joined, over the walls of one hole to each other: level faces to each other, and to walls.
LEVEL_RATE, SIDE_RATE = 0.9, 0.3
#: Depths of the cavity within which that fades.
_FADE_LEVEL, _FADE_SIDE = 1.5, 1.25


@dataclass(frozen=True)
class Places:
    """Where the light of one illumination was met.

    Attributes
    ----------
    numbers, shape (place, 7)
        Position, direction to where the light came from, flux.
    which, shape (place, 2)
        Face and nearest opening.
    starts
        First place of every bin (randomisation, opening, way of facing), and their number.
    paths
        Of each randomisation.
    """

    numbers: NDArray[np.float32]
    which: NDArray[np.uint32]
    starts: NDArray[np.int64]
    paths: int


class Pool:
    """Places where light of some illuminations was met, in a kernel's arrays."""

    def __init__(
        self,
        mi: Any,
        dr: Any,
        places: Sequence[Places],
        openings: int,
        blocks: range,
        block: int,
        randomisations: int,
        favours: Favours,
    ) -> None:
        self._mi, self._dr = mi, dr
        pad = np.zeros(2 * NUMBERS)
        self._places = mi.Float(np.concatenate([*(p.numbers.ravel() for p in places), pad]))
        self._which = mi.UInt32(np.concatenate([*(p.which.ravel() for p in places), np.zeros(4, dtype=np.uint32)]))
        first = np.cumsum([0, *(len(p.which) for p in places)])
        starts = [p.starts[:-1] + offset for p, offset in zip(places, first, strict=False)]
        self._starts = mi.UInt32(np.concatenate([*starts, first[-1:]]).astype(np.uint32))
        self._blocks, self._first, self._block, self._randomisations = (
            dr.opaque(mi.UInt32, number) for number in (len(blocks), blocks.start, block, randomisations)
        )
        favoured = [favours.running_sums(p.starts, openings).ravel() for p in places]
        self._favoured = mi.Float(np.concatenate([*favoured, np.zeros(2)]))
        self.openings, self.paths = dr.opaque(mi.UInt32, openings), dr.opaque(mi.Float, places[0].paths)

    def cell(self, group: Any, index: Any, randomisation: Any) -> Any:
        """Which part of the pool a sight line is joined to."""
        return (group * self._blocks + (index // self._block - self._first)) * self._randomisations + randomisation

    def start(self, index: Any, active: Any) -> Any:
        """Where the places of a bin start."""
        return self._dr.gather(self._mi.UInt32, self._starts, index, active)

    def favoured(self, row: Any, x: Any, active: Any) -> tuple[Any, Any]:
        """Which favoured bin a uniform number falls to, and the sum over all of them."""
        mi, dr = self._mi, self._dr
        base = row * BINS
        whole = dr.gather(mi.Float, self._favoured, base + (BINS - 1), active)
        wanted, low, size = x * whole, mi.UInt32(0), BINS
        while size > 1:  # the first bin whose running sum is above
            half = size // 2
            past = dr.gather(mi.Float, self._favoured, base + low + (half - 1), active) <= wanted
            low, size = dr.select(past, low + half, low), size - half
        return low, whole

    def place(self, index: Any, active: Any) -> tuple[Any, Any, Any, Any, Any]:
        """Position, direction to where the light came from, flux, face, nearest opening."""
        mi, dr = self._mi, self._dr
        x, y, z, a, b, c, flux = (
            dr.gather(mi.Float, self._places, index * NUMBERS + k, active) for k in range(NUMBERS)
        )
        face, opening = (dr.gather(mi.UInt32, self._which, index * 2 + k, active) for k in range(2))
        return mi.Point3f(x, y, z), mi.Vector3f(a, b, c), flux, face, opening


class Favours:
    """How often places near the end of a sight line are joined, by which way either faces.

    An end faces up, sideways or down, and so does a place. A row of bins belongs to the openings near an end (its own
    and those around it) and to the two ways of facing that see much of the end: down and sideways from a level face,
    up and sideways from a wall. A wall sees the walls of its own hole alone.
    """

    def __init__(self, plate: Plate, around: NDArray[np.uint32], number: NDArray[np.uint32]) -> None:
        openings = len(plate.radius)
        self.fade_level, self.fade_side = 1 / (_FADE_LEVEL * plate.depth) ** 2, 1 / (_FADE_SIDE * plate.depth) ** 2
        self._near = np.concatenate([np.arange(openings, dtype=np.uint32)[:, None], around], axis=1)
        gap = plate.centre[self._near] - plate.centre[:, None]
        squared = np.where(np.arange(NEIGHBOURS + 1) <= number[:, None], np.sum(gap**2, axis=-1), np.inf)
        level = LEVEL_RATE / (1 + squared * self.fade_level) ** 2
        side = SIDE_RATE / (1 + squared * self.fade_side) ** 2
        own = np.zeros_like(side)
        own[:, 0] = 1.0
        # By what the end faces: up, sideways, down.
        self._rate = np.stack([np.stack(pair, axis=-1) for pair in ((side, level), (side, own), (level, side))], axis=1)

    def bins(self) -> NDArray[np.uint32]:
        """Opening of each bin, shape (opening, BINS)."""
        return np.repeat(self._near, 2, axis=1)

    def running_sums(self, starts: NDArray[np.int64], openings: int) -> NDArray[np.float32]:
        """Sums over the bins of the number of places times their rate, shape (randomisation, opening, 3, BINS)."""
        count = np.diff(starts).reshape(-1, openings, 3)[:, self._near].astype(np.float32)
        some = [count[..., first : first + 2] * self._rate[:, end] for end, first in enumerate((1, 0, 0))]
        amount = np.stack(some, axis=2)
        return np.cumsum(amount.reshape(*amount.shape[:3], BINS), axis=-1, dtype=np.float32)


class NearestOpening:
    """Which opening is about the nearest, in a kernel."""

    def __init__(self, mi: Any, dr: Any, plate: Plate, nearest: tuple[NDArray[np.uint32], tuple[int, int]]) -> None:
        index, size = nearest
        self._mi, self._dr = mi, dr
        self._index = mi.UInt32(index.ravel())
        self._scale = [dr.opaque(mi.Float, n / (2 * half)) for n, half in zip(size, plate.half, strict=True)]
        self._half = [dr.opaque(mi.Float, half) for half in plate.half]
        self._last = [dr.opaque(mi.UInt32, n - 1) for n in size]

    def at(self, place: Any, active: Any) -> Any:
        mi, dr = self._mi, self._dr
        x, y = (
            dr.minimum(mi.UInt32(larger(dr, (value + half) * scale, 0.0)), last)
            for value, half, scale, last in zip((place.x, place.y), self._half, self._scale, self._last, strict=True)
        )
        return dr.gather(mi.UInt32, self._index, x * (self._last[1] + 1) + y, active)
