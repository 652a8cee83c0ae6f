"""Polygons of the holes: the area of the circle, and corners where a hole meets the edge of the spacer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.angles import FloatArray
from twin.cells import IntArray, around_circle

#: Directions of the lines x = inner, x = -inner, y = inner, y = -inner from the middle.
_TOWARDS = np.array([0.0, np.pi, np.pi / 2, 3 * np.pi / 2])
_TURNS = 4


@dataclass(frozen=True)
class RimLayout:
    """Which corners of the polygons lie on the edge of the spacer, however the holes move a little.

    Attributes
    ----------
    crosses, shape (hole, 4)
        Whether a hole crosses each line.
    order, shape (hole, 8)
        The crossings around the hole, numbers ``2 * line + (0 or 1)``.
    number, shape (hole,)
        How many there are.
    first, shape (hole, 9)
        Corner at each crossing, in their order; then the number of corners.
    """

    crosses: NDArray[np.bool_]
    order: IntArray
    number: IntArray
    first: IntArray


@dataclass(frozen=True)
class Rims:
    """Holes as polygons; arrays of shape (hole, ...), in mm.

    Attributes
    ----------
    centre, radius, chamfer
        Of the circles.
    direction, shape (hole, side, 2)
        From the centre to the corners, the circle's radius being 1.
    fixed
        Arrays (hole, corner, axis, bound) of corners that lie on the edge of the spacer.
    """

    centre: FloatArray
    radius: FloatArray
    chamfer: FloatArray
    direction: FloatArray
    fixed: tuple[IntArray, IntArray, IntArray, FloatArray]
    layout: RimLayout

    def polygons(self, wider: FloatArray | None = None) -> FloatArray:
        """All polygons, of the holes or of wider ones around the same axes, shape (hole, side, 2)."""
        radius = self.radius if wider is None else self.radius + wider
        result = self.centre[:, None] + radius[:, None, None] * self.direction
        if wider is None:
            hole, corner, axis, bound = self.fixed
            result[hole, corner, axis] = bound
        return np.asarray(result)

    def corner_radius(self, radius: FloatArray) -> FloatArray:
        """Radius around the polygons of circles of some radius."""
        return radius * np.linalg.norm(self.direction[:, 0], axis=-1)


def make_rims(
    centre: FloatArray,
    radius: FloatArray,
    chamfer: FloatArray,
    sides: int,
    spacer: tuple[float, float] | None,
    layout: RimLayout | None = None,
) -> Rims | None:
    """Polygons of circles.

    Parameters
    ----------
    spacer
        Half sides of the inside of the spacer, None without one.
    layout
        Of holes a little elsewhere, to keep to.

    Returns
    -------
    Rims
        None if the holes do not have the given layout.
    """
    distance = _distances(centre, spacer)
    around = around_circle(sides)
    crosses = np.abs(distance) < (radius * around)[:, None]
    if layout is not None and not np.array_equal(crosses, layout.crosses):
        return None
    stretch = np.full(len(radius), around)
    for _ in range(_TURNS):  # the crossings depend on the polygon's size, and that, weakly, on the crossings
        with np.errstate(invalid="ignore"):
            half = np.arccos(np.where(crosses, distance / (radius * stretch)[:, None], np.nan))
        angle = np.mod(np.stack([_TOWARDS - half, _TOWARDS + half], axis=-1).reshape(-1, 8), 2 * np.pi)
        if layout is None:
            layout = _lay_out(crosses, angle, sides)
        start, arc, step = _arcs(layout, angle, sides)
        stretch = np.sqrt(2 * np.pi / np.sum(step * np.sin(arc / np.maximum(step, 1)), axis=1))
    assert layout is not None
    corner = np.arange(sides)
    which = np.sum(corner[None, :, None] >= layout.first[:, None, 1:-1], axis=2)
    which = np.minimum(which, np.maximum(layout.number, 1)[:, None] - 1)
    take = np.take_along_axis
    part = (corner - take(layout.first[:, :-1], which, 1)) / take(step, which, 1)
    theta = take(start, which, 1) + take(arc, which, 1) * part
    direction = stretch[:, None, None] * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    return Rims(centre, radius, chamfer, direction, _fixed(layout, spacer), layout)


def _distances(centre: FloatArray, spacer: tuple[float, float] | None) -> FloatArray:
    """Distance of the lines of the spacer's edge from the centres, shape (hole, 4)."""
    if spacer is None:
        return np.full((len(centre), 4), np.inf)
    x, y = centre.T
    return np.stack([spacer[0] - x, spacer[0] + x, spacer[1] - y, spacer[1] + y], axis=1)


def _lay_out(crosses: NDArray[np.bool_], angle: FloatArray, sides: int) -> RimLayout:
    """Choose the corners: as many between crossings as their angles ask for."""
    number = 2 * crosses.sum(axis=1)
    order = np.argsort(np.where(np.isnan(angle), np.inf, angle), axis=1)
    sorted_angle = np.take_along_axis(angle, order, axis=1)
    rank = np.arange(8)
    real = rank < number[:, None]
    turned = np.where(real, sorted_angle - sorted_angle[:, :1], 0.0)
    first = np.where(real, np.rint(turned * sides / (2 * np.pi)).astype(np.int64), sides)
    first[:, 0] = 0
    # With one side between two crossings the polygon would lie along the edge, and touch it instead of crossing it.
    least = 2 if sides >= 16 else 1
    for k in range(1, 8):
        first[:, k] = np.where(real[:, k], np.maximum(first[:, k], first[:, k - 1] + least), sides)
    for k in range(7, 0, -1):
        room = sides - least * (number - k)
        first[:, k] = np.where(real[:, k], np.minimum(first[:, k], room), sides)
    return RimLayout(crosses, order, number, np.column_stack([first, np.full(len(first), sides)]))


def _arcs(layout: RimLayout, angle: FloatArray, sides: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Where the arcs between crossings start, how long they are, their numbers of sides; shape (hole, 8)."""
    rank = np.arange(8)
    real = rank < layout.number[:, None]
    start = np.take_along_axis(angle, layout.order, axis=1)
    whole = layout.number == 0
    start[whole, 0] = np.pi / sides
    following = np.where(rank + 1 < layout.number[:, None], rank + 1, 0)
    arc = np.mod(np.take_along_axis(start, following, axis=1) - start, 2 * np.pi)
    real[whole, 0], arc[whole, 0] = True, 2 * np.pi
    step = np.where(real, np.diff(layout.first, axis=1), 0)
    return np.where(real, start, 0.0), np.where(real, arc, 0.0), step


def _fixed(layout: RimLayout, spacer: tuple[float, float] | None) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    hole, rank = np.nonzero(np.arange(8) < layout.number[:, None])
    line = layout.order[hole, rank] // 2
    axis = line // 2
    sign = np.where(line % 2 == 0, 1.0, -1.0)
    bound = sign * (np.array(spacer)[axis] if spacer is not None else 0.0)
    return hole, layout.first[hole, rank], axis, bound
