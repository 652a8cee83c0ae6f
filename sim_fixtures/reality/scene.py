"""What lies on the stage, in closed form: planes, cylinders, and a grid that finds a hole at once.

Everything is in the artifact frame, mm. Rays live in one of three places: outside (above the plate), in the bore of
a hole, or in the cavity between plate and block. Holes never meet, so a ray changes place only where it
crosses the mouth of a hole, and no search along the ray is needed.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from instrument.angles import FloatArray
from instrument.artifact import ArtifactDimensions
from instrument.errors import InputError
from sim_fixtures.reality.bores import inside_level, leaves_bore, through_bore

#: Where a ray is.
OUTSIDE: Final = 0
BORE: Final = 1
CAVITY: Final = 2

#: What a ray meets. A ledge is the top of the spacer where a hole at the rim reaches past the cavity's wall.
ESCAPED: Final = 0
LOST: Final = 1
TOP: Final = 2
WALL: Final = 3
UNDERSIDE: Final = 4
SPACER: Final = 5
FLOOR: Final = 6
LEDGE: Final = 7
SURFACES: Final = 8

_FAR: Final = 1e30


class Scene(NamedTuple):
    """Plate, holes and cavity as compiled code takes them.

    Attributes
    ----------
    half_x, half_y
        Half the outline of the plate; light that passes beyond is lost.
    thickness, depth
        Of the plate, and from its top to the floor of the cavity.
    inner_x, inner_y
        Half the inside of the spacer.
    lidless
        The plate covers nothing of the cavity: an open pit (thickness 0).
    x, y, radius
        Of the holes, shape (hole,).
    low, cell, start, items
        Grid: lower corner (2,), size of a cell, and the holes that touch cell c as ``items[start[c]:start[c + 1]]``;
        cells run over y fastest, ``shape`` of them.
    factor
        Reflectance of every kind of surface over the coating's, shape (SURFACES,).
    profile, section
        Of the holes (:mod:`sim_fixtures.reality.bores`), shape (level, 2) and (2, 2); no levels: cylinders.
    slope
        Of the floor along x and y, shape (2,); the depth is that in the middle.
    patch
        A stain on the plate: x, y, radius (to exp(-2), mm), relative change of the reflectance; shape (4,).
    """

    half_x: float
    half_y: float
    thickness: float
    depth: float
    inner_x: float
    inner_y: float
    lidless: bool
    x: FloatArray
    y: FloatArray
    radius: FloatArray
    low: FloatArray
    cell: float
    shape: NDArray[np.int64]
    start: NDArray[np.int64]
    items: NDArray[np.int64]
    factor: FloatArray
    profile: FloatArray
    section: FloatArray
    slope: FloatArray
    patch: FloatArray


def artifact_scene(artifact: ArtifactDimensions) -> Scene:
    """The scene of a plate with holes, or of a flat sample where there are none.

    Raises
    ------
    InputError
        If the artifact is a mesh, has chamfers or a tilted block: the simulated laboratory knows none in an artifact.
    """
    if artifact.mesh is not None:
        raise InputError(f"{artifact.source}: mesh: the simulated laboratory needs dimensions, not a mesh")
    form, holes = artifact.form, artifact.holes
    if np.any(artifact.chamfers > 0) or any(form.floor_slope):
        raise InputError(
            f"{artifact.source}: edge_chamfer, block_tilt_x, block_tilt_y: the simulated laboratory needs sharp hole"
            " edges and a level block; expected 0"
        )
    return make_scene(
        outline=form.outline,
        thickness=form.plate_thickness,
        depth=form.cavity_depth,
        spacer_edge=form.spacer_edge,
        x=holes.x,
        y=holes.y,
        diameter=holes.diameter,
    )


def make_scene(
    *,
    outline: tuple[float, float] = (50.0, 50.0),
    thickness: float = 1.0,
    depth: float = 3.0,
    spacer_edge: float = 4.0,
    x: FloatArray | None = None,
    y: FloatArray | None = None,
    diameter: FloatArray | None = None,
    lidless: bool = False,
) -> Scene:
    """A scene from its dimensions in mm; without holes a flat sample."""
    x, y, diameter = (np.zeros(0) if a is None else np.array(a, dtype=float) for a in (x, y, diameter))
    radius = diameter / 2
    low, cell, shape, start, items = _grid(x, y, radius)
    return Scene(
        outline[0] / 2,
        outline[1] / 2,
        0.0 if lidless else float(thickness),
        float(depth),
        outline[0] / 2 - spacer_edge,
        outline[1] / 2 - spacer_edge,
        lidless,
        x,
        y,
        radius,
        low,
        cell,
        shape,
        start,
        items,
        np.ones(SURFACES),
        np.zeros((0, 2)),
        np.eye(2),
        np.zeros(2),
        np.zeros(4),
    )


def with_bores(scene: Scene, profile: FloatArray, section: FloatArray) -> Scene:
    """The scene with holes of another shape than the cylinder (see :mod:`sim_fixtures.reality.bores`)."""
    if not len(scene.x):
        return scene
    widest = np.max(profile[:, 1]) / np.min(scene.radius) + 1.0
    grid = _grid(scene.x, scene.y, scene.radius * widest / np.linalg.svd(section)[1].min())
    low, cell, shape, start, items = grid
    return scene._replace(low=low, cell=cell, shape=shape, start=start, items=items, profile=profile, section=section)


def pit_scene(side: float, depth: float, outline: float) -> Scene:
    """A square pit in the middle of a square plate."""
    return make_scene(outline=(outline, outline), depth=depth, spacer_edge=(outline - side) / 2, lidless=True)


def _grid(
    x: FloatArray, y: FloatArray, radius: FloatArray
) -> tuple[FloatArray, float, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    if not len(x):
        return np.zeros(2), 1.0, np.zeros(2, dtype=np.int64), np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)
    cell = float(np.min(radius))
    low = np.array([np.min(x - radius), np.min(y - radius)])
    high = np.array([np.max(x + radius), np.max(y + radius)])
    shape = np.floor((high - low) / cell).astype(np.int64) + 1
    cells: list[list[int]] = [[] for _ in range(int(shape[0] * shape[1]))]
    for hole in range(len(x)):
        box = [
            range(
                int((centre - radius[hole] - edge) // cell),
                min(int((centre + radius[hole] - edge) // cell), int(size) - 1) + 1,
            )
            for centre, edge, size in ((x[hole], low[0], shape[0]), (y[hole], low[1], shape[1]))
        ]
        for i in box[0]:
            for j in box[1]:
                cells[int(i * shape[1] + j)].append(hole)
    start = np.concatenate([[0], np.cumsum([len(found) for found in cells])]).astype(np.int64)
    items = np.array([hole for found in cells for hole in found], dtype=np.int64)
    return low, cell, shape, start, items


@njit(cache=True, nogil=True)
def find_hole(scene: Scene, x: float, y: float, level: int = 0) -> int:
    """The hole that a point of the plate's top (level 0) or underside (level -1) lies in; -1 for none."""
    if scene.lidless:
        return 0 if abs(x) < scene.inner_x and abs(y) < scene.inner_y else -1
    i = int(np.floor((x - scene.low[0]) / scene.cell))
    j = int(np.floor((y - scene.low[1]) / scene.cell))
    if i < 0 or j < 0 or i >= scene.shape[0] or j >= scene.shape[1]:
        return -1
    cell = i * scene.shape[1] + j
    for k in range(scene.start[cell], scene.start[cell + 1]):
        hole = scene.items[k]
        if scene.profile.shape[0] > 0:
            if inside_level(scene, hole, level, x, y):
                return hole
        elif (x - scene.x[hole]) ** 2 + (y - scene.y[hole]) ** 2 < scene.radius[hole] ** 2:
            return hole
    return -1


