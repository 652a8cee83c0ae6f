"""Many sensors at once: every lit point joined to all of them.

The same integral as :func:`sim_fixtures.reality.tracer.collect`, with the same draws, for receivers that differ in
where they stand only; what depends on the lit point alone is worked out once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from instrument.angles import FloatArray
from sim_fixtures.reality.bundle import DISC, FAR_DISC, PARALLEL, Bundle
from sim_fixtures.reality.coating import Reflection, grain_factor, reflectance_factor
from sim_fixtures.reality.scene import (
    BORE,
    CAVITY,
    FLOOR,
    LEDGE,
    OUTSIDE,
    TOP,
    UNDERSIDE,
    WALL,
    Scene,
    sees_out,
    surface_factor,
)
from sim_fixtures.reality.tracer import Vertices, _uniform


def gather(
    scene: Scene, reflection: Reflection, vertices: Vertices, receivers: Sequence[Bundle], seed: int
) -> FloatArray:
    """What sensors receive from lit points, shape (receiver,); each as ``collect`` would find it.

    Raises
    ------
    ValueError
        If the receivers are no sensors of one kind: uniform discs, the same far end, size and distance.
    """
    if not receivers:
        return np.zeros(0)
    kinds = {bundle._replace(centre=None, frame=None) for bundle in receivers}  # type: ignore[arg-type]
    one = receivers[0]
    if len(kinds) != 1 or one.shape != DISC or one.waist != 0.0 or one.far not in (PARALLEL, FAR_DISC):
        raise ValueError("receivers differ in more than their place, or are no sensors")
    centres = np.array([bundle.centre for bundle in receivers])
    frames = np.array([bundle.frame for bundle in receivers])
    values, surface, hole = vertices.values, vertices.surface, vertices.hole
    return _gather(scene, reflection, values, surface, hole, one, centres, frames, np.uint64(seed))


@njit(cache=True, nogil=True)
def _widest(scene: Scene) -> float:
    """Longest way across any section of any hole, mm; infinite where that takes more than a look."""
    if scene.lidless or scene.radius.size == 0 or scene.profile.shape[0] > 0:
        return np.inf
    return 2.0 * scene.radius.max()


@njit(cache=True, nogil=True)
def _gather(
    scene: Scene,
    reflection: Reflection,
    values: FloatArray,
    surfaces: NDArray[np.int64],
    holes: NDArray[np.int64],
    kind: Bundle,
    centres: FloatArray,
    frames: FloatArray,
    seed: np.uint64,
) -> FloatArray:
    total = np.zeros(centres.shape[0])
    along, squared = kind.far_distance, kind.extent * kind.extent
    grained = reflection.grain[0] != 0.0 or reflection.grain[1] != 0.0
    cylinders = scene.profile.shape[0] == 0
    widest = _widest(scene)
    for i in range(values.shape[0]):
        row = values[i]
        x, y, z = row[0], row[1], row[2]
        nx, ny, nz = row[3], row[4], row[5]
        near, far = 0.0, 0.0
        if kind.far != PARALLEL:
            radius = kind.far_radius * np.sqrt(_uniform(seed, i, 0))
            turn = 2.0 * np.pi * _uniform(seed, i, 1)
            near, far = radius * np.cos(turn), radius * np.sin(turn)
        surface = surfaces[i]
        flat = grained and surface in (TOP, FLOOR, UNDERSIDE)
        hole = holes[i]
        place = CAVITY
        if surface == TOP:
            place = OUTSIDE
        elif surface in (WALL, LEDGE):
            place = BORE
        cos_in = row[6] * nx + row[7] * ny + row[8] * nz
        weight = row[9] * surface_factor(scene, surface, x, y)
        for k in range(centres.shape[0]):
            c, f = centres[k], frames[k]
            if kind.far == PARALLEL:
                dx, dy, dz, length = f[0, 0], f[0, 1], f[0, 2], 0.0
            else:
                dx = along * f[0, 0] + near * f[1, 0] + far * f[2, 0] + c[0] - x
                dy = along * f[0, 1] + near * f[1, 1] + far * f[2, 1] + c[1] - y
                dz = along * f[0, 2] + near * f[1, 2] + far * f[2, 2] + c[2] - z
                length = 1.0
            if dx * nx + dy * ny + dz * nz <= 0.0:
                continue
            if dz <= 0.0:
                continue
            if place == BORE and cylinders:
                ax, ay = x - z / dz * dx - scene.x[hole], y - z / dz * dy - scene.y[hole]
                if ax * ax + ay * ay >= scene.radius[hole] ** 2:
                    continue
            elif place != OUTSIDE:
                # Who crosses more of the plate than the widest hole is wide meets a wall: no need to look which.
                if place == CAVITY and not scene.lidless and dx * dx + dy * dy > (widest * dz / scene.thickness) ** 2:
                    continue
                if not sees_out(scene, place, hole, x, y, z, dx, dy, dz):
                    continue
            # Directions need no unit length before the last tests are passed.
            across = dx * f[3, 0] + dy * f[3, 1] + dz * f[3, 2]
            ahead = ((c[0] - x) * f[3, 0] + (c[1] - y) * f[3, 1] + (c[2] - z) * f[3, 2]) / across
            px, py, pz = x + ahead * dx - c[0], y + ahead * dy - c[1], z + ahead * dz - c[2]
            a = px * f[4, 0] + py * f[4, 1] + pz * f[4, 2]
            b = px * f[5, 0] + py * f[5, 1] + pz * f[5, 2]
            if a * a + b * b > squared:
                continue
            stretch = 1.0
            if length != 0.0:
                length = np.sqrt(dx * dx + dy * dy + dz * dz)
                dx, dy, dz = dx / length, dy / length, dz / length
                stretch = (1.0 - ahead) ** 2
            cos_out = dx * nx + dy * ny + dz * nz
            cos_disc = dx * f[3, 0] + dy * f[3, 1] + dz * f[3, 2]
            cos_between = row[6] * dx + row[7] * dy + row[8] * dz
            value = weight * reflectance_factor(reflection, cos_in, cos_out, cos_between) * cos_out * stretch / cos_disc
            if flat:
                value *= grain_factor(reflection, row[6], row[7], dx, dy)
            total[k] += value
    return total * kind.density / np.pi
