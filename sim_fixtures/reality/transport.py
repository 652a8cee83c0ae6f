"""Light that travels inside the coating before it leaves: diffusion over the surface, around edges too.

The share that diffuses leaves elsewhere, by the Green's function of two-dimensional diffusion with absorption, K0(r/L)
over the diffusion length L. Such a step is a Brownian path of exponentially distributed duration: a
normal displacement whose variance is 2 L^2 times an exponential draw.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from sim_fixtures.reality.scene import BORE, CAVITY, FLOOR, OUTSIDE, TOP, UNDERSIDE, WALL, Scene, find_hole


@njit(cache=True, nogil=True)
def diffusion_step(length: float, s: float, t: float, v: float) -> tuple[float, float]:
    """A displacement along the surface, mm, of three uniform draws; its mean square is 4 ``length`` squared."""
    spread = length * np.sqrt(-2.0 * np.log(1.0 - v))
    radius = spread * np.sqrt(-2.0 * np.log(1.0 - s))
    return radius * np.cos(2.0 * np.pi * t), radius * np.sin(2.0 * np.pi * t)


@njit(cache=True, nogil=True)
def diffused(
    scene: Scene, surface: int, place: int, hole: int, x: float, y: float, z: float, u: float, v: float
) -> tuple[int, int, int, float, float, float]:
    """Where light leaves that entered at a point of a surface and moved by (u, v) along it.

    Beyond an edge of a hole it goes on along the next face. Spacer and ledge are far from the light: it stays.
    """
    if surface == WALL:
        return _along_wall(scene, hole, x, y, z, u, v)
    if surface == FLOOR:
        x = min(max(x + u, -scene.inner_x), scene.inner_x)
        y = min(max(y + v, -scene.inner_y), scene.inner_y)
        return FLOOR, CAVITY, -1, x, y, -scene.depth + scene.slope[0] * x + scene.slope[1] * y
    if surface != TOP and surface != UNDERSIDE:
        return surface, place, hole, x, y, z
    x, y = x + u, y + v
    hole = find_hole(scene, x, y, 0 if surface == TOP else -1)
    if hole < 0:
        return surface, place, -1, x, y, z
    rx, ry = x - scene.x[hole], y - scene.y[hole]
    distance = max(np.sqrt(rx * rx + ry * ry), 1e-9)
    past = min(max(scene.radius[hole] - distance, 1e-6), scene.thickness - 1e-6)
    stretch = scene.radius[hole] / distance
    height = -past if surface == TOP else -scene.thickness + past
    return WALL, BORE, hole, scene.x[hole] + rx * stretch, scene.y[hole] + ry * stretch, height


@njit(cache=True, nogil=True)
def _along_wall(
    scene: Scene, hole: int, x: float, y: float, z: float, u: float, v: float
) -> tuple[int, int, int, float, float, float]:
    turn = np.arctan2(y - scene.y[hole], x - scene.x[hole]) + u / scene.radius[hole]
    z += v
    surface, place, beyond = WALL, BORE, 0.0
    if z >= 0.0:
        surface, place, beyond, z = TOP, OUTSIDE, z + 1e-6, 0.0
    elif z <= -scene.thickness:
        surface, place, beyond, z = UNDERSIDE, CAVITY, -scene.thickness - z + 1e-6, -scene.thickness
    radius = scene.radius[hole] + beyond
    x, y = scene.x[hole] + radius * np.cos(turn), scene.y[hole] + radius * np.sin(turn)
    return surface, place, hole if surface == WALL else -1, x, y, z