@njit(cache=True, nogil=True)
def surface_factor(scene: Scene, surface: int, x: float, y: float) -> float:
    """Reflectance of a point of a surface over the coating's."""
    factor = scene.factor[surface]
    if surface == TOP and scene.patch[3] != 0.0:
        squared = (x - scene.patch[0]) ** 2 + (y - scene.patch[1]) ** 2
        factor *= 1.0 + scene.patch[3] * np.exp(-2.0 * squared / scene.patch[2] ** 2)
    return factor


@njit(cache=True, nogil=True)
def sees_out(
    scene: Scene, place: int, hole: int, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> bool:
    """Whether light that leaves a surface point upwards meets nothing; the point's own hemisphere is the caller's."""
    if dz <= 0.0:
        return False
    if place == OUTSIDE:
        return True
    if place == CAVITY:
        t = (-scene.thickness - z) / dz
        mouth_x, mouth_y = x + t * dx, y + t * dy
        if abs(mouth_x) > scene.inner_x or abs(mouth_y) > scene.inner_y:
            return False
        hole = find_hole(scene, mouth_x, mouth_y, -1)
        if hole < 0:
            return False
        if scene.lidless:
            return True
    if scene.profile.shape[0] > 0:
        return leaves_bore(scene, hole, x, y, z, dx, dy, dz)
    t = -z / dz
    # A bore is convex: who is inside at both ends has met no wall.
    return (x + t * dx - scene.x[hole]) ** 2 + (y + t * dy - scene.y[hole]) ** 2 < scene.radius[hole] ** 2


@njit(cache=True, nogil=True)
def follow(
    scene: Scene, place: int, hole: int, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[int, int, int, float, float, float, float, float, float]:
    """Follow a ray to what it meets.

    Returns
    -------
    surface, place, hole, and the point and the normal there (mm; the normal points away from the solid).
    """
    if place == OUTSIDE:
        if dz >= 0.0:
            return ESCAPED, OUTSIDE, -1, x, y, z, 0.0, 0.0, 0.0
        t = -z / dz
        x, y, z = x + t * dx, y + t * dy, 0.0
        if abs(x) > scene.half_x or abs(y) > scene.half_y:
            return LOST, OUTSIDE, -1, x, y, z, 0.0, 0.0, 0.0
        hole = find_hole(scene, x, y)
        if hole < 0:
            return TOP, OUTSIDE, -1, x, y, z, 0.0, 0.0, 1.0
        place = CAVITY if scene.lidless else BORE
    while True:
        if place == BORE and scene.profile.shape[0] > 0:
            met, x, y, z, nx, ny, nz = through_bore(scene, hole, x, y, z, dx, dy, dz)
            if met:
                return WALL, BORE, hole, x, y, z, nx, ny, nz
            if dz > 0.0:
                return ESCAPED, OUTSIDE, -1, x, y, 0.0, 0.0, 0.0, 0.0
        elif place == BORE:
            t_wall, t_end = _bore_distances(scene, hole, x, y, z, dx, dy, dz)
            if t_wall < t_end:
                x, y, z = x + t_wall * dx, y + t_wall * dy, z + t_wall * dz
                nx = (scene.x[hole] - x) / scene.radius[hole]
                ny = (scene.y[hole] - y) / scene.radius[hole]
                return WALL, BORE, hole, x, y, z, nx, ny, 0.0
            x, y = x + t_end * dx, y + t_end * dy
            if dz > 0.0:
                return ESCAPED, OUTSIDE, -1, x, y, 0.0, 0.0, 0.0, 0.0
            z = -scene.thickness
        if place == BORE:
            if abs(x) > scene.inner_x or abs(y) > scene.inner_y:
                return LEDGE, BORE, hole, x, y, z, 0.0, 0.0, 1.0
            place = CAVITY
        t_x = ((scene.inner_x if dx > 0 else -scene.inner_x) - x) / dx if dx != 0.0 else _FAR
        t_y = ((scene.inner_y if dy > 0 else -scene.inner_y) - y) / dy if dy != 0.0 else _FAR
        t_z = ((-scene.thickness if dz > 0 else -scene.depth) - z) / dz if dz != 0.0 else _FAR
        sx, sy = scene.slope[0], scene.slope[1]
        to_floor = dz < 0.0
        if sx != 0.0 or sy != 0.0:
            t_z = (-scene.thickness - z) / dz if dz > 0.0 else _FAR
            sinking = dz - sx * dx - sy * dy
            t_floor = (-scene.depth + sx * x + sy * y - z) / sinking if sinking < 0.0 else _FAR
            to_floor = t_floor < t_z
            t_z = min(t_floor, t_z)
        t = min(t_x, t_y, t_z)
        x, y, z = x + t * dx, y + t * dy, z + t * dz
        if t == t_x and t < t_z:
            return SPACER, CAVITY, -1, x, y, z, (-1.0 if dx > 0 else 1.0), 0.0, 0.0
        if t < t_z:
            return SPACER, CAVITY, -1, x, y, z, 0.0, (-1.0 if dy > 0 else 1.0), 0.0
        if to_floor:
            steep = 1.0 / np.sqrt(1.0 + sx * sx + sy * sy)
            return FLOOR, CAVITY, -1, x, y, -scene.depth + sx * x + sy * y, -sx * steep, -sy * steep, steep
        z = -scene.thickness
        hole = find_hole(scene, x, y, -1)
        if hole < 0:
            return UNDERSIDE, CAVITY, -1, x, y, z, 0.0, 0.0, -1.0
        if scene.lidless:
            return ESCAPED, OUTSIDE, -1, x, y, z, 0.0, 0.0, 0.0
        place = BORE


@njit(cache=True, nogil=True)
def _bore_distances(
    scene: Scene, hole: int, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[float, float]:
    """Path lengths to the wall of a bore and to its end."""
    rx, ry = x - scene.x[hole], y - scene.y[hole]
    a = dx * dx + dy * dy
    b = rx * dx + ry * dy
    c = rx * rx + ry * ry - scene.radius[hole] ** 2
    t_wall = (-b + np.sqrt(max(b * b - a * c, 0.0))) / a if a > 0.0 else _FAR
    t_end = _FAR
    if dz > 0.0:
        t_end = -z / dz
    elif dz < 0.0:
        t_end = (-scene.thickness - z) / dz
    return t_wall, t_end
