"""Plane geometry behind the artifact's mesh: power cells of the holes, rings, clipped convex polygons.

Every hole gets the convex cell of the plate that belongs to it (its power cell, Aurenhammer 1987: disjoint circles
lie inside their own cells, cells tile the outline). Triangles then stay within a cell: they are short, and ray
tracing is 1.4 to 1.8 times faster than through the long thin triangles of a Boolean operation.

Polygons are arrays of shape (corner, 2), counter-clockwise, in mm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from instrument.angles import FloatArray

IntArray = NDArray[np.int64]


def rectangle(half_x: float, half_y: float) -> FloatArray:
    """The rectangle of the given half sides about the origin."""
    return np.array([[-half_x, -half_y], [half_x, -half_y], [half_x, half_y], [-half_x, half_y]])


def circle(x: float, y: float, diameter: float, sides: int) -> FloatArray:
    """Regular polygon of the same area as a circle.

    An inscribed polygon of 64 sides would lack 0.16 % of the area, and that bias would show in the BRF.
    """
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    radius = diameter / 2 * around_circle(sides)
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1)


def around_circle(sides: int) -> float:
    """Radius around the polygon of :func:`circle` over that of the circle."""
    return float(np.sqrt(2 * np.pi / (sides * np.sin(2 * np.pi / sides))))


def power_cells(centres: FloatArray, radii: FloatArray, half_x: float, half_y: float) -> list[FloatArray]:
    """Tile a rectangle with one convex cell a circle.

    Parameters
    ----------
    centres, shape (n, 2), radii, shape (n,)
        Disjoint circles inside the rectangle of half sides ``half_x`` and ``half_y``.

    Returns
    -------
    list of n polygons
        Neighbours share their corners exactly.

    Notes
    -----
    The cells are dual to the lower hull of (x, y, x^2 + y^2 - r^2). Mirror images of the circles in the four
    sides make the cells end at the rectangle.
    """
    mirrored = [centres]
    for axis, half in ((0, half_x), (0, -half_x), (1, half_y), (1, -half_y)):
        image = centres.copy()
        image[:, axis] = 2 * half - image[:, axis]
        mirrored.append(image)
    points = np.concatenate(mirrored)
    lift = np.sum(points**2, axis=1) - np.tile(radii, 5) ** 2
    hull = ConvexHull(np.column_stack([points, lift]), qhull_options="Qt")
    lower = hull.equations[:, 2] < -1e-12
    plane = hull.equations[lower]
    corners = -plane[:, :2] / (2 * plane[:, 2:3])
    corners = np.clip(_merge_close(corners), [-half_x, -half_y], [half_x, half_y])
    facets = hull.simplices[lower]
    cells = []
    for index, centre in enumerate(centres):
        own = corners[np.any(facets == index, axis=1)]
        cells.append(_around(np.unique(own, axis=0), centre))
    return cells


def _merge_close(points: FloatArray, tolerance: float = 1e-7) -> FloatArray:
    """Give points closer than the tolerance the same coordinates (four cells that meet in one corner)."""
    labels = cluster(points, tolerance)
    first = np.unique(labels, return_index=True)[1]
    return points[first][labels]


def cluster(points: FloatArray, tolerance: float) -> IntArray:
    """Number the groups of points, shape (n, d), that lie within a tolerance of each other."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    labels: IntArray = connected_components(graph, directed=False)[1].astype(np.int64)
    return labels


def _around(points: FloatArray, centre: FloatArray) -> FloatArray:
    """Sort points counter-clockwise around a centre."""
    offset = points - centre
    return points[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]


def ring(outer: FloatArray, inner: FloatArray) -> IntArray:
    """Triangulate the region between two convex polygons, one inside the other (they may touch).

    Returns
    -------
    array, shape (triangle, 3)
        Indices into the corners of ``outer`` followed by those of ``inner``; counter-clockwise.

    Notes
    -----
    The triangle over an outer edge has its tip where the inner polygon is extreme along the edge's normal; the
    fan of an outer corner takes the inner edges between two such tips. Both lie between the polygons because
    every outer edge supports the inner polygon from outside.
    """
    count, sides = len(outer), len(inner)
    following = np.roll(outer, -1, axis=0)
    edge = following - outer
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    tip = np.argmax(normal @ inner.T, axis=1)
    corner = np.arange(count)
    over_edges = np.stack([corner, (corner + 1) % count, count + tip], axis=1)
    start = np.roll(tip, 1)
    steps = (tip - start) % sides
    if steps.sum() == 0 and count > 0:  # all tips coincide only for an inner polygon that is a point
        raise ValueError("the inner polygon has no extent")
    owner = np.repeat(corner, steps)
    offset = np.arange(len(owner)) - np.repeat(np.cumsum(steps) - steps, steps)
    first = (start[owner] + offset) % sides
    fans = np.stack([owner, count + (first + 1) % sides, count + first], axis=1)
    return np.concatenate([over_edges, fans])


def clip(polygon: FloatArray, axis: int, bound: float, sign: int) -> FloatArray:
    """The part of a convex polygon with sign * coordinate <= sign * bound; shape (0, 2) if nothing is left."""
    if len(polygon) == 0:
        return polygon
    level = sign * (polygon[:, axis] - bound)
    kept: list[FloatArray] = []
    for here, there, a, b in zip(polygon, np.roll(polygon, -1, axis=0), level, np.roll(level, -1), strict=True):
        if a <= 0:
            kept.append(here)
        if (a < 0 < b) or (b < 0 < a):
            kept.append(crossing(here, there, axis, bound))
    result = np.array(kept).reshape(-1, 2)
    return result if len(result) >= 3 else np.zeros((0, 2))


def crossing(a: FloatArray, b: FloatArray, axis: int, bound: float) -> FloatArray:
    """Where a segment meets an axis-parallel line; the same to the last bit from either end."""
    if tuple(a) > tuple(b):
        a, b = b, a
    point = a + (b - a) * ((bound - a[axis]) / (b[axis] - a[axis]))
    point[axis] = bound
    return point


def fan(polygon: FloatArray) -> IntArray:
    """Triangulate a convex polygon that may have corners on straight edges: fan from its middle corner indices."""
    count = len(polygon)
    area = [_fan_smallest(polygon, start) for start in range(count)]
    start = int(np.argmax(area))
    first = (start + np.arange(1, count - 1)) % count
    return np.stack([np.full(count - 2, start), first, (first + 1) % count], axis=1)


def _fan_smallest(polygon: FloatArray, start: int) -> float:
    """Area of the smallest triangle of the fan from a corner."""
    spokes = np.roll(polygon, -start, axis=0)[1:] - polygon[start]
    return float(np.min(spokes[:-1, 0] * spokes[1:, 1] - spokes[:-1, 1] * spokes[1:, 0]))


def strip(upper: FloatArray, lower: FloatArray) -> IntArray:
    """Triangulate the band between two rows of points along parallel lines.

    Parameters
    ----------
    upper, lower, shape (n,), (m,)
        Ascending positions along the lines; first and last agree.

    Returns
    -------
    array, shape (n + m - 2, 3)
        Indices into upper followed by lower; seen with the positions growing to the right and upper above, clockwise.
    """
    n, m = len(upper), len(lower)
    i = j = 0
    faces = []
    while i < n - 1 or j < m - 1:
        advance_upper = j == m - 1 or (i < n - 1 and upper[i + 1] + upper[i] <= lower[j + 1] + lower[j])
        if advance_upper:
            faces.append((i, i + 1, n + j))
            i += 1
        else:
            faces.append((i, n + j + 1, n + j))
            j += 1
    return np.array(faces, dtype=np.int64)
