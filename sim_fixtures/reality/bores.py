"""Bores of any profile of revolution, with circular or elliptical section: stacks of conical frusta.

A profile lists levels from the top of the plate to its bottom and, for each, what the radius there is more than the
hole's own. Between two levels the air is convex, so a straight line that lies inside the bore at both ends of a frustum
meets no wall in between: looking out of a hole needs no intersection, only a test at every level.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from instrument.angles import FloatArray

if TYPE_CHECKING:
    from sim_fixtures.reality.scene import Scene

_FAR = 1e30
_SLACK = 1e-9  # mm: decides to which frustum a point on a level belongs


def rounded_rim(thickness: float, radius: float, taper: float = 0.0, facets: int = 5) -> FloatArray:
    """Profile of a hole whose upper edge is rounded, and which widens towards the bottom.

    Parameters
    ----------
    thickness, radius
        Of the plate, and of the rounding (mm; less than the thickness).
    taper
        Change of the radius from top to bottom, mm.
    facets
        Frusta that stand for the rounding; their corners lie on it.

    Returns
    -------
    FloatArray
        Shape (level, 2): height (mm, from 0 down to minus the thickness) and addition to the radius (mm).
    """
    rows = [(0.0, radius)] if radius > 0.0 else [(0.0, 0.0)]
    if radius > 0.0:
        for turn in np.linspace(0.0, np.pi / 2, facets + 1)[1:]:
            rows.append((-radius * (1.0 - np.cos(turn)), radius * (1.0 - np.sin(turn))))
    if rows[-1][0] > -thickness:
        rows.append((-thickness, 0.0))
    profile = np.array(rows)
    profile[:, 1] += taper * -profile[:, 0] / thickness
    return profile


def ellipse(elongation: float, axis_deg: float) -> FloatArray:
    """Map of a section onto a circle of the same area, shape (2, 2).

    ``elongation`` is the ratio of the axes less one, ``axis_deg`` where the long one points (artifact frame).
    """
    c, s = np.cos(np.deg2rad(axis_deg)), np.sin(np.deg2rad(axis_deg))
    root = np.sqrt(1.0 + elongation)
    turn = np.array([[c, s], [-s, c]])
    return np.ascontiguousarray(turn.T @ np.diag([1.0 / root, root]) @ turn)


@njit(cache=True, nogil=True)
def inside_level(scene: Scene, hole: int, level: int, x: float, y: float) -> bool:
    """Whether a point lies within a hole at a level of its profile."""
    dx, dy = x - scene.x[hole], y - scene.y[hole]
    p = scene.section[0, 0] * dx + scene.section[0, 1] * dy
    q = scene.section[1, 0] * dx + scene.section[1, 1] * dy
    return p * p + q * q < (scene.radius[hole] + scene.profile[level, 1]) ** 2


@njit(cache=True, nogil=True)
def leaves_bore(scene: Scene, hole: int, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> bool:
    """Whether an upward ray from inside the bore, or from below it, reaches the top."""
    for level in range(scene.profile.shape[0] - 1, -1, -1):
        height = scene.profile[level, 0]
        if height > z + _SLACK:
            t = (height - z) / dz
            if not inside_level(scene, hole, level, x + t * dx, y + t * dy):
                return False
    return True


@njit(cache=True, nogil=True)
def through_bore(
    scene: Scene, hole: int, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[bool, float, float, float, float, float, float]:
    """Follow a ray inside a bore.

    Returns
    -------
    whether it meets the wall, and then the point and the normal; otherwise the point where it leaves the bore at the
    top or the bottom.
    """
    count = scene.profile.shape[0]
    k = 0
    aim = z + (_SLACK if dz > 0.0 else -_SLACK)
    while k < count - 2 and aim < scene.profile[k + 1, 0]:
        k += 1
    m = scene.section
    while True:
        high, low = scene.profile[k, 0], scene.profile[k + 1, 0]
        slope = (scene.profile[k, 1] - scene.profile[k + 1, 1]) / (high - low)
        rho = scene.radius[hole] + scene.profile[k + 1, 1] + slope * (z - low)
        rx, ry = x - scene.x[hole], y - scene.y[hole]
        px, py = m[0, 0] * rx + m[0, 1] * ry, m[1, 0] * rx + m[1, 1] * ry
        ex, ey, er = m[0, 0] * dx + m[0, 1] * dy, m[1, 0] * dx + m[1, 1] * dy, slope * dz
        t_wall = _leaving(ex * ex + ey * ey - er * er, px * ex + py * ey - rho * er, px * px + py * py - rho * rho)
        t_end = _FAR
        if dz > 0.0:
            t_end = (high - z) / dz
        elif dz < 0.0:
            t_end = (low - z) / dz
        if t_wall < t_end:
            x, y, z = x + t_wall * dx, y + t_wall * dy, z + t_wall * dz
            px, py = px + t_wall * ex, py + t_wall * ey
            size = np.sqrt(px * px + py * py)
            nx = -(m[0, 0] * px + m[1, 0] * py) / size
            ny = -(m[0, 1] * px + m[1, 1] * py) / size
            norm = np.sqrt(nx * nx + ny * ny + slope * slope)
            return True, x, y, z, nx / norm, ny / norm, slope / norm
        x, y = x + t_end * dx, y + t_end * dy
        z = high if dz > 0.0 else low
        k += -1 if dz > 0.0 else 1
        if k < 0 or k > count - 2:
            return False, x, y, z, 0.0, 0.0, 0.0


@njit(cache=True, nogil=True)
def _leaving(a: float, b: float, c: float) -> float:
    """Where a t^2 + 2 b t + c, negative inside, turns positive; far away if it never does."""
    square = b * b - a * c
    if square < 0.0:
        return _FAR
    root = np.sqrt(square)
    if b > 0.0:
        return -c / (b + root)
    return (root - b) / a if a > 0.0 else _FAR
